//! `cargo release`: all files of a release in one folder. It publishes nothing.

use std::{
    fs,
    path::{Path, PathBuf},
    process::Command,
};

use crate::{
    deb,
    notes::{self, VERSION},
    odroid, options, prerequisites,
    process::{At as _, Result, check, command, failure, require, silent, text},
    programs::{INSTALLED, NODE, PUBLISHED, Packages, check_published, release_build},
    python,
    step::{
        Scope::{All, Always},
        Step, demo_s, row, run_all,
    },
    target, web,
    workspace::{cargo, root},
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

/// The version of mdbook that makes the site.
const MDBOOK: &str = "0.5.4";

/// Debian's names of the architectures. The first is that of the container image, which is made of
/// its packages.
const ARCHITECTURES: [&str; 3] = ["amd64", "arm64", "armhf"];

/// What is made, in order. The image is made of a Debian package.
#[rustfmt::skip]
const STEPS: [Step; 8] = [
    row("notes", 0.03, Always, "release notes, and the licences of all libraries", write_notes),
    row("crates", 0.21, All, "the packages of crates.io, in their order", crates),
    row("book", 2.9, All, "the site, with the laboratory", book),
    row("debian", 14.2, All, "the Debian packages", debian),
    row("drive", 4.5, All,
        "the packaged daemon drives a simulated board; optimised here and for the Odroid, the bits are the same",
        drive),
    row("image", 0.16, All, "the container image of the simulator", image),
    row("wheels", 5.3, All, "the Python package", |_| python::make_wheels(&folder()?)),
    row("checksums", 0.03, Always, "SHA256SUMS", checksums),
];

/// What a command line asks for.
#[derive(Debug, Default, PartialEq, Eq)]
pub(crate) struct Plan {
    tag: Option<String>,
    without: Vec<String>,
}

pub(crate) fn main(arguments: &[String]) -> Result {
    let plan = parse(arguments)?;
    let newest = notes::newest()?;
    let git = plan.tag.as_ref().map(|_| "git");
    let podman = plan.has("image").then_some("podman");
    let wasm = plan.has("book").then_some("wasm");
    prerequisites::ensure(git.into_iter().chain(podman).chain(wasm))?;
    if let Some(tag) = &plan.tag {
        newest.check_tag(tag)?;
        check_clean()?;
    }
    target::emptied(FOLDER)?;
    let steps = STEPS.into_iter().filter(|step| plan.has(step.name));
    let steps: Vec<Step> = steps.collect();
    run_all(&steps, &Packages::Default, demo_s()?)?;
    if !plan.without.is_empty() {
        println!("NOT A RELEASE: without {}", plan.without.join(", "));
    }
    Ok(())
}

impl Plan {
    fn has(&self, step: &str) -> bool {
        !self.without.iter().any(|name| name == step)
    }
}

pub(crate) fn parse(arguments: &[String]) -> Result<Plan> {
    let mut plan = Plan::default();
    for option in options(arguments, &["--tag", "--without"]) {
        match option {
            ("--tag", Some(tag)) => plan.tag = Some(tag.to_owned()),
            ("--without", Some(names)) => plan.without.extend(names.split(',').map(str::to_owned)),
            (option, _) => return Err(failure!("unexpected argument {option:?}\n\n{USAGE}")),
        }
    }
    for name in &plan.without {
        let mut steps = STEPS.iter();
        let known = steps.any(|step| step.scope == All && step.name == name);
        require!(known, "--without {name:?} is no such step\n\n{USAGE}");
    }
    let is_whole = plan.tag.is_none() || plan.without.is_empty();
    require!(
        is_whole,
        "a release has all steps: --tag or --without\n\n{USAGE}"
    );
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
    Ok(target::folder()?.join(FOLDER))
}

fn write(name: &str, text: &str) -> Result {
    let path = folder()?.join(name);
    fs::write(&path, text).at(&path)
}

/// Copies a file into the folder.
fn take(file: &Path) -> Result {
    let name = file.file_name().unwrap_or_default();
    target::put(file, &folder()?.join(name))
}

fn write_notes(_: &Packages) -> Result {
    let programs = [&INSTALLED[..], &[NODE, python::MODULE]].concat();
    let licences = notes::licences(&programs, &notes::TARGETS)?;
    write("LICENCES.txt", &licences)?;
    write("notes.md", &notes::newest()?.text)
}

fn crates(_: &Packages) -> Result {
    // The list of the licences has downloaded what they need.
    check_published()?;
    let packed = target::folder()?.join("package");
    for package in PUBLISHED {
        take(&packed.join(format!("{package}-{VERSION}.crate")))?;
    }
    Ok(())
}

fn book(_: &Packages) -> Result {
    let target = target::folder()?;
    let tools = target.join("tools");
    let mut install = cargo("install --quiet --locked --no-default-features --features search");
    install.args(["--version", MDBOOK, "mdbook", "--root"]);
    check(install.arg(&tools))?;
    let site = target.join("book");
    let mut mdbook = Command::new(tools.join("bin/mdbook"));
    mdbook.args(["build", "docs", "--dest-dir"]).arg(&site);
    check(mdbook.current_dir(root()))?;
    target::copy(&web::build_published()?, &site.join("laboratory"))?;
    let archive = folder()?.join(format!("singletrack-book-{VERSION}.tar.gz"));
    target::pack(&site, &archive)
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
    let (_, programs) = release_build()?;
    let mut suite = Packages::Default.tests(Some("hil"))?;
    suite.arg("--daemon").arg(programs.join("singletrackd"));
    check(suite.arg("drive"))
}

fn image(_: &Packages) -> Result {
    let name = format!("singletrack-sim:{VERSION}");
    // In a container, and for root without all rights, no other isolation works.
    let mut build = command("podman build --quiet --isolation chroot --squash --tag");
    build.args([&name, "--file", "packaging/Containerfile.simulator"]);
    build.arg(target::folder()?.join("debian"));
    check(build.current_dir(root()))?;
    let file = format!("singletrack-sim_{VERSION}_{}.tar", ARCHITECTURES[0]);
    let mut save = command("podman save --quiet --format oci-archive --output");
    silent(save.arg(folder()?.join(file)).arg(&name))
}

fn checksums(_: &Packages) -> Result {
    let folder = folder()?;
    let files = fs::read_dir(&folder).at(&folder)?.flatten();
    let mut names: Vec<_> = files.map(|file| file.file_name()).collect();
    names.sort();
    let mut sum = command("sha256sum");
    write("SHA256SUMS", &text(sum.args(names).current_dir(&folder))?)?;
    check(command("du --apparent-size --human-readable --all").arg(&folder))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parsed(line: &str) -> Result<Plan> {
        let arguments: Vec<String> = line.split_whitespace().map(str::to_owned).collect();
        parse(&arguments)
    }

    #[test]
    fn steps_can_be_left_out() {
        let made = |line: &str| {
            let plan = parsed(line).unwrap();
            let made = STEPS.iter().filter(|step| plan.has(step.name));
            made.map(|step| step.name).collect::<Vec<_>>()
        };
        assert_eq!(made("").len(), STEPS.len());
        assert_eq!(
            made("--without image,wheels --without=book"),
            ["notes", "crates", "debian", "drive", "checksums"]
        );
    }

    #[test]
    fn a_release_has_all_steps() {
        assert_eq!(
            parsed("--tag v1.2.3").unwrap().tag.as_deref(),
            Some("v1.2.3")
        );
        let why = parsed("--tag v1.2.3 --without book").unwrap_err();
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
            let why = parsed(line).unwrap_err().to_string();
            assert!(why.contains(USAGE), "{line}: {why}");
        }
    }
}
