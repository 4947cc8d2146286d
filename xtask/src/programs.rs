//! The packages and programs of the workspace: one build serves all checks.
//!
//! A package built alone has dependencies with other features than in the workspace, which are then
//! compiled again. All checks therefore name the same packages and targets, and cargo builds nothing
//! twice. They use the profile `dev`, in which what computes is optimised.

use std::{
    fs,
    os::unix::process::CommandExt,
    path::{Path, PathBuf},
    process::Command,
};

use crate::{
    options,
    process::{Result, check, failure, program},
    uno,
    workspace::{cargo, cargo_here, configure, lint_and_document, root, target},
};

/// Tests that run only when they are named.
pub(crate) const NAMED_TESTS: [&str; 4] = ["hil", "book", "uno", "real_logs"];

/// The packages that need more than Rust and a C compiler; they are no default members.
const OF_PARTS: [(&str, &str); 6] = [
    ("uno", "singletrack-simavr-process"),
    ("python", "singletrack-python"),
    ("python", "singletrack-fmu"),
    ("ros", "singletrack-ros"),
    ("zenoh", "singletrack-zenoh"),
    ("web", "singletrack-web"),
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
    /// The default members, and those of some parts.
    AllWith(Vec<&'static str>),
}

impl Packages {
    /// Whether the checks include a part.
    pub(crate) fn has(&self, part: &str) -> bool {
        matches!(self, Self::AllWith(parts) if parts.contains(&part))
    }

    /// Cargo, with the options that name the packages. What it compiles is linted and documented, too.
    pub(crate) fn cargo(&self, command: &str) -> Result<Command> {
        let mut cargo = cargo(command);
        lint_and_document(&mut cargo, Path::new("clippy-driver"))?;
        cargo.args(self.options());
        Ok(cargo)
    }

    /// Cargo's options that name the packages.
    pub(crate) fn options(&self) -> Vec<&'static str> {
        if *self == Self::Default {
            return Vec::new();
        }
        let left_out = OF_PARTS.into_iter().filter(|(part, _)| !self.has(part));
        let left_out = left_out.flat_map(|(_, package)| ["--exclude", package]);
        ["--workspace"].into_iter().chain(left_out).collect()
    }

    /// Compiles everything that is checked.
    pub(crate) fn compile(&self) -> Result {
        let named = NAMED_TESTS.into_iter().flat_map(|name| ["--test", name]);
        // `cargo build`: `cargo test --all-targets` would compile the examples as tests, and what runs
        // the tests would compile them again. Not `--benches` and `--all-targets`: both would compile
        // every library and program as a benchmark, too.
        let targets = ["--lib", "--bins", "--tests", "--examples", "--bench", "*"];
        check(self.cargo("build")?.args(targets))?;
        // That does not include them, whatever else is named.
        check(self.cargo("test")?.arg("--no-run").args(named))
    }

    /// The tests with arguments without blanks, of which one of [`NAMED_TESTS`] may be named.
    pub(crate) fn tests(&self, arguments: &str) -> Result<Command> {
        let mut tests = self.cargo("test")?;
        tests.args(arguments.split_whitespace());
        Ok(tests)
    }

    /// Builds all programs and returns the path of one.
    pub(crate) fn path(&self, name: &str) -> Result<PathBuf> {
        self.build("--bins", name)
    }

    /// Builds targets, and a test, so that dependencies have the features that tests need; returns the
    /// path of one of them.
    pub(crate) fn build(&self, targets: &str, name: &str) -> Result<PathBuf> {
        let mut build = self.cargo("build")?;
        check(build.args(["--quiet", "--test", NAMED_TESTS[0], targets]))?;
        Ok(target()?.join("debug").join(name))
    }

    /// A program with arguments without blanks, to be started in the workspace's root.
    pub(crate) fn program(&self, line: &str) -> Result<Command> {
        let (name, arguments) = line.split_once(' ').unwrap_or((line, ""));
        let mut command = program(self.path(name)?, arguments);
        command.current_dir(root());
        Ok(command)
    }

    /// The folder of this source's image, with its simulator of this build.
    pub(crate) fn image(&self) -> Result<PathBuf> {
        uno::build(0, || self.path("").map(drop))
    }

    /// Runs a command with this source's image, if the checks include it: a step that runs alone
    /// must not test an old image or one named by the environment.
    pub(crate) fn check_with_image(&self, command: &mut Command) -> Result {
        command.env_remove("SINGLETRACK_UNO");
        if self.has("uno") {
            command.env("SINGLETRACK_UNO", self.image()?);
        }
        check(command)
    }
}

/// Builds the program of a package, and the Arduino's image if the arguments ask for it, and replaces
/// this process by the program; returns only on failure. The program starts in the current folder, from
/// which its files are named, and has stdout for itself.
pub(crate) fn become_program(package: &str, options: &str, arguments: &[String]) -> Result {
    let mut cargo = cargo_here();
    if needs_image(arguments) {
        cargo.env("SINGLETRACK_UNO", uno::ensure(0, &[])?);
    }
    let is_first = !target()?.join("debug").join(package).is_file();
    if is_first {
        eprintln!("Building {package}: the first build takes some minutes");
    }
    cargo.args(["run", "--package", package, "--bin", package]);
    cargo.args(uno::quiet().filter(|_| !is_first));
    cargo.args(options.split_whitespace()).args(arguments);
    Err(failure!("cargo does not start: {}", cargo.exec()))
}

/// `cargo demo`: only what it runs is built. With the option `--live`, also what that serves.
pub(crate) fn demo(arguments: &[String]) -> Result {
    let is_live = arguments.iter().any(|one| one.starts_with("--live"));
    let features = if is_live { "--features live" } else { "" };
    let options = format!("--no-default-features {features} -- demo");
    become_program("singletrack", &options, arguments)
}

/// Whether arguments ask for the Arduino's image: as the board, or by a schedule to replay, given as
/// text or as a file. The program itself validates them.
fn needs_image(arguments: &[String]) -> bool {
    let mut options = options(arguments, &["--board", "--replay"]).into_iter();
    options.any(|option| match option {
        ("--board", board) => board == Some("uno"),
        (schedule, None) | (_, Some(schedule)) => {
            let text = fs::read_to_string(schedule).unwrap_or_else(|_| schedule.to_owned());
            let mut entries = text.split(['\n', ';']);
            entries.any(|entry| entry.split_whitespace().eq(["board", "uno"]))
        }
    })
}

/// The packages with `publish = true`.
pub(crate) const PUBLISHED: [&str; 2] = ["singletrack-control", "singletrack-mocap"];

/// Checks that the packages for others can be published: `cargo package` packs each from its
/// `include` list and builds the result outside of the workspace. A file that is not packed, and a
/// dependency without a version, are errors there only.
pub(crate) fn check_published() -> Result {
    let packages = PUBLISHED.iter().flat_map(|package| ["--package", package]);
    // The working tree may hold changes. Offline, the versions are those of the workspace, and nothing
    // waits for the registry: the build has downloaded what they need.
    let mut package = cargo("package --quiet --offline --allow-dirty");
    // A packed package is a workspace of its own, which has the profile of this one here. Dependencies
    // are built once for all of them, and kept; what runs while compiling is that of the check of
    // packages alone.
    let settings = [
        "codegen-units=2",
        "incremental=false",
        "build-override.codegen-units=2",
        "build-override.debug=false",
        "package.\"*\".debug=false",
    ];
    configure(&mut package, "dev", &settings);
    check(package.args(packages).env("CARGO_TARGET_DIR", target()?))
}

#[cfg(test)]
mod tests {
    use crate::{prerequisites::PARTS, workspace};

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
        let mut parts = PARTS.to_vec();
        assert!(OF_PARTS.iter().all(|(part, _)| parts.contains(part)));
        parts.retain(|part| !["ros", "slurm"].contains(part));
        let packages = Packages::AllWith(parts);
        assert_eq!(
            packages.options().join(" "),
            "--workspace --exclude singletrack-ros"
        );
    }

    #[test]
    fn every_package_that_may_be_published_is_checked() {
        let root = workspace::find().unwrap();
        let workspace = fs::read_to_string(root.join("Cargo.toml")).unwrap();
        let (_, members) = workspace.split_once("\nmembers = [").unwrap();
        let (members, _) = members.split_once(']').unwrap();
        let mut publishable: Vec<String> = members
            .lines()
            .filter_map(|line| line.trim().strip_prefix('"')?.strip_suffix("\","))
            .filter_map(|member| {
                let manifest = root.join(member).join("Cargo.toml");
                let manifest = fs::read_to_string(manifest).unwrap();
                let name = manifest
                    .lines()
                    .find_map(|line| line.strip_prefix("name = "))
                    .unwrap()
                    .trim_matches('"')
                    .to_owned();
                let publish = manifest.lines().any(|line| line == "publish = true");
                publish.then_some(name)
            })
            .collect();
        publishable.sort();
        let mut published = PUBLISHED;
        published.sort_unstable();
        assert_eq!(publishable, published);
    }
}
