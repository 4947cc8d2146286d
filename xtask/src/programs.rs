//! The programs of the workspace: one build serves all checks.
//!
//! A package built alone has dependencies with other features than in the workspace, which are then
//! compiled again. All checks therefore name the same packages and targets, and cargo builds nothing
//! twice. They use the profile `dev`, in which what computes is optimised.

use std::{os::unix::process::CommandExt, path::PathBuf, process::Command};

use crate::{
    image::{self, Image},
    once,
    prerequisites::Part,
    process::{Failure, check, failure, output},
    target,
    workspace::{cargo, cargo_here, root},
};

/// Tests that run only when they are named.
pub(crate) const NAMED_TESTS: [&str; 4] = ["hil", "book", "uno", "real_logs"];

/// The packages that need more than Rust and a C compiler; they are no default members.
const OF_PARTS: [(Part, &str); 4] = [
    (Part::Uno, "singletrack-simavr-process"),
    (Part::Python, "singletrack-python"),
    (Part::Ros, "singletrack-ros"),
    (Part::Zenoh, "singletrack-zenoh"),
];

/// The packages with programs that are installed, and those programs.
pub(crate) const INSTALLED: [(&str, &str); 5] = [
    ("singletrackd", "singletrackd"),
    ("singletrack", "singletrack"),
    ("singletrack-lab", "singletrack-lab"),
    ("singletrack-sim", "singletrack-sim"),
    ("singletrack-newcomer", "singletrack-hil"),
];

/// The node of ROS 2, which has a Debian package of its own.
pub(crate) const NODE: (&str, &str) = ("singletrack-ros", "singletrack-ros");

/// The packages of the workspace that are checked.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Packages {
    /// The default members, which need only Rust and a C compiler.
    Default,
    /// All, but those of some parts.
    AllWithout(Vec<Part>),
}

impl Packages {
    /// Whether the checks include a part.
    pub(crate) fn has(&self, part: Part) -> bool {
        match self {
            Self::Default => false,
            Self::AllWithout(parts) => !parts.contains(&part),
        }
    }

    /// Cargo, with the options that name the packages. What it compiles is linted and documented, too.
    pub(crate) fn cargo(&self, command: &str) -> Result<Command, Failure> {
        let mut cargo = cargo();
        once::wrap(&mut cargo)?;
        cargo.arg(command).args(self.options());
        Ok(cargo)
    }

    /// Cargo's options that name the packages.
    fn options(&self) -> Vec<&'static str> {
        if *self == Self::Default {
            return Vec::new();
        }
        let left_out = OF_PARTS.into_iter().filter(|(part, _)| !self.has(*part));
        let left_out = left_out.flat_map(|(_, package)| ["--exclude", package]);
        ["--workspace"].into_iter().chain(left_out).collect()
    }

    /// Compiles everything that is checked.
    pub(crate) fn compile(&self) -> Result<(), Failure> {
        let named = NAMED_TESTS.into_iter().flat_map(|name| ["--test", name]);
        // `--all-targets` does not include them, whatever else is named.
        check(self.cargo("test")?.args(["--no-run", "--all-targets"]))?;
        check(self.cargo("test")?.arg("--no-run").args(named))
    }

    /// The tests, or those of one of [`NAMED_TESTS`].
    pub(crate) fn tests(&self, named: Option<&str>) -> Result<Command, Failure> {
        let mut tests = self.cargo("test")?;
        if let Some(name) = named {
            tests.args(["--test", name, "--"]);
        }
        Ok(tests)
    }

    /// Builds all programs and returns the path of one.
    pub(crate) fn path(&self, name: &str) -> Result<PathBuf, Failure> {
        self.build(&["--bins"])?;
        Ok(target::folder()?.join("debug").join(name))
    }

    /// Builds targets, and a test, so that dependencies have the features that tests need.
    fn build(&self, targets: &[&str]) -> Result<(), Failure> {
        let mut build = self.cargo("build")?;
        build.args(["--quiet", "--test", NAMED_TESTS[0]]);
        check(build.args(targets))
    }

    /// A program, to be started in the workspace's root.
    pub(crate) fn program(&self, name: &str) -> Result<Command, Failure> {
        let mut command = Command::new(self.path(name)?);
        command.current_dir(root());
        Ok(command)
    }

    /// Builds all libraries and returns the folder of those that other languages load.
    pub(crate) fn libraries(&self) -> Result<PathBuf, Failure> {
        self.build(&["--lib"])?;
        Ok(target::folder()?.join("debug"))
    }

    /// A command that simulates a scenario, by the build of the tests.
    pub(crate) fn trajectory(&self) -> Result<impl Fn() -> Command, Failure> {
        self.build(&["--bins"])?;
        let program = target::folder()?.join("debug/trajectory");
        Ok(move || {
            let mut command = Command::new(&program);
            command.current_dir(root());
            command
        })
    }

    /// This source's image, with its simulator of this build.
    pub(crate) fn image(&self) -> Result<Image, Failure> {
        image::build(0, || self.build(&["--bins"]))
    }

    /// Runs a command with this source's image, if the checks include it: a step that runs alone
    /// must not test an old image or one named by the environment.
    pub(crate) fn check_with_image(&self, command: &mut Command) -> Result<(), Failure> {
        command.env_remove("SINGLETRACK_UNO");
        if self.has(Part::Uno) {
            command.env("SINGLETRACK_UNO", self.image()?.folder);
        }
        check(command)
    }
}

/// `cargo build` for this machine as for an installation, and the folder of the programs.
pub(crate) fn release_build() -> Result<(Command, PathBuf), Failure> {
    let mut build = cargo();
    build.args(["build", "--release", "--locked"]);
    Ok((build, target::folder()?.join("release")))
}

/// Cargo's options that name programs and their packages.
pub(crate) fn options<'a>(programs: &[(&'a str, &'a str)]) -> Vec<&'a str> {
    let options = programs.iter();
    options
        .flat_map(|(program, package)| ["--package", package, "--bin", program])
        .collect()
}

/// A command of the project that builds a program and becomes it.
pub(crate) struct Runner {
    package: &'static str,
    options: &'static [&'static str],
    first: &'static [&'static str],
}

/// `cargo demo`: only what it runs is built. With the option `--live`, also what that serves.
pub(crate) const DEMO: Runner = Runner {
    package: "singletrack",
    options: &["--no-default-features"],
    first: &["demo"],
};

/// `cargo explore`: every interleaving of board, link and supervisor.
pub(crate) const EXPLORE: Runner = Runner::of("singletrack-exploration");

/// `cargo faults`: the fault campaign.
pub(crate) const FAULTS: Runner = Runner::of("singletrack-faults");

/// `cargo onboard`: the onboarding campaign.
pub(crate) const ONBOARD: Runner = Runner::of("singletrack-onboard");

impl Runner {
    /// The program of this package, as it is.
    const fn of(package: &'static str) -> Self {
        Self {
            package,
            options: &[],
            first: &[],
        }
    }

    /// Builds the program, and the Arduino's image if the arguments ask for it, and replaces this
    /// process by the program; returns only on failure. The program starts in the current folder,
    /// from which its files are named, and has stdout for itself.
    pub(crate) fn run(&self, arguments: &[String]) -> Result<(), Failure> {
        let mut cargo = cargo_here();
        if needs_image(arguments) {
            let image = image::ensure(0, &[])?;
            cargo.env("SINGLETRACK_UNO", image.folder);
        }
        let program = target::folder()?.join("debug").join(self.package);
        let is_first = !program.is_file();
        if is_first {
            eprintln!(
                "Building {}: the first build takes some minutes",
                self.package
            );
        }
        let is_live = arguments.iter().any(|one| one.starts_with("--live"));
        let live = is_live.then_some(["--features", "live"]);
        cargo
            .args(["run", "--package", self.package, "--bin", self.package])
            .args(self.options)
            .args(live.iter().flatten())
            .args(image::quiet().filter(|_| !is_first))
            .arg("--")
            .args(self.first)
            .args(arguments);
        Err(failure!("cargo does not start: {}", cargo.exec()))
    }
}

/// Whether arguments ask for the Arduino's image: as the board, or by a schedule to replay, given as
/// text or as a file. The program itself validates them.
fn needs_image(arguments: &[String]) -> bool {
    let of_schedule = |schedule: &str| {
        schedule
            .split(['\n', ';'])
            .any(|entry| entry.split_whitespace().eq(["board", "uno"]))
    };
    let as_board = arguments
        .windows(2)
        .any(|pair| pair[0] == "--board" && pair[1] == "uno");
    as_board
        || arguments.iter().any(|argument| {
            let named = argument.strip_prefix("--replay=").unwrap_or(argument);
            argument == "--board=uno"
                || of_schedule(named)
                || std::fs::read_to_string(named).is_ok_and(|text| of_schedule(&text))
        })
}

/// Cargo's options for a program that simulates a scenario, and nothing else.
pub(crate) const TRAJECTORY: [&str; 7] = [
    "--package",
    "singletrack-scenario",
    "--bin",
    "trajectory",
    "--no-default-features",
    "--features",
    "singletrack-scenario/files",
];

/// One scenario per plant.
const SCENARIOS: [&str; 3] = [
    "tools/scenarios/circle.toml",
    "tools/scenarios/circle-sampled.toml",
    "tools/scenarios/circle-car.toml",
];

/// Checks that two builds simulate the same bits; otherwise, records of the car's computer could not
/// be replayed on another. A command gets the name of a scenario as its last argument.
pub(crate) fn compare(
    (one_name, one): (&str, &dyn Fn() -> Command),
    (other_name, other): (&str, &dyn Fn() -> Command),
) -> Result<(), Failure> {
    for scenario in SCENARIOS {
        let run = |build: &dyn Fn() -> Command| output(build().arg(scenario));
        let (one, other) = (run(one)?, run(other)?);
        if let Some(place) = first_difference(&one, &other) {
            return Err(failure!(
                "{scenario}: {one_name} and {other_name} differ first in {place}"
            ));
        }
        if one.is_empty() {
            return Err(failure!("{scenario}: nothing was simulated"));
        }
        println!("{scenario}: {} bytes, the same", one.len());
    }
    Ok(())
}

fn first_difference(one: &[u8], other: &[u8]) -> Option<String> {
    if one == other {
        return None;
    }
    let line = one
        .split(|byte| *byte == b'\n')
        .zip(other.split(|byte| *byte == b'\n'))
        .position(|(one, other)| one != other);
    Some(line.map_or_else(
        || "its length".to_owned(),
        |line| format!("line {}", line + 1),
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_image_is_built_only_on_request() {
        let asks = |line: &str| {
            let arguments: Vec<String> = line.split_whitespace().map(str::to_owned).collect();
            needs_image(&arguments)
        };
        assert!(asks("--board uno"));
        assert!(asks("--feed-forward --board=uno --seed 2"));
        assert!(!asks(""));
        assert!(!asks("--board native"));
        assert!(!asks("--out uno"));
        assert!(!asks("--board"));
    }

    #[test]
    fn a_replayed_schedule_selects_the_board() {
        let asks = |schedule: &str| needs_image(&["--replay".into(), schedule.into()]);
        assert!(asks("seed 1; board uno; end_ms 5"));
        assert!(needs_image(&["--replay=seed 1;board  uno".into()]));
        assert!(!asks("seed 1; board native; end_ms 5"));
        assert!(!asks("no-such-file"));
    }

    #[test]
    fn a_part_that_is_left_out_leaves_out_its_package() {
        assert_eq!(Packages::Default.options().join(" "), "");
        assert_eq!(
            Packages::AllWithout(vec![Part::Ros, Part::Slurm])
                .options()
                .join(" "),
            "--workspace --exclude singletrack-ros"
        );
    }

    #[test]
    fn the_first_different_line_is_reported() {
        assert_eq!(first_difference(b"a\nb\n", b"a\nb\n"), None);
        assert_eq!(
            first_difference(b"a\nb\n", b"a\nc\n").as_deref(),
            Some("line 2")
        );
        assert_eq!(
            first_difference(b"a\nb\n", b"a\nb\nc\n").as_deref(),
            Some("line 3")
        );
        assert_eq!(
            first_difference(b"a\nb", b"a\nb\nc").as_deref(),
            Some("its length")
        );
    }
}
