//! `cargo release`: all files of a release in one folder. It publishes nothing.

use std::{
    ffi::OsStr,
    path::{Path, PathBuf},
};

use crate::{
    deb,
    notes::{self, VERSION},
    odroid, options, prerequisites,
    process::{Result, check, command, failure, require, text},
    programs::{INSTALLED, NODE, PUBLISHED, Packages, check_published},
    python,
    step::{ALL, ALWAYS, Step, demo_s, row, run_all},
    web,
    workspace::{emptied, put, root, script, target, write},
};

pub(crate) const USAGE: &str = "\
usage: cargo release [--tag TAG] [--without STEP[,STEP...]]

Make the files of a release in target/release-VERSION/: notes, licences, crates, book, Debian
packages, container image, wheels and checksums; and drive with them. Needs Debian 12 on x86-64,
and installs missing packages. Publishes nothing.

  --tag TAG       make the release of this tag, such as v0.1.0: the version, the changelog and a
                  clean checkout are required, and all steps
  --without STEP  leave out crates, book, debian, drive, image or wheels
  -h, --help      print this help
";

/// The folder of the files, in the target folder.
const FOLDER: &str = concat!("release-", env!("CARGO_PKG_VERSION"));

/// Debian's names of the architectures. The first is that of the container image, which is made of
/// its packages.
const ARCHITECTURES: [&str; 3] = ["amd64", "arm64", "armhf"];

/// What is made, in order. The image is made of a Debian package.
#[rustfmt::skip]
const STEPS: [Step; 8] = [
    row("notes", 0.03, ALWAYS, "release notes, and the licences of all libraries", write_notes),
    row("crates", 0.21, ALL, "the packages of crates.io, in their order", crates),
    row("book", 2.9, ALL, "the site, with the laboratory",
        |_| run("book", web::build_published()?)),
    row("debian", 14.2, ALL, "the Debian packages", debian),
    row("drive", 4.5, ALL,
        "the packaged daemon drives a simulated board; optimised here and for the Odroid, the bits are the same",
        drive),
    row("image", 0.16, ALL, "the container image of the simulator",
        |_| run("image", ARCHITECTURES[0])),
    row("wheels", 5.3, ALL, "the Python package", |_| python::make_wheels(&folder()?)),
    row("checksums", 0.03, ALWAYS, "SHA256SUMS", |_| run("checksums", "")),
];

/// What a command line asks for.
#[derive(Debug, Default, PartialEq, Eq)]
pub(crate) struct Plan<'a> {
    tag: Option<&'a str>,
    without: Vec<&'a str>,
}

pub(crate) fn main(arguments: &[String]) -> Result {
    let Plan { tag, without } = parse(arguments)?;
    let newest = notes::newest()?;
    let git = tag.map(|_| "git");
    let podman = (!without.contains(&"image")).then_some("podman");
    let wasm = (!without.contains(&"book")).then_some("wasm");
    prerequisites::ensure([git, podman, wasm].into_iter().flatten())?;
    if let Some(tag) = tag {
        newest.check_tag(tag)?;
        check_clean()?;
    }
    emptied(FOLDER)?;
    run_all(&steps(&without), &Packages::Default, demo_s()?)?;
    if !without.is_empty() {
        println!("NOT A RELEASE: without {}", without.join(", "));
    }
    Ok(())
}

fn steps(without: &[&str]) -> Vec<Step> {
    let steps = STEPS.into_iter();
    steps.filter(|step| !without.contains(&step.name)).collect()
}

pub(crate) fn parse(arguments: &[String]) -> Result<Plan<'_>> {
    let mut plan = Plan::default();
    for option in options(arguments, &["--tag", "--without"]) {
        match option {
            ("--tag", Some(tag)) => plan.tag = Some(tag),
            ("--without", Some(names)) => plan.without.extend(names.split(',')),
            (option, _) => return Err(failure!("unexpected argument {option:?}\n\n{USAGE}")),
        }
    }
    for name in &plan.without {
        let mut steps = STEPS.iter();
        let known = steps.any(|step| step.needs == ALL && step.name == *name);
        require!(known, "--without {name:?} is no such step\n\n{USAGE}");
    }
    let is_whole = plan.tag.is_none() || plan.without.is_empty();
    let wanted = "a release has all steps: --tag or --without";
    require!(is_whole, "{wanted}\n\n{USAGE}");
    Ok(plan)
}

/// Checks that the files are those of a commit.
fn check_clean() -> Result {
    // In a container, the checkout belongs to another user.
    let mut git = command("git -c safe.directory=* status --porcelain");
    let changes = text(git.current_dir(root()))?;
    require!(
        changes.is_empty(),
        "the checkout has changes, commit them:\n{changes}"
    );
    Ok(())
}

/// The folder of the files.
fn folder() -> Result<PathBuf> {
    Ok(target()?.join(FOLDER))
}

/// Copies a file into the folder.
fn take(file: &Path) -> Result {
    let name = file.file_name().unwrap_or_default();
    put(file, &folder()?.join(name))
}

/// A step that only runs programs.
fn run(step: &str, argument: impl AsRef<OsStr>) -> Result {
    let mut run = script("xtask/src/release.sh");
    run.arg(step).args([folder()?, target()?]);
    check(run.arg(VERSION).arg(argument))
}

fn write_notes(_: &Packages) -> Result {
    let programs = [&INSTALLED[..], &[NODE, python::MODULE]].concat();
    let licences = notes::licences(&programs, &notes::TARGETS)?;
    write(&folder()?.join("LICENCES.txt"), licences)?;
    write(&folder()?.join("notes.md"), notes::newest()?.text)
}

fn crates(_: &Packages) -> Result {
    // The list of the licences has downloaded what they need.
    check_published()?;
    let packed = target()?.join("package");
    for package in PUBLISHED {
        take(&packed.join(format!("{package}-{VERSION}.crate")))?;
    }
    Ok(())
}

fn debian(_: &Packages) -> Result {
    for architecture in ARCHITECTURES {
        for package in deb::make(Some(architecture))? {
            take(&package)?;
        }
    }
    Ok(())
}

/// The daemon of this machine's package, in the suite that else has that of the tests.
fn drive(packages: &Packages) -> Result {
    odroid::compare_installed(packages)?;
    let mut suite = Packages::Default.tests("--test hil -- --daemon")?;
    suite.arg(target()?.join("release/singletrackd"));
    check(suite.arg("drive"))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn words(line: &str) -> Vec<String> {
        line.split_whitespace().map(str::to_owned).collect()
    }

    #[test]
    fn steps_can_be_left_out() {
        let made = |line: &str| {
            let made = steps(&parse(&words(line)).unwrap().without);
            made.iter().map(|step| step.name).collect::<Vec<_>>()
        };
        assert_eq!(made("").len(), STEPS.len());
        assert_eq!(
            made("--without image,wheels --without=book"),
            ["notes", "crates", "debian", "drive", "checksums"]
        );
    }

    #[test]
    fn a_release_has_all_steps() {
        let tagged = words("--tag v1.2.3");
        assert_eq!(parse(&tagged).unwrap().tag, Some("v1.2.3"));
        let why = parse(&words("--tag v1.2.3 --without book")).unwrap_err();
        assert!(why.to_string().contains("all steps"), "{why}");
    }

    #[test]
    fn other_arguments_are_refused_with_the_usage() {
        for line in [
            "v1.2.3",
            "--tag",
            "--without",
            "--without checksums",
            "--all",
        ] {
            let why = parse(&words(line)).unwrap_err().to_string();
            assert!(why.contains(USAGE), "{line}: {why}");
        }
    }
}
