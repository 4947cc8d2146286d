//! What the words of reasons mean and what to do, from the table of the documentation.

use singletrack_core::reasons::explanations;

/// Whose word it is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Source {
    /// The supervisor of the host.
    Host,
    /// Why the board went to neutral.
    BoardStop,
}

impl Source {
    const fn name(self) -> &'static str {
        match self {
            Self::Host => "host",
            Self::BoardStop => "board stop",
        }
    }
}

/// A row of the table, as plain text.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Entry {
    /// What the word means: one sentence or several.
    pub(super) meaning: String,
    /// What to do about it; none if nothing is to be done.
    pub(super) advice: Option<String>,
}

impl Entry {
    /// The row of a word; none if the table is of another release than the daemon.
    pub(super) fn find(source: Source, word: &str) -> Option<Self> {
        explanations()
            .find(|row| row.who == source.name() && row.word == word)
            .map(|row| {
                let advice = plain(row.remedy);
                Self {
                    meaning: plain(row.meaning),
                    advice: (!advice.starts_with("Nothing")).then_some(advice),
                }
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

/// Text without the marks of Markdown.
fn plain(text: &str) -> String {
    // The rows that a text refers to are not below it here.
    let text = text.replace('`', "").replace(", below", "");
    let mut plain = String::with_capacity(text.len());
    let mut rest = text.as_str();
    while let Some((before, (name, after))) = rest
        .split_once('[')
        .and_then(|(before, link)| Some((before, link.split_once("](")?)))
    {
        plain.push_str(before);
        plain.push_str(name);
        rest = after.split_once(')').map_or("", |(_, rest)| rest);
    }
    plain.push_str(rest);
    plain
}

#[cfg(test)]
#[allow(clippy::panic, reason = "a test may fail")]
mod tests {
    use singletrack_pilot::Reason;
    use singletrack_protocol::StopCause;

    use super::*;

    #[test]
    fn every_word_of_host_and_board_is_explained_in_plain_text() {
        let host = Reason::ALL
            .iter()
            .map(|reason| (Source::Host, reason.name()));
        let board = StopCause::ALL
            .iter()
            .map(|cause| (Source::BoardStop, cause.name()));
        for (source, word) in host.chain(board) {
            let Some(entry) = Entry::find(source, word) else {
                panic!("{source:?}: {word} has no row");
            };
            let texts = [Some(entry.meaning.clone()), entry.advice.clone()];
            for text in texts.into_iter().flatten() {
                assert!(text.len() >= 5 && !text.contains(['`', '|']), "{text}");
                assert!(!text.contains("](") && !text.contains("below."), "{text}");
            }
            assert!(!entry.brief().is_empty() && !entry.brief().ends_with('.'));
        }
    }

    #[test]
    fn a_word_of_another_release_has_no_row() {
        assert_eq!(Entry::find(Source::Host, "asleep"), None);
        assert_eq!(Entry::find(Source::Host, ""), None);
        assert_eq!(Entry::find(Source::BoardStop, "no-pose"), None);
    }

    #[test]
    fn a_meaning_goes_on_in_a_sentence_and_a_name_keeps_its_capitals() {
        let brief = |word| Entry::find(Source::Host, word).map(|entry| entry.brief());
        assert_eq!(brief("no-pose").as_deref(), Some("no pose yet"));
        let tilt = brief("tilt-differs").unwrap_or_default();
        assert!(tilt.starts_with("IMU and cameras"), "{tilt}");
        assert_eq!(
            Entry::find(Source::Host, "time-up").and_then(|entry| entry.advice),
            None
        );
    }

    #[test]
    fn a_link_becomes_its_name() {
        assert_eq!(
            plain("the [filter](a.md), or [x](b#c)."),
            "the filter, or x."
        );
        assert_eq!(plain("`fence` in [m]"), "fence in [m]");
    }
}
