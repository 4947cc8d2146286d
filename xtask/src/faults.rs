//! `cargo faults`: builds the fault campaign and executes it.

use crate::{demo::drives_the_image, process::Failure, release};

/// Returns only on failure.
pub(crate) fn main(arguments: &[String]) -> Result<(), Failure> {
    let needs_image = drives_the_image(arguments) || replays_the_image(arguments);
    release::run("singletrack-faults", needs_image, arguments)
}

/// Whether a schedule to replay, given as text or as a file, needs the Arduino's
/// image.
fn replays_the_image(arguments: &[String]) -> bool {
    let needs_image = |schedule: &str| {
        schedule
            .split(['\n', ';'])
            .any(|entry| entry.split_whitespace().eq(["board", "uno"]))
    };
    arguments.iter().any(|argument| {
        let named = argument.strip_prefix("--replay=").unwrap_or(argument);
        needs_image(named) || std::fs::read_to_string(named).is_ok_and(|text| needs_image(&text))
    })
}

#[cfg(test)]
mod tests {
    use super::replays_the_image;

    #[test]
    fn a_replayed_schedule_selects_the_board() {
        let asks = |schedule: &str| replays_the_image(&["--replay".into(), schedule.into()]);
        assert!(asks("seed 1; board uno; end_ms 5"));
        assert!(replays_the_image(&["--replay=seed 1;board  uno".into()]));
        assert!(!asks("seed 1; board native; end_ms 5"));
        assert!(!asks("no-such-file"));
    }
}
