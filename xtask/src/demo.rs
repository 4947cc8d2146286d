//! `cargo demo`: builds the demo and executes it.

use crate::{process::Failure, release};

/// Returns only on failure. It leaves stdout to the demo.
pub(crate) fn main(arguments: &[String]) -> Result<(), Failure> {
    release::run(
        "singletrack",
        drives_the_image(arguments),
        &[&["demo".to_owned()], arguments].concat(),
    )
}

/// Whether the demo needs the Arduino's image. The demo itself validates the
/// arguments.
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
    fn the_image_is_built_only_on_request() {
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
