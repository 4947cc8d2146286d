//! What the words for reasons mean, and what to do, from the declarations of the words.

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
