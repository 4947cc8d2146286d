//! `cargo demo`: builds what the demo needs and becomes it.

use crate::{
    image::{self, Progress},
    process::Failure,
    release,
    workspace::cargo_here,
};

/// Returns only when it fails. The demo writes where it is called from, so
/// this stays there; stdout is the demo's alone.
pub(crate) fn main(arguments: &[String]) -> Result<(), Failure> {
    release::announce("singletrack")?;
    let mut cargo = cargo_here();
    if drives_the_image(arguments) {
        let image = image::ensure(Progress::of_stderr())?;
        cargo.env("SINGLETRACK_UNO", image.folder);
    }
    cargo
        .args(["run", "--release", "--package", "singletrack"])
        .args(["--bin", "singletrack"]);
    release::become_program(cargo, &[&["demo".to_owned()], arguments].concat())
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
