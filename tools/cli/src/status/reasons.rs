//! What the words of reasons mean and what to do, in plain text.

use singletrack_core::reasons::explanations;

/// A word's explanation, as plain text.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Entry {
    /// What the word means: one sentence or several.
    pub(super) meaning: String,
    /// What to do about it; none if nothing is to be done.
    pub(super) advice: Option<String>,
}

impl Entry {
    /// The explanation of a word; none if the daemon is of another release and has other words.
    /// `who` decides, as in [`Explanation::who`](singletrack_core::reasons::Explanation).
    pub(super) fn find(who: &str, word: &str) -> Option<Self> {
        explanations()
            .find(|row| row.who == who && row.word == word)
            .map(|row| Self {
                meaning: row.meaning.replace('`', ""),
                advice: (!row.remedy.starts_with("Nothing")).then(|| row.remedy.replace('`', "")),
            })
    }

    /// The first sentence of the meaning, as a part of another one.
    pub(super) fn brief(&self) -> String {
        let first = self.meaning.split(". ").next().unwrap_or_default();
        let mut letters = first.trim_end_matches('.').chars();
        let Some(initial) = letters.next() else {
            return String::new();
        };
        let rest = letters.as_str();
        if rest.starts_with(char::is_uppercase) {
            // IMU
            return format!("{initial}{rest}");
        }
        format!("{}{rest}", initial.to_lowercase())
    }
}

#[cfg(test)]
#[allow(clippy::panic, reason = "a test may fail")]
mod tests {
    use singletrack_pilot::Reason;
    use singletrack_protocol::StopCause;

    use super::*;

    #[test]
    fn every_word_of_host_and_board_is_explained_in_plain_text() {
        let host = Reason::ALL.iter().map(|reason| ("host", reason.name()));
        let board = StopCause::ALL
            .iter()
            .map(|cause| ("board stop", cause.name()));
        for (source, word) in host.chain(board) {
            let Some(entry) = Entry::find(source, word) else {
                panic!("{source}: {word} is not explained");
            };
            let texts = [Some(entry.meaning.clone()), entry.advice.clone()];
            for text in texts.into_iter().flatten() {
                assert!(text.len() >= 5 && !text.contains('`'), "{text}");
                assert!(!text.contains("]("), "{text}");
            }
            assert!(!entry.brief().is_empty() && !entry.brief().ends_with('.'));
        }
    }

    #[test]
    fn a_word_of_another_release_is_not_explained() {
        assert_eq!(Entry::find("host", "asleep"), None);
        assert_eq!(Entry::find("host", ""), None);
        assert_eq!(Entry::find("board stop", "no-pose"), None);
    }

    #[test]
    fn a_meaning_goes_on_in_a_sentence_and_a_name_keeps_its_capitals() {
        let brief = |word| Entry::find("host", word).map(|entry| entry.brief());
        assert_eq!(brief("no-pose").as_deref(), Some("no pose yet"));
        let tilt = brief("tilt-differs").unwrap_or_default();
        assert!(tilt.starts_with("IMU and cameras"), "{tilt}");
        assert_eq!(
            Entry::find("host", "time-up").and_then(|entry| entry.advice),
            None
        );
    }
}
