//! Records.

use std::{
    fs,
    io::{BufRead, BufReader, Read},
    process::Stdio,
};

use singletrack_record::part_path;

use crate::fixture::{assert_case, command, dump, recorder, telemetry, text};

#[test]
fn every_topic_is_printed_in_every_format() {
    let folder = tempfile::tempdir().unwrap();
    let (recorder, path) = recorder(folder.path());
    recorder.finish().unwrap();
    for topic in ["tick", "telemetry", "status", "pose", "log", "drops"] {
        for format in ["table", "json", "csv"] {
            let output = dump(&path, &["--topic", topic, "--format", format]);
            assert_eq!(text(&output.stderr), "");
            assert!(output.status.success());
            assert_case(&format!("{topic}.{format}"), &text(&output.stdout));
        }
    }
}

#[test]
fn chosen_fields_are_printed_in_the_order_given() {
    let folder = tempfile::tempdir().unwrap();
    let (recorder, path) = recorder(folder.path());
    recorder.finish().unwrap();
    for format in ["table", "json", "csv"] {
        let fields = "estimate.yaw_rad,tick,estimate.sideslip_rad,events";
        let arguments = ["--topic=tick", "--format", format, "--fields", fields];
        let output = dump(&path, &arguments);
        assert_case(&format!("fields.{format}"), &text(&output.stdout));
    }
}

#[test]
fn without_a_terminal_telemetry_is_printed_as_csv() {
    let folder = tempfile::tempdir().unwrap();
    let (recorder, path) = recorder(folder.path());
    recorder.finish().unwrap();
    let output = dump(&path, &[]);
    assert_case("telemetry.csv", &text(&output.stdout));
}

#[test]
fn an_unfinished_record_is_found_printed_and_said_to_be_one() {
    let folder = tempfile::tempdir().unwrap();
    let (recorder, path) = recorder(folder.path());
    for source in [part_path(&path), path] {
        let output = dump(&source, &["--format", "json"]);
        assert!(output.status.success());
        assert_case("telemetry.json", &text(&output.stdout));
        let note = text(&output.stderr);
        assert!(note.contains("stops after 9 entries"), "{note}");
    }
    drop(recorder);
}

#[test]
fn a_record_being_written_is_followed_to_its_end() {
    let folder = tempfile::tempdir().unwrap();
    let (mut recorder, path) = recorder(folder.path());
    let mut child = command(&path, &["--follow", "--fields=last_sequence"])
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    let mut lines = BufReader::new(child.stdout.take().unwrap()).lines();
    let mut next = || lines.next().unwrap().unwrap();
    assert_eq!([next(), next(), next()], ["last_sequence", "0", "1"]);
    recorder.write(&telemetry(2)).unwrap();
    recorder.flush().unwrap();
    assert_eq!(next(), "2");
    recorder.finish().unwrap();
    assert!(lines.next().is_none());
    assert!(child.wait().unwrap().success());
}

#[test]
fn a_record_being_written_is_followed_in_every_format_and_counted() {
    let folder = tempfile::tempdir().unwrap();
    let (mut recorder, path) = recorder(folder.path());
    let followed = |arguments: &[&str]| {
        command(&path, &[&["--follow"], arguments].concat())
            .stdout(Stdio::piped())
            .spawn()
            .unwrap()
    };
    let fields = "--fields=last_sequence,mode";
    let filter = "--where=last_sequence!=1";
    let children = [
        followed(&["--format=json", fields, filter]),
        followed(&["--format=table", fields, filter]),
        followed(&["--format=json", "--stats"]),
    ];
    recorder.write(&telemetry(2)).unwrap();
    recorder.finish().unwrap();
    let [json, table, stats] =
        children.map(|child| text(&child.wait_with_output().unwrap().stdout));
    assert_eq!(
        json,
        "{\"topic\":\"telemetry\",\"last_sequence\":0,\"mode\":\"driving\"}\n\
         {\"topic\":\"telemetry\",\"last_sequence\":2,\"mode\":\"driving\"}\n"
    );
    assert_eq!(
        table,
        "last_sequence      mode\n            0   driving\n            2   driving\n"
    );
    let stats: serde_json::Value = serde_json::from_str(&stats).unwrap();
    assert_eq!(stats["unfinished"], false);
    assert_eq!(stats["topics"][1]["count"], 3);
}

#[test]
fn a_record_of_another_version_is_refused_with_who_can_read_it() {
    let folder = tempfile::tempdir().unwrap();
    let (recorder, path) = recorder(folder.path());
    recorder.finish().unwrap();
    let mut bytes = fs::read(&path).unwrap();
    let version = singletrack_record::RECORD_VERSION.to_string();
    let length = u32::try_from(version.len()).unwrap().to_le_bytes();
    let entry = [b"record_version", &length[..], version.as_bytes()].concat();
    let at = bytes.windows(entry.len()).position(|part| part == entry);
    let end = at.unwrap() + entry.len();
    bytes[end - version.len()..end].fill(b'9');
    let other = "9".repeat(version.len());
    fs::write(&path, bytes).unwrap();
    let output = dump(&path, &[]);
    assert!(!output.status.success());
    assert_eq!(text(&output.stdout), "");
    let error = text(&output.stderr);
    assert!(
        error.contains(&format!(
            "is a record of version {other}; this program reads version {version}"
        )),
        "{error}"
    );
    assert!(
        error.contains("use the singletrack of the release that wrote it"),
        "{error}"
    );
}

#[test]
fn a_closed_pipe_is_success() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("long.mcap");
    let (recorder, other) = recorder(folder.path());
    recorder.finish().unwrap();
    fs::rename(other, &path).unwrap();
    let (mut recorder, path) = crate::fixture::recorder(folder.path());
    for index in 0..20_000_u32 {
        recorder.write(&telemetry(index as u8)).unwrap();
    }
    recorder.finish().unwrap();
    let mut child = command(&path, &["--format=json"])
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    // Far more is printed than a pipe holds.
    let mut first = [0; 10];
    child.stdout.take().unwrap().read_exact(&mut first).unwrap();
    let output = child.wait_with_output().unwrap();
    assert_eq!(text(&output.stderr), "");
    assert!(output.status.success());
}

#[test]
fn errors_name_the_file_and_what_to_do() {
    let folder = tempfile::tempdir().unwrap();
    let notes = folder.path().join("notes.txt");
    fs::write(&notes, "only some notes").unwrap();
    let pretended = folder.path().join("notes.mcap");
    fs::write(&pretended, "only some notes").unwrap();
    let (recorder, path) = recorder(folder.path());
    recorder.finish().unwrap();
    let missing = folder.path().join("missing.mcap");
    for (source, arguments, expected) in [
        (
            &notes,
            &[][..],
            "notes.txt holds no whole frame of the protocol in 15 bytes: name a capture",
        ),
        (
            &pretended,
            &[],
            "notes.mcap is not an MCAP file: name a record",
        ),
        (&missing, &[], "can't open"),
        (&missing, &[], "missing.mcap"),
        (
            &path,
            &["--fields=yaw_rate"],
            "did you mean \"yaw_rate_mrad_s\"?",
        ),
        (
            &path,
            &["--fields=colour"],
            "telemetry has no field \"colour\"; its fields are receive_time_ns,",
        ),
        (
            &path,
            &["--topic=poses"],
            "there is no topic \"poses\" (did you mean \"pose\"?): use tick, telemetry",
        ),
    ] {
        let output = dump(source, arguments);
        let error = text(&output.stderr);
        assert!(!output.status.success(), "{expected}");
        assert!(error.contains(expected), "{error}");
    }
}
