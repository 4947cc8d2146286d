//! Checks of a package: by lintian, its files, and its programs as they are after installation.

use std::{fs, path::Path, process::Command};

use super::{Architecture, PROGRAMS, pack::stage};
use crate::process::{Failure, output, silent};

/// Shells, and where each looks for the completions of a program.
const COMPLETIONS: [(&str, &str, &str); 3] = [
    ("usr/share/bash-completion/completions/", "", ""),
    ("usr/share/zsh/vendor-completions/", "_", ""),
    ("usr/share/fish/vendor_completions.d/", "", ".fish"),
];

/// Files that the package must have, besides programs, completions and manual pages.
const FILES: [&str; 8] = [
    "lib/systemd/system/singletrackd.service",
    "lib/udev/rules.d/99-singletrack.rules",
    "usr/lib/sysusers.d/singletrack.conf",
    "usr/lib/modules-load.d/singletrack.conf",
    "usr/share/singletrack/singletrackd.example.toml",
    "usr/share/doc/singletrack/copyright",
    "usr/share/doc/singletrack/libraries.txt.gz",
    "usr/share/doc/singletrack/examples/xu4.conf",
];

const IMAGE: &str = "usr/share/singletrack/singletrack-uno.hex";

/// Programs without completions: they have one argument, or few options.
const WITHOUT_COMPLETIONS: &str = "singletrack-newcomer";

/// Checks a package.
pub(super) fn inspect(
    architecture: Architecture,
    package: &Path,
    has_image: bool,
) -> Result<(), Failure> {
    lint(package)?;
    let folder = stage(architecture)?.join("unpacked");
    silent(
        Command::new("dpkg-deb")
            .arg("--extract")
            .args([package, &folder]),
    )?;
    for file in FILES.into_iter().chain(has_image.then_some(IMAGE)) {
        present(&folder, file)?;
    }
    for (program, _) in PROGRAMS {
        for (place, before, after) in COMPLETIONS {
            if program != WITHOUT_COMPLETIONS {
                present(&folder, &format!("{place}{before}{program}{after}"))?;
            }
        }
    }
    let pages = manual_pages(&folder)?;
    completes(&folder)?;
    run(architecture, &folder)?;
    println!("{}: {pages} manual pages", package.display());
    Ok(())
}

/// Checks that lintian finds neither errors nor warnings.
fn lint(package: &Path) -> Result<(), Failure> {
    silent(
        Command::new("lintian")
            .args(["--allow-root", "--fail-on", "error,warning"])
            .arg(package),
    )
}

fn present(folder: &Path, file: &str) -> Result<(), Failure> {
    let length = fs::metadata(folder.join(file)).map_or(0, |file| file.len());
    if length == 0 {
        return Err(Failure::new(format!("the package has no {file}")));
    }
    Ok(())
}

/// Renders every manual page, and returns their number: a program without one is refused.
fn manual_pages(folder: &Path) -> Result<usize, Failure> {
    for (program, _) in PROGRAMS {
        present(folder, &format!("usr/share/man/man1/{program}.1.gz"))?;
    }
    let pages = folder.join("usr/share/man/man1");
    let failed = |error| Failure::new(format!("can't read {}: {error}", pages.display()));
    let mut number = 0;
    for page in fs::read_dir(&pages).map_err(failed)? {
        let page = page.map_err(failed)?.path();
        let rendered = Command::new("man")
            .env("LC_ALL", "C.UTF-8")
            // Narrower, groff complains about lines with one long word.
            .env("MANWIDTH", "120")
            .args(["--warnings", "--local-file"])
            .arg(&page)
            .output()
            .map_err(|error| Failure::new(format!("man does not start: {error}")))?;
        let text = String::from_utf8_lossy(&rendered.stdout);
        let is_whole = text.contains("NAME") && text.contains("SYNOPSIS");
        let is_clean = rendered.status.success() && rendered.stderr.is_empty();
        if !(is_whole && is_clean) {
            return Err(Failure::new(format!(
                "man {}: {}\n{}",
                page.display(),
                rendered.status,
                String::from_utf8_lossy(&rendered.stderr)
            )));
        }
        number += 1;
    }
    Ok(number)
}

/// Lets bash complete the name of a command.
fn completes(folder: &Path) -> Result<(), Failure> {
    let script = folder.join(COMPLETIONS[0].0).join("singletrack");
    let completed = output(
        Command::new("bash")
            .args(["--norc", "-c"])
            .arg(
                ". \"$0\"; COMP_WORDS=(singletrack calib) COMP_CWORD=1; \
                 _singletrack singletrack calib singletrack; echo \"${COMPREPLY[@]}\"",
            )
            .arg(script),
    )?;
    let completed = String::from_utf8_lossy(&completed);
    if completed.trim() != "calibrate" {
        return Err(Failure::new(format!(
            "bash completes `singletrack calib` with {completed:?}"
        )));
    }
    Ok(())
}

/// Runs the programs.
fn run(architecture: Architecture, folder: &Path) -> Result<(), Failure> {
    let command = |program: &str| architecture.run(&folder.join("usr/bin").join(program));
    for (program, _) in PROGRAMS {
        let version = output(command(program).arg("--version"))?;
        if version != format!("{program} {}\n", env!("CARGO_PKG_VERSION")).as_bytes() {
            return Err(Failure::new(format!(
                "{program} --version prints {:?}",
                String::from_utf8_lossy(&version)
            )));
        }
    }
    let share = folder.join("usr/share/singletrack");
    silent(
        command("singletrackd")
            .args(["--check", "--config"])
            .arg(share.join("singletrackd.example.toml")),
    )?;
    let drive = output(
        command("singletrack")
            .arg("simulate")
            .arg(share.join("scenarios/circle-car.toml"))
            .args(["--summary", "json"]),
    )?;
    if !drive.starts_with(b"{") {
        return Err(Failure::new(
            "singletrack simulate prints no summary".to_owned(),
        ));
    }
    silent(Command::new(folder.join("usr/bin/singletrack-flash")).arg("--help"))
}
