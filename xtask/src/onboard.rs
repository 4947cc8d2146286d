//! `cargo onboard`: builds the onboarding campaign and executes it.

use crate::{
    demo::drives_the_image,
    image::{self, Progress},
    process::Failure,
    release,
    workspace::cargo_here,
};

/// Returns only on failure. It keeps the current folder, because the file of the results may
/// be a relative path.
pub(crate) fn main(arguments: &[String]) -> Result<(), Failure> {
    release::announce("singletrack-onboard")?;
    let mut cargo = cargo_here();
    if drives_the_image(arguments) {
        let image = image::ensure(Progress::of_stderr(), 0)?;
        cargo.env("SINGLETRACK_UNO", image.folder);
    }
    cargo.args(["run", "--release", "--package", "singletrack-onboard"]);
    release::become_program(cargo, arguments)
}
