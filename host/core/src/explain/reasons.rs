//! What the words for reasons mean, and what to do, from the declarations of the words.

use core::fmt;

use singletrack_api::Status;
use singletrack_mocap::RejectReason;
use singletrack_pilot::Reason;
use singletrack_protocol::{RefusalReason, StopCause};

/// A word with its explanation. The texts are Markdown on one line.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Explanation {
    /// Who decides: `host`, `board stop`, `board refusal` or `cameras`.
    pub who: &'static str,
    /// The word in status, log and record.
    pub word: &'static str,
    /// What it means.
    pub meaning: String,
    /// What the car does, and within which time; empty if that is what it does for most words of
    /// the same source.
    pub effect: String,
    /// What to do about it.
    pub remedy: String,
}

/// All words, by who decides, in the order of their declarations.
pub fn explanations() -> impl Iterator<Item = Explanation> {
    let host = Reason::ALL.map(|word| ("host", word.name(), word.documentation()));
    let stops = StopCause::ALL.map(|word| ("board stop", word.name(), word.documentation()));
    let refusals =
        RefusalReason::ALL.map(|word| ("board refusal", word.name(), word.documentation()));
    let cameras = RejectReason::ALL.map(|word| ("cameras", word.name(), word.documentation()));
    let words = host.into_iter().chain(stops).chain(refusals).chain(cameras);
    words.map(|(who, word, documentation)| {
        let part = |label: &str| {
            let mut paragraphs = documentation.split("\n\n").map(str::trim_start);
            let text = paragraphs.find_map(|paragraph| paragraph.strip_prefix(label));
            let words: Vec<_> = text.unwrap_or_default().split_whitespace().collect();
            words.join(" ")
        };
        Explanation {
            who,
            word,
            meaning: part(""),
            effect: part("Effect: "),
            remedy: part("Remedy: "),
        }
    })
}

/// The explanation of a word; none if the daemon is of another release and has other words.
fn find(who: &str, word: &str) -> Option<Explanation> {
    explanations().find(|row| row.who == who && row.word == word)
}

/// The first sentence of a meaning, as a part of another one.
fn brief(meaning: &str) -> String {
    let first = meaning.split(". ").next().unwrap_or_default();
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

/// Why a car does not drive, for a person.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Why {
    /// The meaning and the word.
    pub text: String,
    /// What to do about it, as sentences; none if nothing is to be done.
    pub advice: Option<String>,
}

impl Why {
    /// Why a car that stands can't be armed now, and not why its last drive ended; `None` if there is
    /// no reason.
    pub fn of(status: &Status) -> Option<Self> {
        let stands = matches!(status.mode(), "idle" | "ready");
        let preflight = status.preflight().filter(|_| stands);
        let word = preflight.or(status.reason())?;
        let mut why = Self::explain(word, status);
        if status.mode() == "ready" {
            why.text.insert_str(0, "the last drive ended: ");
            // The board answers again.
            why.advice = why.advice.filter(|_| word != Reason::LinkDown.name());
        }
        Some(why)
    }

    /// What this word means; `who` decides, as in [`Explanation::who`]. A word of another release is its
    /// own explanation.
    pub fn of_word(who: &str, word: &str) -> Self {
        let plain = |text: &str| text.replace('`', "");
        match find(who, word) {
            Some(row) => Self {
                text: format!("{} ({word})", brief(&plain(&row.meaning))),
                advice: (!row.remedy.starts_with("Nothing")).then(|| plain(&row.remedy)),
            },
            None => Self {
                text: word.to_owned(),
                advice: None,
            },
        }
    }

    /// What this word of the host means, with what the status says of board and cameras.
    pub fn explain(word: &str, status: &Status) -> Self {
        let mut why = Self::of_word("host", word);
        if word == Reason::BoardFailsafe.name()
            && let Some(board) = &status.board
        {
            if board.stop_cause == StopCause::None.name() {
                why.text += "; it has been reset since, and no longer knows why";
                let advice = "Look at the stops in the record: singletrack dump RECORD --stats.";
                why.advice = Some(advice.to_owned());
            } else {
                let stop = Self::of_word("board stop", &board.stop_cause);
                why.text += &format!(": {}", stop.text);
                why.advice = stop.advice;
            }
        }
        if word == Reason::LinkDown.name()
            && let Some(error) = &status.serial_error
        {
            why.advice = Some(sentence(error));
        }
        if word == Reason::OutsideFence.name()
            && let Some(state) = &status.state
            && let (Some(x), Some(y)) = (state.x_m, state.y_m)
        {
            why.text += &format!("; its centre of mass is at ({x:.2}, {y:.2}) m");
        }
        if matches!(word, "no-pose" | "pose-too-old" | "pose-implausible") {
            let cameras = &status.cameras;
            // The daemon knows better what is wrong with its cameras than the table does.
            if cameras.is_trouble() {
                why.advice = Some(sentence(&cameras.text));
            }
            if let Some(neighbour) = &cameras.neighbour {
                why.text += &format!("; {neighbour}");
            }
        }
        why
    }
}

/// A text with its full stop.
fn sentence(text: &str) -> String {
    match text.ends_with(['.', '?', '!']) {
        true => text.to_owned(),
        false => format!("{text}."),
    }
}

impl fmt::Display for Why {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(&self.text)?;
        match &self.advice {
            Some(advice) => write!(formatter, ". To do: {advice}"),
            None => Ok(()),
        }
    }
}

#[cfg(test)]
#[allow(clippy::panic, clippy::unwrap_used, reason = "a test may fail")]
mod tests {
    use super::*;

    #[test]
    fn every_word_of_host_and_board_is_explained_in_plain_text() {
        let host = Reason::ALL.iter().map(|reason| ("host", reason.name()));
        let board = StopCause::ALL
            .iter()
            .map(|cause| ("board stop", cause.name()));
        for (source, word) in host.chain(board) {
            let Some(row) = find(source, word) else {
                panic!("{source}: {word} is not explained");
            };
            for text in [&row.meaning, &row.remedy] {
                assert!(text.len() >= 5 && !text.contains("]("), "{text}");
            }
            let why = Why::of_word(source, word);
            for text in [Some(why.text), why.advice].into_iter().flatten() {
                assert!(!text.contains('`'), "{text}");
            }
            let brief = brief(&row.meaning);
            assert!(!brief.is_empty() && !brief.ends_with('.'));
        }
    }

    #[test]
    fn a_stop_of_the_board_has_the_boards_cause_and_advice() {
        let status = |stop_cause: &str| -> Status {
            let text = format!(
                "figures = {{}}\nrealtime = {{}}\n\
                 [state]\ntopic = \"state\"\ntick = 1\nt_s = 0.0\ntime_ns = 1\n\
                 mode = \"fault\"\nreason = \"board-failsafe\"\nlink = \"ready\"\nheld = true\n\
                 steering_rad = 0.0\ncommanded_speed_m_s = 0.0\n\
                 filtering = \"none\"\nfiltered_ticks = 0\n\
                 [board]\nmode = \"failsafe\"\nstop_cause = \"{stop_cause}\"\n\
                 [cameras]\ndiagnosis = \"good\"\ntext = \"\"\n[configuration]\nnumber = 1\n"
            );
            toml::from_str(&text).unwrap()
        };
        let why = |cause| Why::explain("board-failsafe", &status(cause)).to_string();
        let stopped = "the board stopped the car by itself (board-failsafe)";
        assert!(
            why("motor-sensor").starts_with(&format!("{stopped}: no motor pulse"))
                && why("motor-sensor").contains("(motor-sensor). To do: Check the pulse sensor"),
            "{}",
            why("motor-sensor")
        );
        assert!(why("none").starts_with(&format!("{stopped}; it has been reset since")));
        assert_eq!(
            Why::of(&status("none")).map(|why| why.to_string()),
            Some(why("none"))
        );
    }

    #[test]
    fn a_word_of_another_release_is_not_explained() {
        assert_eq!(find("host", "asleep"), None);
        assert_eq!(find("host", ""), None);
        assert_eq!(find("board stop", "no-pose"), None);
    }

    #[test]
    fn a_meaning_goes_on_in_a_sentence_and_a_name_keeps_its_capitals() {
        let brief = |word| find("host", word).map(|row| brief(&row.meaning));
        assert_eq!(brief("no-pose").as_deref(), Some("no pose yet"));
        let tilt = brief("tilt-differs").unwrap_or_default();
        assert!(tilt.starts_with("IMU and cameras"), "{tilt}");
        assert_eq!(Why::of_word("host", "time-up").advice, None);
    }
}
