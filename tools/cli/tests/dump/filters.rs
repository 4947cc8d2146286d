//! Which rows and which fields are printed.

use crate::fixture::{assert_case, dump, recorder, text};

/// What is printed of the record.
fn printed(arguments: &[&str]) -> String {
    let folder = tempfile::tempdir().unwrap();
    let (recorder, path) = recorder(folder.path());
    recorder.finish().unwrap();
    let output = dump(&path, arguments);
    assert_eq!(text(&output.stderr), "");
    assert!(output.status.success());
    text(&output.stdout)
}

/// The error that the arguments lead to.
fn refused(arguments: &[&str]) -> String {
    let folder = tempfile::tempdir().unwrap();
    let (recorder, path) = recorder(folder.path());
    recorder.finish().unwrap();
    let output = dump(&path, arguments);
    assert!(!output.status.success());
    assert_eq!(text(&output.stdout), "");
    text(&output.stderr)
}

#[test]
fn several_topics_come_in_the_order_of_the_record() {
    for format in ["table", "json", "csv"] {
        let arguments = ["--topic=log,tick", "--topic=drops", "--format", format];
        assert_case(&format!("topics.{format}"), &printed(&arguments));
    }
}

#[test]
fn fields_of_several_topics_stand_beside_their_topic() {
    for format in ["table", "json", "csv"] {
        let fields = "--fields=time_s,mode,battery_mv";
        let arguments = ["--topic=tick,status", fields, "--format", format];
        assert_case(&format!("topics_fields.{format}"), &printed(&arguments));
    }
}

#[test]
fn conditions_choose_rows_by_what_their_fields_hold() {
    for (conditions, expected) in [
        (&["mode=driving"][..], &["1"][..]),
        (&["mode!=driving"], &["0"]),
        (&["reason=none"], &["1"]),
        (&["reason=no-pose"], &["0"]),
        (&["held=true"], &["0"]),
        (&["lateness_ns>61000"], &["0"]),
        (&["lateness_ns>=61000"], &["0", "1"]),
        (&["lateness_ns<=70000", "tick<1"], &["0"]),
        (&["estimate.speed_m_s>0.3"], &["1"]),
        (&["time_s>0.005"], &["1"]),
        (&["scheduled_ns=120010000000"], &["1"]),
        (&["mode=driving", "held=true"], &[]),
    ] {
        let mut arguments = vec!["--topic=tick", "--fields=tick"];
        arguments.extend(conditions.iter().flat_map(|one| ["--where", *one]));
        let printed = printed(&arguments);
        let rows: Vec<_> = printed.lines().skip(1).collect();
        assert_eq!(rows, expected, "{conditions:?}");
    }
}

#[test]
fn a_topic_may_have_the_name_of_its_channel() {
    let printed = |topic| printed(&["--fields=tick", topic]);
    assert_eq!(
        printed("--topic=/singletrack/tick"),
        printed("--topic=tick")
    );
}

#[test]
fn a_topic_without_the_field_of_a_condition_is_left_out() {
    let arguments = ["--topic=tick,log", "--where=tick>=0", "--format=json"];
    let printed = printed(&arguments);
    assert_eq!(printed.lines().count(), 2);
    assert!(!printed.contains("\"topic\":\"log\""), "{printed}");
}

#[test]
fn rows_are_chosen_by_seconds_and_by_wall_time() {
    // The record begins at 2026-05-28T20:26:40Z; the ticks come 70 us and 10061 us later.
    for (arguments, expected) in [
        (&["--from=0.005"][..], &["1"][..]),
        (&["--to=0.005"], &["0"]),
        (&["--from=0", "--to=0.1"], &["0", "1"]),
        (&["--from=2026-05-28T20:26:40.005Z"], &["1"]),
        (&["--to=2026-05-28T22:26:40.005+02:00"], &["0"]),
    ] {
        let mut all = vec!["--topic=tick", "--fields=tick"];
        all.extend(arguments);
        let printed = printed(&all);
        let rows: Vec<_> = printed.lines().skip(1).collect();
        assert_eq!(rows, expected, "{arguments:?}");
    }
}

#[test]
fn what_is_misspelt_is_named_with_what_was_probably_meant() {
    for (arguments, expected) in [
        (
            &["--topic=tick", "--fields=tick,latenes_ns"][..],
            "tick has no field \"latenes_ns\" (did you mean \"lateness_ns\"?)",
        ),
        (
            &["--topic=tick,log", "--where=txt=x"],
            "tick, log has no field \"txt\" (did you mean \"text\"?)",
        ),
        (
            &["--topic=tik"],
            "no topic \"tik\" (did you mean \"tick\"?)",
        ),
        (
            &["--where=mode"],
            "not a condition: \"mode\"; use FIELD=VALUE",
        ),
        (&["--from=soon"], "not a time: \"soon\"; use seconds"),
        (
            &["--for", "-5s"],
            "invalid value '-5s' for '--for <DURATION>'",
        ),
        (&["--from", "-5"], "invalid value '-5' for '--from <TIME>'"),
        (&["--baud", "-5"], "invalid value '-5' for '--baud <BAUD>'"),
        (
            &["--topic=tick", "--where=mode=drivng"],
            "mode is never \"drivng\"; it is one of disconnected, idle, ready, arming, driving",
        ),
        (
            &["--from=10", "--to=5"],
            "--from 10 is after --to 5: give the earlier time to --from; the entries of the record \
             are from 0.000 s to 0.",
        ),
        (&["--stats", "--format=csv"], "--stats has no csv"),
    ] {
        let error = refused(arguments);
        assert!(error.contains(expected), "{error}");
    }
}

#[test]
fn a_range_without_an_entry_is_refused_with_the_times_of_the_record() {
    // The record begins at 2026-05-28T20:26:40Z.
    for (arguments, expected) in [
        (&["--from=100"][..], "--from 100 leaves nothing of "),
        (
            &["--from=2026-05-28T20:27:00Z"],
            "--from 2026-05-28T20:27:00Z leaves nothing of ",
        ),
        (
            &["--to=2026-05-28T20:26:39Z"],
            "--to 2026-05-28T20:26:39Z leaves nothing of ",
        ),
        (
            &["--from=2026-05-28T20:26:40.005Z", "--to=0"],
            "--from 2026-05-28T20:26:40.005Z is after --to 0",
        ),
    ] {
        for stats in [&[][..], &["--stats"]] {
            let error = refused(&[arguments, stats].concat());
            assert!(error.contains(expected), "{error}");
            assert!(error.contains("entries "), "{error}");
            assert!(error.contains("(2026-05-28T20:26:40"), "{error}");
        }
    }
}

#[test]
fn a_range_with_entries_of_other_topics_alone_is_empty() {
    let rows = printed(&["--topic=drops", "--to=0.0001"]);
    assert_eq!(rows.lines().count(), 1, "{rows}");
}

#[test]
fn a_word_that_some_topic_of_several_can_have_is_accepted() {
    // `failsafe` is a mode of the board and none of the host.
    let rows = printed(&["--topic=tick,telemetry", "--where=mode=failsafe"]);
    assert_eq!(rows.lines().count(), 1, "{rows}");
    let error = refused(&["--topic=tick", "--where=mode=failsafe"]);
    assert!(error.contains("mode is never \"failsafe\""), "{error}");
}
