//! The table of reasons in the documentation, held to the code in both
//! directions.

use std::collections::BTreeSet;

use singletrack_core::reasons::explanations;
use singletrack_mocap::RejectReason;
use singletrack_pilot::Reason;
use singletrack_protocol::{RefusalReason, StopCause};
use singletrack_record::Topic;

const TABLE: &str = include_str!("../../../docs/reasons.md");

/// The words of the rows of one who decides, in order.
fn documented(who: &str) -> Vec<&'static str> {
    explanations()
        .filter(|row| row.who == who)
        .map(|row| row.word)
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
    let code = Reason::ALL.map(Reason::name);
    assert_same("host", &code, &recorded(Topic::Tick, "REASON_"));
}

#[test]
fn the_table_has_every_cause_of_the_board_to_stop() {
    let code = StopCause::ALL.map(StopCause::name);
    assert_same(
        "board stop",
        &code,
        &recorded(Topic::Telemetry, "STOP_CAUSE_"),
    );
}

#[test]
fn the_table_has_every_reason_of_the_board_to_refuse() {
    let code = RefusalReason::ALL.map(RefusalReason::name);
    assert_same("board refusal", &code, &recorded(Topic::Status, "REFUSAL_"));
}

#[test]
fn the_table_has_every_reason_not_to_believe_a_pose() {
    let code = RejectReason::ALL.map(RejectReason::name);
    assert_same("cameras", &code, &recorded(Topic::Pose, "REJECTED_"));
}

#[test]
fn every_row_has_a_source_a_meaning_an_effect_and_a_remedy() {
    let known = ["host", "board stop", "board refusal", "cameras"];
    for row in explanations() {
        assert!(known.contains(&row.who), "{row:?}");
        for text in [row.meaning, row.effect, row.remedy] {
            assert!(text.ends_with('.') && text.len() >= 5, "{row:?}: {text:?}");
        }
    }
    // The head of the table and the line below it are no rows.
    let lines = TABLE.lines().filter(|line| line.starts_with('|')).count();
    assert_eq!(
        explanations().count(),
        lines - 2,
        "a row has not five columns"
    );
}
