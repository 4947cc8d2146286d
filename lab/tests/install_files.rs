//! The files for shells and manuals.

use std::{
    fs,
    process::{Command, Output},
};

fn run(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_singletrack-lab"))
        .args(arguments)
        .output()
        .unwrap()
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8(bytes.to_vec()).unwrap()
}

#[test]
fn singletrack_lists_and_passes_on_the_commands_of_this_program() {
    let help = text(&run(&["--help"]).stdout);
    let (_, commands) = help.split_once("Commands:\n").unwrap();
    let (commands, _) = commands.split_once("\n\n").unwrap();
    // A line that is too long goes on below, without a name.
    let words = |text: &str| text.split_whitespace().collect::<Vec<_>>().join(" ");
    let known = words(commands);
    let known = known.split_once(" help Print").unwrap().0;
    let mut listed = String::new();
    for (name, about) in singletrack::lab::commands() {
        listed += &format!("{name} {about} ");
    }
    assert_eq!(known, listed.trim_end());
}

#[test]
fn completions_are_printed_for_a_shell() {
    for (shell, word) in [
        ("bash", "complete"),
        ("zsh", "#compdef"),
        ("fish", "complete -c"),
    ] {
        let output = run(&["completions", shell]);
        let printed = text(&output.stdout);
        assert!(output.status.success() && printed.contains(word), "{shell}");
        assert!(
            printed.contains("bring-up") && printed.contains("stability"),
            "{shell}"
        );
    }
    assert!(!run(&["completions", "csh"]).status.success());
}

#[test]
fn completions_and_manual_pages_name_every_command() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().to_str().unwrap();
    let output = run(&["install-files", "--out", out]);
    assert!(output.status.success(), "{}", text(&output.stderr));
    let read = |path: &str| {
        let file = folder.path().join(path);
        let text = fs::read_to_string(&file).unwrap_or_default();
        assert!(text.len() > 300, "{path} has {} bytes", text.len());
        text
    };
    let command = singletrack::lab::listed(singletrack::program::command());
    let commands: Vec<String> = command
        .get_subcommands()
        .map(|one| one.get_name().to_owned())
        .collect();
    assert!(commands.len() >= 20, "{commands:?}");
    let page = read("man/singletrack.1");
    for shell in [
        "bash/singletrack.bash",
        "zsh/_singletrack",
        "fish/singletrack.fish",
    ] {
        let completions = read(shell);
        assert!(!completions.contains("install-files"), "it is for packages");
        for command in &commands {
            assert!(completions.contains(command.as_str()), "{shell}: {command}");
        }
    }
    for command in &commands {
        // A hyphen is escaped on a page.
        let escaped = command.replace('-', "\\-");
        assert!(
            page.contains(&format!("singletrack\\-{escaped}(1)")),
            "{command}"
        );
        let own = read(&format!("man/singletrack-{command}.1"));
        assert!(own.contains(".SH SYNOPSIS"), "{command}");
    }
    assert!(!page.contains("install\\-files"), "it is for packages");
    for daemon in [
        "man/singletrackd.1",
        "bash/singletrackd.bash",
        "zsh/_singletrackd",
        "fish/singletrackd.fish",
    ] {
        let text = read(daemon).replace("\\-", "-");
        for option in ["config", "check", "log-format"] {
            assert!(text.contains(option), "{daemon}: {option}");
        }
    }
    for simulator in [
        "man/singletrack-sim.1",
        "bash/singletrack-sim.bash",
        "zsh/_singletrack-sim",
        "fish/singletrack-sim.fish",
    ] {
        assert!(read(simulator).contains("hands"), "{simulator}");
    }
    // Again, over those of another release.
    assert!(run(&["install-files", "--out", out]).status.success());
}

#[test]
fn a_folder_that_can_not_be_written_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("file");
    fs::write(&file, "").unwrap();
    let output = run(&["install-files", "--out", file.to_str().unwrap()]);
    assert_eq!(output.status.code(), Some(1));
    let error = text(&output.stderr);
    assert!(
        error.contains("file/bash") && error.contains("--out"),
        "{error}"
    );
}
