//! What all commands have in common: exit statuses, spellings, colours, and the files for shells
//! and manuals.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test may fail")]

#[allow(dead_code, reason = "status is tried with keys as well")]
use std::{
    io::{BufRead, BufReader, Write},
    os::unix::net::UnixListener,
    process::{Command, Output},
    thread,
};

use crate::pty::OnTerminal;

const PAGE: &str = include_str!("../../../docs/command-line.md");

fn singletrack(arguments: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_singletrack"));
    command.args(arguments);
    command
}

fn run(arguments: &[&str]) -> Output {
    singletrack(arguments).output().unwrap()
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8(bytes.to_vec()).unwrap()
}

/// The commands that --help lists.
pub(crate) fn commands() -> Vec<String> {
    let help = text(&run(&["--help"]).stdout);
    let names = help
        .lines()
        .take_while(|line| *line != "Options:")
        .filter_map(|line| line.strip_prefix("  "))
        .filter(|line| !line.starts_with(' '))
        .filter_map(|line| line.split_whitespace().next())
        .map(ToOwned::to_owned);
    names.collect()
}

#[test]
fn the_help_lists_the_commands_by_what_they_are_for() {
    for help in ["--help", "-h", "help"] {
        let help = text(&run(&[help]).stdout);
        let headings = help.lines().filter(|line| line.ends_with(':'));
        let headings: Vec<_> = headings.filter(|line| !line.starts_with(' ')).collect();
        assert_eq!(
            headings.get(..5),
            Some(
                &[
                    "Drive:",
                    "Set up a car:",
                    "Look:",
                    "Simulate and analyse:",
                    "Options:"
                ][..]
            ),
            "{help}"
        );
        assert!(
            help.lines().all(|line| line.chars().count() <= 100),
            "{help}"
        );
        assert!(
            help.contains("  arm            Arm the car and start driving;"),
            "{help}"
        );
        assert!(help.contains("--version"), "{help}");
    }
}

#[test]
fn the_exit_status_is_the_documented_one() {
    let folder = tempfile::tempdir().unwrap();
    let socket = folder.path().join("socket");
    let listener = UnixListener::bind(&socket).unwrap();
    thread::spawn(move || {
        for client in listener.incoming() {
            let mut client = client.unwrap();
            let mut asked = String::new();
            let mut reader = BufReader::new(client.try_clone().unwrap());
            reader.read_line(&mut asked).unwrap();
            writeln!(client, r#"{{"version":3,"ok":true}}"#).unwrap();
            if asked.contains("timed") {
                let ended = r#"{"ended":{"mode":"idle","reason":"outside-fence"}}"#;
                writeln!(client, r#"{{"version":3,{}"#, &ended[1..]).unwrap();
            }
        }
    });
    let socket = socket.to_str().unwrap();
    for (expected, arguments) in [
        (0, &["status", "--socket", socket][..]),
        (0, &["disarm", "--socket", socket]),
        (1, &["status", "--socket", "/nowhere/socket"]),
        (1, &["dump", "/nowhere/drive.mcap"]),
        (1, &["recover", "/nowhere/drive.mcap.part"]),
        (2, &["status", "--json", "--watch"]),
        (2, &["dump"]),
        (2, &["recover", "drive.mcap", "--colour"]),
        (2, &["stpo"]),
        (3, &["arm", "--for", "1s", "--socket", socket]),
    ] {
        let output = run(arguments);
        assert_eq!(
            output.status.code(),
            Some(expected),
            "{arguments:?}: {output:?}"
        );
        // What went wrong is said, and nowhere else than on standard error.
        assert_eq!(expected == 1 || expected == 2, !output.stderr.is_empty());
        let row = format!("\n- {expected}: ");
        assert!(PAGE.contains(&row), "no row {row} on the page");
    }
}

#[test]
fn a_request_to_tune_takes_both_quantities_and_refuses_what_is_no_number() {
    let tune = |arguments: &[&str]| {
        let folder = tempfile::tempdir().unwrap();
        let nowhere = folder.path().join("nowhere.sock");
        let output = singletrack(&["tune", "--socket", nowhere.to_str().unwrap()])
            .args(arguments)
            .output()
            .unwrap();
        (output.status.code(), text(&output.stderr))
    };
    for accepted in [
        &["--gain", "2", "--point-distance", "0.4"][..],
        &["--gain", "2,1.5"],
        &["--point-distance", "0.4"],
    ] {
        let (code, said) = tune(accepted);
        assert!(
            said.contains("can't reach the daemon"),
            "{accepted:?}: {said}"
        );
        assert_eq!(code, Some(1));
    }
    for refused in [&[][..], &["--gain", "2,x"], &["--point-distance", "nan"]] {
        assert_eq!(tune(refused).0, Some(2), "{refused:?}");
    }
}

#[test]
fn no_message_has_colours_where_they_are_not_wanted() {
    let error = |no_color: &str| {
        let mut command = singletrack(&["status", "--colour"]);
        command.env("NO_COLOR", no_color);
        let mut shell = Command::new("sh");
        // The message goes to standard error.
        shell.args(["-c", "exec \"$0\" status --colour 2>&1"]);
        shell.arg(env!("CARGO_BIN_EXE_singletrack"));
        shell.env("NO_COLOR", no_color);
        let (status, seen, _) = OnTerminal::start(shell).end();
        assert_eq!(status.code(), Some(2));
        seen
    };
    assert!(error("").contains("\x1b["), "the test can't fail");
    let plain = error("1");
    assert!(
        !plain.contains('\x1b') && plain.contains("--colour"),
        "{plain:?}"
    );
}

#[test]
fn the_page_names_every_variable_that_help_names() {
    let help = text(&run(&["--help"]).stdout);
    for variable in ["SINGLETRACK_SOCKET", "NO_COLOR"] {
        assert!(
            help.contains(variable) && PAGE.contains(variable),
            "{variable}"
        );
    }
}

#[test]
fn a_command_of_the_laboratory_without_it_names_the_program_and_how_to_get_it() {
    let folder = tempfile::tempdir().unwrap();
    let alone = folder.path().join("singletrack");
    std::fs::copy(env!("CARGO_BIN_EXE_singletrack"), &alone).unwrap();
    let output = Command::new(&alone)
        .args(["stability", "--help"])
        .env("PATH", folder.path())
        .output()
        .unwrap();
    assert_eq!(output.status.code(), Some(1));
    let error = text(&output.stderr);
    for part in [
        "singletrack-lab",
        "cargo build --release -p singletrack-lab",
    ] {
        assert!(error.contains(part), "{error}");
    }
}
