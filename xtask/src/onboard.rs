//! `cargo onboard`: builds the onboarding campaign and executes it.

use crate::{demo::drives_the_image, process::Failure, release};

/// Returns only on failure.
pub(crate) fn main(arguments: &[String]) -> Result<(), Failure> {
    release::run(
        "singletrack-onboard",
        drives_the_image(arguments),
        arguments,
    )
}
