//! How fast this machine is: the unit of the steps' costs is the processor time of `cargo demo` from
//! nothing, which is mostly compiling.

use std::{
    fmt::Write as _,
    fs,
    path::Path,
    process::{Command, Stdio},
};

use crate::{
    process::{Failure, failure, silent},
    step::processor_s,
    target,
};

/// Processor time of `cargo demo` from nothing, as a multiple of that of the sample. Measured in one
/// session on one machine: 189.8 s, and 0.95 to 0.99 s.
const SAMPLES_IN_A_DEMO: f64 = 198.0;

/// Processor time of `cargo demo` from nothing on this machine, estimated by compiling a sample.
pub(crate) fn demo_s() -> Result<f64, Failure> {
    let folder = target::folder()?.join("yardstick");
    target::empty(&folder)?;
    let file = folder.join("sample.rs");
    fs::write(&file, sample()).map_err(|error| failure!("{}: {error}", file.display()))?;
    let before_s = processor_s();
    silent(&mut compile(&file, &folder))?;
    Ok(SAMPLES_IN_A_DEMO * (processor_s() - before_s))
}

fn compile(file: &Path, folder: &Path) -> Command {
    let mut rustc = Command::new("rustc");
    rustc
        .args([
            "--edition",
            "2024",
            "--crate-type",
            "lib",
            "-C",
            "opt-level=1",
        ])
        .args(["-C", "codegen-units=1", "--out-dir"])
        .args([folder, file])
        .stdin(Stdio::null());
    rustc
}

/// A library that depends on nothing but the standard library, and is always the same.
fn sample() -> String {
    let mut text = String::new();
    for number in 0..4 {
        let _ = write!(
            text,
            "pub mod part{number} {{
    use std::collections::BTreeMap;
    #[derive(Clone, Debug, Default, PartialEq, PartialOrd)]
    pub struct Row {{ pub name: String, pub values: Vec<f64>, pub places: BTreeMap<u32, [f32; 3]> }}
    pub fn read(text: &str) -> Result<Vec<Row>, std::num::ParseFloatError> {{
        let mut rows = text.lines().map(|line| {{
            let values = line.split(',').map(str::parse).collect::<Result<Vec<f64>, _>>()?;
            let places = values.iter().map(|value| (*value as u32, [*value as f32; 3])).collect();
            Ok(Row {{ name: format!(\"{{line:>{number}}}\"), values, places }})
        }}).collect::<Result<Vec<_>, _>>()?;
        rows.sort_by(|one, other| one.name.cmp(&other.name));
        Ok(rows)
    }}
}}
"
        );
    }
    text
}
