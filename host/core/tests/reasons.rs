//! The table of reasons in the documentation, held to the code in both
//! directions.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    reason = "the helpers of tests may fail as tests do"
)]

use std::collections::BTreeSet;

use singletrack_mocap::RejectReason;
use singletrack_pilot::Reason;
use singletrack_protocol::{RefusalReason, StopCause};
use singletrack_record::Topic;

use singletrack_core::words;

const TABLE: &str = include_str!("../../../docs/reasons.md");

/// The values of an enumeration; the match fails to compile when one is missing.
macro_rules! all {
    ($type:ident: $($value:ident)*) => {{
        const fn _complete(value: $type) {
            match value {
                $($type::$value => {})*
            }
        }
        [$($type::$value),*]
    }};
}

/// Rows of the table: who decides, word, and the three columns of text.
fn rows() -> Vec<[&'static str; 5]> {
    TABLE
        .lines()
        .filter_map(|line| line.strip_prefix("| ")?.strip_suffix(" |"))
        .skip(1)
        .map(|line| {
            let fields: Vec<_> = line.split(" | ").collect();
            fields
                .try_into()
                .unwrap_or_else(|_| panic!("not five columns: {line}"))
        })
        .collect()
}

/// The words of the rows of one who decides, in order.
fn documented(who: &str) -> Vec<&'static str> {
    rows()
        .into_iter()
        .filter(|row| row[0] == who)
        .map(|row| {
            let word = row[1]
                .strip_prefix('`')
                .and_then(|word| word.strip_suffix('`'));
            word.unwrap_or_else(|| panic!("no word: {}", row[1]))
        })
        .collect()
}

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

fn assert_same(who: &str, code: &[&str], recorded: &BTreeSet<String>) {
    let documented = documented(who);
    let unique: BTreeSet<String> = documented.iter().map(|&word| word.to_owned()).collect();
    assert_eq!(unique.len(), documented.len(), "{who}: a word twice");
    let code: BTreeSet<String> = code.iter().map(|&word| word.to_owned()).collect();
    assert_eq!(unique, code, "{who}: the table and the code differ");
    assert_eq!(*recorded, code, "{who}: the record and the code differ");
}

#[test]
fn the_table_has_every_reason_of_the_host_in_the_words_of_status_log_and_record() {
    let code: Vec<_> = Reason::ALL.iter().map(|reason| reason.name()).collect();
    assert_same("host", &code, &recorded(Topic::Tick, "REASON_"));
}

#[test]
fn the_table_has_every_cause_of_the_board_to_stop() {
    let code = all!(StopCause:
        None Disarmed CommandTimeout PoseTooOld MotorSensor StopInput EmergencyStop HostRestarted
    );
    let code = code.map(words::stop_cause_name);
    assert_same(
        "board stop",
        &code,
        &recorded(Topic::Telemetry, "STOP_CAUSE_"),
    );
}

#[test]
fn the_table_has_every_reason_of_the_board_to_refuse() {
    let code = all!(RefusalReason:
        None NotConfigured ConfigurationDiffers InvalidConfiguration Busy NotYetNeutral Moving
        StopInputOpen EmergencyStopLatched Stale OutOfSequence PoseTooOld NotArmed ReverseDisabled
        VersionDiffers
    );
    let code = code.map(words::refusal_name);
    assert_same("board refusal", &code, &recorded(Topic::Status, "REFUSAL_"));
}

#[test]
fn the_table_has_every_reason_not_to_believe_a_pose() {
    let code = all!(RejectReason:
        NotFinite NotUnitQuaternion DuplicateId MeanError CaptureTime Jump Flip
    );
    let code: Vec<_> = code
        .iter()
        .map(|reason| kebab(&format!("{reason:?}")))
        .collect();
    let code: Vec<_> = code.iter().map(String::as_str).collect();
    assert_same("cameras", &code, &recorded(Topic::Pose, "REJECTED_"));
}

/// `LikeThis` as `like-this`.
fn kebab(name: &str) -> String {
    let mut word = String::new();
    for letter in name.chars() {
        if letter.is_ascii_uppercase() && !word.is_empty() {
            word.push('-');
        }
        word.push(letter.to_ascii_lowercase());
    }
    word
}

#[test]
fn nobody_else_decides_and_every_row_says_meaning_effect_and_remedy() {
    let rows = rows();
    let known = ["host", "board stop", "board refusal", "cameras"];
    for row in &rows {
        assert!(known.contains(&row[0]), "{row:?}");
        for text in &row[2..] {
            assert!(text.ends_with('.') && text.len() >= 5, "{row:?}: {text:?}");
        }
    }
    let count: usize = known.iter().map(|who| documented(who).len()).sum();
    assert_eq!(count, rows.len());
}
