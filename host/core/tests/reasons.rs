//! The list of reasons, of the declarations of their words. With `SINGLETRACK_RENEW=1` its test writes it
//! instead.

use std::collections::BTreeSet;

use singletrack_core::reasons::{Explanation, explanations};
use singletrack_record::Topic;

use crate::documents::compare;

/// Reasons by who decides: the topic and the prefix of the record's constants, and the section's text.
const REASONS: [(&str, Topic, &str, &str); 4] = [
    (
        "host",
        Topic::Tick,
        "REASON_",
        "The supervisor. Status: `reason`. Log: `mode MODE: REASON`. Record: `reason` in
`/singletrack/tick`. Where no effect is named, the car *refuses*, and *stops* if it drives.",
    ),
    (
        "board stop",
        Topic::Telemetry,
        "STOP_CAUSE_",
        "Why the board last went to neutral. Status: `board.stop_cause`. Record: `stop_cause` in
`/singletrack/telemetry`. The host says `board-failsafe` or `emergency-stop`. Where no effect is
named: neutral. *Latched*: until the board is reset.",
    ),
    (
        "board refusal",
        Topic::Status,
        "REFUSAL_",
        "Why the board refused a request, which has no effect. Log: with the request. Record, for drive
commands: `last_refusal` in `/singletrack/status`. The host says `board-refused` or
`configuration-refused`.",
    ),
    (
        "cameras",
        Topic::Pose,
        "REJECTED_",
        "Why a pose is left out; a single one stops nothing. Status: counted in `figures.mocap`. Record:
`rejected` in `/singletrack/pose`.",
    ),
];

const HEADER: &str = "\
# Reasons for refusing and stopping

Every refusal and every stop has one reason: one word in `singletrack status`, log and record. Times
are those of the default configuration. Without a word, start from the [symptom](troubleshooting.md).
Two refusals of `arm` are sentences: a procedure [has not
passed](troubleshooting.md#the-car-does-not-arm) on this car, or the car can't drive its reference
[from where it stands](control-socket.md#arm).

Each line has the meaning, what the car does, and what to do. The car

- *refuses*: does not arm; the answer names the reason.
- *slows*: from the next tick (10 ms) the wheels are held and the speed ramps down with
  `control.stop_deceleration_m_s2`; it drives on if the input comes back.
- *stops*: the speed ramps down (from 1.5 m/s in 0.63 s); then, at the latest after
  `supervisor.stop_timeout_ms` (1.5 s), the board is disarmed. A motor at neutral does not brake: the
  simulated car rolls for 1.1 s from 1.5 m/s.
- *needs a disarm*: stops; a disarm must acknowledge the reason before the next arm.
- goes to *neutral*: within 21 ms the ESC is at neutral, or brakes if so configured. A board that is
  disarmed while the car rolls brakes where the ESC can, for half a second at most, until the wheels
  stand or speed up again.

After a stop or neutral, only an explicit arm makes the car drive.

Generated from the declarations of the words by `host/core/tests/reasons.rs`.
";

/// The words of the constants that the record's schema has for a field.
fn recorded(topic: Topic, prefix: &str) -> BTreeSet<String> {
    let schema = topic.schema_text();
    schema
        .lines()
        .filter_map(|line| line.strip_prefix("uint8 ")?.strip_prefix(prefix))
        .filter_map(|constant| {
            let (name, code) = constant.split_once('=')?;
            // 0 stands for "no reason at all", where there may be none.
            (code != "0").then(|| name.to_lowercase().replace('_', "-"))
        })
        .collect()
}

#[test]
fn the_record_has_every_word_once() {
    for (who, topic, prefix, _) in REASONS {
        let words: Vec<_> = explanations()
            .filter(|row| row.who == who)
            .map(|row| row.word.to_owned())
            .collect();
        let unique: BTreeSet<_> = words.iter().cloned().collect();
        assert_eq!(unique.len(), words.len(), "{who}: a word twice");
        assert_eq!(unique, recorded(topic, prefix), "{who}");
    }
}

#[test]
fn every_word_has_a_meaning_and_a_remedy() {
    for row in explanations() {
        for text in [&row.meaning, &row.remedy] {
            assert!(text.ends_with('.') && text.len() >= 5, "{row:?}");
        }
        assert!(
            row.effect.is_empty() || row.effect.ends_with('.'),
            "{row:?}"
        );
    }
}

#[test]
fn the_page_is_that_of_the_declarations() {
    let mut page = HEADER.to_owned();
    for (who, _, _, text) in REASONS {
        page += &format!("\n## `{who}`\n\n{text}\n\n");
        for row in explanations().filter(|row| row.who == who) {
            page += &line(&row);
        }
    }
    compare("docs/reasons.md", &page);
}

fn line(row: &Explanation) -> String {
    let effect = match row.effect.as_str() {
        "" => String::new(),
        effect => format!(" *{effect}*"),
    };
    let remedy = match row.remedy.as_str() {
        "Nothing." => String::new(),
        remedy => format!(" {remedy}"),
    };
    format!("- `{}`: {}{effect}{remedy}\n", row.word, row.meaning)
}
