//! Trace of the pulses on the board's pins, in board time.

use std::time::Duration;

use crate::{Outcome, ensure};

/// The pulses from a time on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Pulses {
    /// Board time, in µs. It restarts with the board.
    pub board_time_us: u32,
    /// Servo pulse in µs; zero for none.
    pub servo_us: u16,
    /// ESC pulse in µs; zero for none.
    pub esc_us: u16,
    /// A reset cut one of the pulses. Known only in the simulator.
    pub cut: bool,
}

impl Pulses {
    /// Whether the motor is not driven: exactly neutral, or no pulse.
    pub const fn is_neutral(&self, neutral_us: u16) -> bool {
        self.esc_us == 0 || self.esc_us == neutral_us
    }

    /// Whether a reset cut the ESC's pulse below neutral; its intended width is
    /// unknown.
    pub const fn is_cut_short_of(&self, neutral_us: u16) -> bool {
        self.cut && self.esc_us < neutral_us
    }
}

/// The pulses since the rig was built, oldest first.
#[derive(Clone, Debug, Default)]
pub struct Trace(pub Vec<Pulses>);

impl Trace {
    /// Number of pulses, which is also a position for [`Self::since`].
    pub const fn len(&self) -> usize {
        self.0.len()
    }

    /// Whether there are no pulses.
    pub const fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// The pulses from a position on.
    pub fn since(&self, place: usize) -> &[Pulses] {
        self.0.get(place..).unwrap_or(&[])
    }

    /// The first pulse from which on, to the end, the motor is not driven, except
    /// by a pulse cut by a reset.
    pub fn neutral_from(&self, neutral_us: u16) -> Option<Pulses> {
        self.0
            .iter()
            .rev()
            .filter(|pulses| !pulses.is_cut_short_of(neutral_us))
            .take_while(|pulses| pulses.is_neutral(neutral_us))
            .last()
            .copied()
    }
}

/// Time from one board time to a later one, in ms.
///
/// # Errors
///
/// Fails if the later one is earlier, for example after a restart of the board.
pub(crate) fn elapsed_ms(from_us: u32, to_us: u32) -> Outcome<f64> {
    // Board time wraps.
    let ms = f64::from(to_us.wrapping_sub(from_us) as i32) / 1_000.0;
    let before = ms < -TOLERANCE_MS;
    ensure!(
        !before,
        "it was {:.0} ms before that, or the board has restarted",
        -ms
    );
    Ok(ms)
}

/// Tolerance for a later time that is earlier: the car may already be at neutral.
const TOLERANCE_MS: f64 = 100.0;

/// Checks that at least half of the ESC's pulses in a time were seen; a busy
/// machine may lose the rest. Without pulses there is no result.
pub(crate) fn has_pulses_for(pulses: &[Pulses], time: Duration) -> Outcome {
    let expected = (time.as_millis() / 20) as usize;
    let count = pulses.iter().filter(|pulses| pulses.esc_us != 0).count();
    ensure!(
        2 * count >= expected,
        "the ESC had {count} pulses in {time:.0?}, not {expected}"
    );
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_end_before_the_start_is_an_error() {
        assert_eq!(elapsed_ms(5_000, 47_000).unwrap(), 42.0);
        assert_eq!(elapsed_ms(u32::MAX, 999).unwrap(), 1.0);
        assert!(elapsed_ms(50_000, 30_000).unwrap() < 0.0);
        // A board that restarted 70 ms ago.
        assert!(elapsed_ms(6_000_000, 70_000).is_err());
    }

    #[test]
    fn a_trace_without_pulses_is_not_neutral() {
        let pulses = |esc_us| Pulses {
            board_time_us: 0,
            servo_us: 1_500,
            esc_us,
            cut: false,
        };
        let half_a_second = Duration::from_millis(500);
        has_pulses_for(&[pulses(1_500); 13], half_a_second).unwrap();
        assert!(has_pulses_for(&[pulses(1_500); 12], half_a_second).is_err());
        assert!(has_pulses_for(&[pulses(0); 25], half_a_second).is_err());
        assert!(has_pulses_for(&[], half_a_second).is_err());
    }
}
