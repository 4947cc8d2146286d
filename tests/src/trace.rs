//! What came out of the board's pins, in board time.

use std::time::Duration;

use crate::{Outcome, ensure};

/// The pulses from one moment on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Pulses {
    /// The board's clock, in µs. It starts anew with the board.
    pub board_time_us: u32,
    /// Servo pulse in µs; zero is no pulse.
    pub servo_us: u16,
    /// ESC pulse in µs; zero is no pulse.
    pub esc_us: u16,
    /// A reset cut one of them short, as the simulator sees; a physical board
    /// tells of no such.
    pub cut: bool,
}

impl Pulses {
    /// Whether the motor gets nothing: exactly neutral, or no pulse at all.
    #[must_use]
    pub const fn is_neutral(&self, neutral_us: u16) -> bool {
        self.esc_us == 0 || self.esc_us == neutral_us
    }

    /// Whether a reset cut the ESC's pulse short of neutral: what it was meant to
    /// be, nobody knows.
    #[must_use]
    pub const fn is_cut_short_of(&self, neutral_us: u16) -> bool {
        self.cut && self.esc_us < neutral_us
    }
}

/// The pulses since the rig was built, oldest first.
#[derive(Clone, Debug, Default)]
pub struct Trace(pub Vec<Pulses>);

impl Trace {
    /// How many there are; a place to come back to with [`Self::since`].
    #[must_use]
    pub const fn len(&self) -> usize {
        self.0.len()
    }

    /// Whether there are none.
    #[must_use]
    pub const fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// The pulses from a place on.
    #[must_use]
    pub fn since(&self, place: usize) -> &[Pulses] {
        self.0.get(place..).unwrap_or(&[])
    }

    /// The first pulse from which on, to the end, the motor gets nothing; the one
    /// that a reset cut aside.
    #[must_use]
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

/// From one board time to a later one, in ms.
///
/// # Errors
///
/// The later one is earlier: it is from before, or of a board that has restarted.
pub(crate) fn elapsed_ms(from_us: u32, to_us: u32) -> Outcome<f64> {
    // Board time wraps.
    let ms = f64::from(to_us.wrapping_sub(from_us) as i32) / 1_000.0;
    let before = ms < -EARLIER_MS;
    ensure!(
        !before,
        "it was {:.0} ms before that, or the board has restarted",
        -ms
    );
    Ok(ms)
}

/// So much earlier the later one may be: where a drive is at neutral by itself.
const EARLIER_MS: f64 = 100.0;

/// The ESC had at least half of the pulses that come in a time; the rest is for a
/// machine that is busy. Without any, nothing can be said about them.
pub(crate) fn has_pulses_for(pulses: &[Pulses], time: Duration) -> Outcome {
    let expected = (time.as_millis() / 20) as usize;
    let seen = pulses.iter().filter(|pulses| pulses.esc_us != 0).count();
    ensure!(
        2 * seen >= expected,
        "the ESC had {seen} pulses in {time:.0?}, not {expected}"
    );
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_end_before_the_beginning_is_no_short_time() {
        assert_eq!(elapsed_ms(5_000, 47_000).unwrap(), 42.0);
        assert_eq!(elapsed_ms(u32::MAX, 999).unwrap(), 1.0);
        assert!(elapsed_ms(50_000, 30_000).unwrap() < 0.0);
        // A board that has been running for 70 ms again.
        assert!(elapsed_ms(6_000_000, 70_000).is_err());
    }

    #[test]
    fn silence_is_not_neutral() {
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
