//! Debug and release builds must simulate the same bits: a replay of what the
//! car's computer recorded is worth nothing otherwise.

use crate::step::{Failure, cargo, output};

/// One scenario of each plant.
const SCENARIOS: [&str; 3] = ["circle", "circle-sampled", "circle-car"];

pub(crate) fn check() -> Result<(), Failure> {
    for scenario in SCENARIOS {
        let path = format!("tools/scenarios/{scenario}.toml");
        let simulate = |profile: &str| {
            output(cargo().args([
                "run",
                "--quiet",
                "--profile",
                profile,
                "--bin",
                "singletrack",
                "--",
                "simulate",
                &path,
            ]))
        };
        let (debug, release) = (simulate("dev")?, simulate("release")?);
        if debug != release {
            let line = debug
                .split(|byte| *byte == b'\n')
                .zip(release.split(|byte| *byte == b'\n'))
                .position(|(debug, release)| debug != release)
                .map_or_else(
                    || "its length".to_owned(),
                    |line| format!("line {}", line + 1),
                );
            return Err(Failure::new(format!(
                "{path}: debug and release differ first in {line}"
            )));
        }
        println!("{path}: {} bytes, the same", debug.len());
    }
    Ok(())
}
