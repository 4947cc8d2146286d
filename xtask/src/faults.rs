//! `cargo faults`: builds what the fault campaign needs and becomes it.

use crate::{
    demo::drives_the_image,
    image::{self, Progress},
    process::Failure,
    release,
    workspace::cargo_here,
};

/// Returns only when it fails. A schedule to replay may be a file named from
/// where this is called, so this stays there.
pub(crate) fn main(arguments: &[String]) -> Result<(), Failure> {
    release::announce("singletrack-faults")?;
    let mut cargo = cargo_here();
    if drives_the_image(arguments) || replays_the_image(arguments) {
        let image = image::ensure(Progress::of_stderr())?;
        cargo.env("SINGLETRACK_UNO", image.folder);
    }
    cargo.args(["run", "--release", "--package", "singletrack-faults"]);
    release::become_program(cargo, arguments)
}

/// Whether a schedule to replay, in the arguments or in a file that they name,
/// wants the Arduino's image.
fn replays_the_image(arguments: &[String]) -> bool {
    let wants = |schedule: &str| {
        schedule
            .split(['\n', ';'])
            .any(|entry| entry.split_whitespace().eq(["board", "uno"]))
    };
    arguments.iter().any(|argument| {
        let named = argument.strip_prefix("--replay=").unwrap_or(argument);
        wants(named) || std::fs::read_to_string(named).is_ok_and(|text| wants(&text))
    })
}

#[cfg(test)]
mod tests {
    use super::replays_the_image;

    #[test]
    fn a_schedule_that_is_replayed_says_itself_what_runs_on_the_board() {
        let asks = |schedule: &str| replays_the_image(&["--replay".into(), schedule.into()]);
        assert!(asks("seed 1; board uno; end_ms 5"));
        assert!(replays_the_image(&["--replay=seed 1;board  uno".into()]));
        assert!(!asks("seed 1; board native; end_ms 5"));
        assert!(!asks("no-such-file"));
    }
}
