//! Runs the blocks of a page in a folder that looks like a clone of the repository.
//!
//! The folder holds links to the files of the repository, so that nothing is written to it. Pages
//! run beside each other: each has its own address of the loopback network for the cameras, and
//! `/tmp` in its commands is its own folder.

use std::{
    fs,
    os::unix::fs::{PermissionsExt, symlink},
    path::Path,
    process::Command,
    sync::{PoisonError, RwLock},
};

use libtest_mimic::Failed;
use singletrack_book::{Block, Kind};
use tempfile::TempDir;

use crate::{Page, programs, root};

/// Functions for the commands.
const PRELUDE: &str = include_str!("prelude.sh");

/// Pages with a simulated car run alone: it is simulated in real time.
static MACHINE: RwLock<()> = RwLock::new(());

/// How often such a page is tried on a machine that is too busy for the simulated car.
const MOST_TRIES: usize = 5;

/// What the daemon says when the simulated car, or itself, was not given the processor.
const STARVED: [&str; 3] = [
    "frames of the motion capture have stopped",
    "board lost: silence",
    "dropped for want of room",
];

/// Runs a page's blocks in order, in one shell.
pub(crate) fn run(page: &Page, number: usize) -> Result<(), Failed> {
    let is_real_time = page
        .blocks
        .iter()
        .any(|block| block.kinds.contains(&Kind::Car) || block.kinds.contains(&Kind::Background));
    if !is_real_time {
        let _others = MACHINE.read().unwrap_or_else(PoisonError::into_inner);
        return run_once(page, number);
    }
    let _alone = MACHINE.write().unwrap_or_else(PoisonError::into_inner);
    let mut tries = 1;
    loop {
        let result = run_once(page, number);
        let is_starved = result.as_ref().is_err_and(|failed| {
            let said = failed.message().unwrap_or_default();
            STARVED.iter().any(|words| said.contains(words))
        });
        if !is_starved || tries == MOST_TRIES {
            return result;
        }
        eprintln!(
            "{}: the machine was too busy for the simulated car; again",
            page.name
        );
        tries += 1;
    }
}

fn run_once(page: &Page, number: usize) -> Result<(), Failed> {
    let scratch = TempDir::with_prefix("book-")?;
    let folder = scratch.path();
    let address = format!("127.34.0.{}", number + 1);
    clone(&folder.join("clone"))?;
    wrap_programs(&folder.join("bin"), &address)?;
    fs::create_dir(folder.join("tmp"))?;
    let mut script = PRELUDE.to_owned();
    let starts_daemon = page.blocks.iter().any(|block| {
        block.runs()
            && !block.kinds.contains(&Kind::Car)
            && block.text.contains("singletrackd --config")
    });
    for block in page.blocks.iter().filter(|block| block.runs()) {
        script.push_str(&commands(page, block, starts_daemon)?);
    }
    script.push_str("finish\n");
    let script = script
        .replace("/tmp/", &format!("{}/tmp/", folder.display()))
        .replace("127.0.0.1", &address);
    fs::write(folder.join("script"), &script)?;
    let output = Command::new("timeout")
        .args(["--kill-after=5", "90", "bash"])
        .arg(folder.join("script"))
        .current_dir(folder.join("clone"))
        .env(
            "PATH",
            format!("{}:/usr/bin:/bin", folder.join("bin").display()),
        )
        .env("SCRATCH", folder)
        .env_remove("SINGLETRACK_SOCKET")
        .env("TERM", "dumb")
        .output()?;
    if output.status.success() {
        return Ok(());
    }
    let tail = |bytes: &[u8]| {
        let text = String::from_utf8_lossy(bytes).into_owned();
        let lines: Vec<&str> = text.lines().collect();
        lines[lines.len().saturating_sub(30)..].join("\n")
    };
    let (said, complained) = (tail(&output.stdout), tail(&output.stderr));
    Err(format!(
        "{}: {}\n{said}\n---\n{complained}",
        page.name, output.status
    )
    .into())
}

/// The commands that run a block.
fn commands(page: &Page, block: &Block, starts_daemon: bool) -> Result<String, Failed> {
    let is = |kind| block.kinds.contains(&kind);
    let mut text = format!("at '{}:{}'\n", page.name, block.line);
    if is(Kind::Car) {
        text.push_str(if starts_daemon {
            "await_ready\n"
        } else {
            "car\n"
        });
    }
    let joined = block.text.replace("\\\n", " ");
    let lines = joined
        .lines()
        .map(|line| line.split(" #").next().unwrap_or_default().trim())
        .filter(|line| !line.is_empty() && !line.starts_with('#'));
    match (is(Kind::Background), is(Kind::Interrupted)) {
        (true, _) => {
            let lines: Vec<&str> = lines.collect();
            let [line] = lines.as_slice() else {
                return Err("a block in the background has one command".into());
            };
            text.push_str(&format!("{line} &\n"));
        }
        (_, true) => {
            for line in lines {
                text.push_str(&format!("interrupted '{}'\n", line.replace('\'', "'\\''")));
            }
        }
        _ => text.push_str(&block.text),
    }
    Ok(text)
}

/// A folder with links to the repository's files, whose own folders can be written to.
fn clone(folder: &Path) -> Result<(), Failed> {
    fs::create_dir_all(folder)?;
    for entry in fs::read_dir(root())? {
        let entry = entry?;
        let name = entry.file_name();
        if name != "target" && name != ".git" {
            symlink(entry.path(), folder.join(name))?;
        }
    }
    Ok(())
}

/// The programs; the simulator at the page's own address.
fn wrap_programs(folder: &Path, address: &str) -> Result<(), Failed> {
    fs::create_dir_all(folder)?;
    for name in [
        "singletrack",
        "singletrackd",
        "singletrack-lab",
        "singletrack-sim",
        "singletrack-faults",
    ] {
        let program = programs().join(name);
        if !program.is_file() {
            let advice = "cargo build --bins";
            return Err(format!("{} is missing: {advice}", program.display()).into());
        }
        if name == "singletrack-sim" {
            let file = folder.join(name);
            let port = "\"$SCRATCH/tmp/singletrack-board\"";
            let options = format!("--interface {address} --port {port}");
            let text = format!(
                "#!/bin/sh\n# Ahead of other programs where the system allows it, as the daemon.\n\
                 if chrt --rr 20 true 2> /dev/null; then ahead='chrt --rr 20'; fi\n\
                 exec ${{ahead:-}} {} {options} \"$@\"\n",
                program.display()
            );
            fs::write(&file, text)?;
            fs::set_permissions(&file, fs::Permissions::from_mode(0o755))?;
        } else {
            symlink(program, folder.join(name))?;
        }
    }
    Ok(())
}
