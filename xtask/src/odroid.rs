//! `cargo odroid`: daemon and tools for the Odroid XU4, 32-bit ARM with hard float (Debian's armhf).
//! Its programs, and those of a release, simulate the same bits as the tested ones.

use std::{
    path::Path,
    process::{Command, Stdio},
};

use crate::{
    prerequisites::{self, ARMHF, release_build},
    process::{Result, check, command, failure, output, require},
    programs::Packages,
    workspace::{cargo, configure, put, root, target},
};

pub(crate) const USAGE: &str = "\
usage: cargo odroid

Build singletrackd and singletrack for the Odroid and print their paths.
Installs missing Debian packages.
";

/// Cargo's options for what is checked of them: the libraries of the daemon, of the procedures and of the
/// tool as `cargo demo` builds it, and a trajectory. `cargo release` builds and links all of them.
const CHECKED: &str = "--package singletrackd --package singletrack-commissioning \
                       --package singletrack --package singletrack-scenario --no-default-features \
                       --features singletrack-scenario/files --lib --bin trajectory";

/// Cargo's options for a program that simulates a scenario, and nothing else.
const TRAJECTORY: &str = "--package singletrack-scenario --bin trajectory --no-default-features \
                          --features singletrack-scenario/files";

/// The packages that compute, and those with an optimisation of their own that hardly do; the first two
/// of these matter neither to the speed of a browser's simulation nor much to the size of its module.
const COMPUTING: [&str; 7] = [
    "board", "control", "link", "mocap", "pilot", "protocol", "sim",
];
pub(crate) const OTHERS: [&str; 5] = ["api", "analysis", "record", "core", "scenario"];

/// One scenario per plant.
pub(crate) const SCENARIOS: [&str; 3] = [
    "tools/scenarios/circle.toml",
    "tools/scenarios/circle-sampled.toml",
    "tools/scenarios/circle-car.toml",
];

pub(crate) fn main(arguments: &[String]) -> Result {
    let has_none = arguments.is_empty();
    require!(has_none, "unexpected arguments {arguments:?}\n\n{USAGE}");
    prerequisites::ensure(&["armhf"])?;
    let programs = ["singletrackd", "singletrack"];
    let options = programs.map(|name| ["--package", name]).concat();
    let folder = release_build(Some(ARMHF), &options)?;
    for program in programs {
        println!("{}", folder.join(program).display());
    }
    Ok(())
}

/// Builds the Odroid's programs, and checks that what computes, optimised, computes the same bits there
/// as here. The programs that are installed are built and run by `cargo deb`.
pub(crate) fn verify(packages: &Packages) -> Result {
    // The profile is that of the browser's module, which has the same helpers of the compiler.
    let (mut cargo, folder) = ARMHF.build("web")?;
    quickly(&mut cargo, "web", &OTHERS);
    configure(&mut cargo, "web", &["panic=\"unwind\"", "opt-level=0"]);
    // This combination of features is linted only here.
    cargo.args(["-Zwarnings", "--config", "build.warnings=\"deny\""]);
    check(cargo.args(CHECKED.split(' ')).stdout(Stdio::null()))?;
    compare_emulated(packages, &folder)
}

/// Lets cargo optimise what computes, as in a release, and not some of [`OTHERS`].
pub(crate) fn quickly(cargo: &mut Command, profile: &str, plain: &[&str]) {
    for name in COMPUTING {
        let profile = format!("{profile}.package.singletrack-{name}");
        configure(cargo, &profile, &["opt-level=3", "debug-assertions=false"]);
    }
    for name in plain {
        let profile = format!("{profile}.package.singletrack-{name}");
        configure(cargo, &profile, &["opt-level=0"]);
    }
    // In C, which compiles in less than half of the time at this level.
    configure(cargo, profile, &["package.zstd-sys.opt-level=1"]);
}

/// Checks that a release as it is installed simulates the same bits here and there as the tests here:
/// records of the car are replayed here.
pub(crate) fn compare_installed(packages: &Packages) -> Result {
    let options: Vec<&str> = TRAJECTORY.split(' ').collect();
    compare_native(packages, &release_build(None, &options)?.join("trajectory"))?;
    compare_emulated(packages, &release_build(Some(ARMHF), &options)?)
}

/// Compares the bits of a build for the Odroid in this folder.
fn compare_emulated(packages: &Packages, folder: &Path) -> Result {
    compare(packages, &SCENARIOS, "this machine and ARMv7", || {
        let mut emulated = command(&ARMHF.emulator());
        emulated.arg(folder.join("trajectory"));
        emulated
    })
}

/// Checks that what computes, optimised as in a release, computes the same bits as in the tests. All
/// else is of the tested build; `cargo release` compares the whole program.
pub(crate) fn compare_optimised(packages: &Packages) -> Result {
    // The libraries are those of the tests, with the features that some test asks for.
    let mut build = cargo("build --quiet --bin trajectory --test book");
    quickly(&mut build, "dev", &OTHERS);
    check(build.args(packages.options()))?;
    let target = target()?;
    // The tested one takes its place there.
    let optimised = target.join("optimised/trajectory");
    put(&target.join("debug/trajectory"), &optimised)?;
    compare_native(packages, &optimised)
}

/// Compares the bits of an optimised build for this machine.
fn compare_native(packages: &Packages, optimised: &Path) -> Result {
    let builds = "the tested build and the optimised build";
    compare(packages, &SCENARIOS, builds, || Command::new(optimised))
}

/// Checks that another build simulates the same bits as that of the tests; otherwise, records of the
/// car's computer could not be replayed on another.
pub(crate) fn compare(
    packages: &Packages,
    scenarios: &[&str],
    builds: &str,
    other: impl Fn() -> Command,
) -> Result {
    let program = packages.path("trajectory")?;
    for scenario in scenarios {
        let run = |mut program: Command| output(program.arg(scenario).current_dir(root()));
        let tested = run(Command::new(&program))?;
        if let Some(place) = first_difference(&tested, &run(other())?) {
            return Err(failure!("{scenario}: {builds} differ first in {place}"));
        }
        require!(!tested.is_empty(), "{scenario}: nothing was simulated");
        println!("{scenario}: {} bytes, the same", tested.len());
    }
    Ok(())
}

fn first_difference(one: &[u8], other: &[u8]) -> Option<String> {
    if one == other {
        return None;
    }
    let is_end = |byte: &u8| *byte == b'\n';
    let mut lines = one.split(is_end).zip(other.split(is_end));
    let line = lines.position(|(one, other)| one != other);
    Some(line.map_or("its length".to_owned(), |line| format!("line {}", line + 1)))
}

#[cfg(test)]
mod tests {
    use super::first_difference;

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
