//! Debug and release builds must simulate the same bits. Otherwise, records of the
//! car's computer could not be replayed.

use std::{path::PathBuf, process::Command};

use crate::{
    process::{Failure, check as check_command, output},
    release::Release,
    target,
    workspace::{cargo, root},
};

/// One scenario per plant.
pub(crate) const SCENARIOS: [&str; 3] = [
    "tools/scenarios/circle.toml",
    "tools/scenarios/circle-sampled.toml",
    "tools/scenarios/circle-car.toml",
];

pub(crate) fn check(release: Release) -> Result<(), Failure> {
    let debug = debug_program()?;
    for scenario in SCENARIOS {
        let mut debug = Command::new(&debug);
        debug.current_dir(root()).arg(scenario);
        compare(
            scenario,
            ("debug", &mut debug),
            ("release", &mut simulate(release, scenario)?),
        )?;
    }
    Ok(())
}

/// A debug build that simulates: of an example, which needs few packages.
fn debug_program() -> Result<PathBuf, Failure> {
    check_command(
        cargo()
            .args(["build", "--quiet", "--package", "singletrack-scenario"])
            .args(["--example", "trajectory"]),
    )?;
    Ok(target::folder()?.join("debug/examples/trajectory"))
}

/// Simulates a scenario with the release build of this machine.
pub(crate) fn simulate(release: Release, scenario: &str) -> Result<Command, Failure> {
    let mut command = release.program("singletrack")?;
    command.args(["simulate", scenario]);
    Ok(command)
}

/// Runs two builds and compares their output, byte by byte.
pub(crate) fn compare(
    scenario: &str,
    (one_name, one): (&str, &mut Command),
    (other_name, other): (&str, &mut Command),
) -> Result<(), Failure> {
    let (one, other) = (output(one)?, output(other)?);
    match first_difference(&one, &other) {
        Some(place) => Err(Failure::new(format!(
            "{scenario}: {one_name} and {other_name} differ first in {place}"
        ))),
        None if one.is_empty() => Err(Failure::new(format!("{scenario}: nothing was simulated"))),
        None => {
            println!("{scenario}: {} bytes, the same", one.len());
            Ok(())
        }
    }
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
