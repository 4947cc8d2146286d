//! `cargo demo`: builds what the demo needs and becomes it.

use std::{
    io::{self, IsTerminal},
    os::unix::process::CommandExt,
};

use crate::{
    image::{self, Progress},
    step::{Failure, cargo_here},
};

/// Returns only when it fails. The demo writes where it is called from, so
/// this stays there; stdout is the demo's alone.
pub(crate) fn main(arguments: &[String]) -> Result<(), Failure> {
    let quiet = !io::stderr().is_terminal();
    if drives_the_image(arguments) {
        image::ensure(if quiet {
            Progress::Quiet
        } else {
            Progress::Shown
        })?;
    }
    let mut cargo = cargo_here();
    cargo
        .args(["run", "--release", "--package", "singletrack"])
        .args(["--bin", "singletrack"])
        .args(quiet.then_some("--quiet"))
        .args(["--", "demo"])
        .args(arguments);
    Err(Failure::new(format!(
        "cargo does not start: {}",
        cargo.exec()
    )))
}

/// Whether the demo will want the Arduino's image. Whether the arguments are
/// right is for the demo to say.
pub(crate) fn drives_the_image(arguments: &[String]) -> bool {
    arguments.iter().any(|argument| argument == "--board=uno")
        || arguments
            .windows(2)
            .any(|pair| pair[0] == "--board" && pair[1] == "uno")
}

#[cfg(test)]
mod tests {
    use super::drives_the_image;

    #[test]
    fn the_image_is_built_only_for_who_asks_for_it() {
        let asks = |line: &str| {
            let arguments: Vec<String> = line.split_whitespace().map(str::to_owned).collect();
            drives_the_image(&arguments)
        };
        assert!(asks("--board uno"));
        assert!(asks("--feed-forward --board=uno --seed 2"));
        assert!(!asks(""));
        assert!(!asks("--board native"));
        assert!(!asks("--out uno"));
        assert!(!asks("--board"));
    }
}
