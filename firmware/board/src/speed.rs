//! The speed controller: feed-forward, proportional, and a limited integral.

use singletrack_protocol::SpeedLoop;

/// Products of a gain in µs per m/s and a speed in mm/s, per µs.
const UNITS_PER_US: i32 = 1_000;

/// The integral has finer units, by a power of two: on the AVR a shift costs a
/// tenth of a division.
const INTEGRAL_SHIFT: u32 = 7;
const INTEGRAL_UNITS_PER_US: i32 = UNITS_PER_US << INTEGRAL_SHIFT;

/// Integral per control period of 10 ms and 1 mm/s of error, for a gain in µs/m:
/// 1.28 units, approximated by 1311 / 1024.
const fn integral_gain(us_per_m: u16) -> i32 {
    ((us_per_m as u32 * 1_311) >> 10) as i32
}

/// Limits of the pulse, in µs beyond the deadband, in the direction of travel.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Room {
    /// Largest allowed pulse.
    pub(crate) highest: i32,
    /// Whether the pulse is still slewing to its last target.
    pub(crate) lagging: bool,
}

/// The controller. Speeds and pulses are in the direction of travel.
#[derive(Clone, Debug)]
pub(crate) struct SpeedController {
    integral: i32,
}

impl SpeedController {
    pub(crate) const fn new() -> Self {
        Self { integral: 0 }
    }

    pub(crate) const fn reset(&mut self) {
        self.integral = 0;
    }

    /// The pulse beyond the deadband for the next control period, in µs; the caller
    /// applies the limits. The present error enters the integral of the next
    /// period.
    ///
    /// With validated gains (5000 at most) and 16-bit speeds every product is
    /// below 2^29.
    pub(crate) fn update(
        &mut self,
        gains: &SpeedLoop,
        target_mm_s: i32,
        measured_mm_s: i32,
        room: Room,
    ) -> i32 {
        let error = target_mm_s - measured_mm_s;
        let direct = i32::from(gains.feed_forward_us_per_m_s) * target_mm_s
            + i32::from(gains.proportional_us_per_m_s) * error;
        let pulse = (direct + (self.integral >> INTEGRAL_SHIFT)) / UNITS_PER_US;
        // Anti-windup: a saturated pulse stops the integration.
        let too_high = pulse >= room.highest || room.lagging;
        let too_low = pulse <= 0;
        if !(error > 0 && too_high || error < 0 && too_low) {
            let limit = i32::from(gains.integral_limit_us) * INTEGRAL_UNITS_PER_US;
            let change = integral_gain(gains.integral_us_per_m) * error;
            self.integral = (self.integral + change).min(limit).max(-limit);
        }
        pulse
    }
}

#[cfg(test)]
mod tests {
    use singletrack_protocol::SpeedLoop;

    use super::{Room, SpeedController};

    const GAINS: SpeedLoop = SpeedLoop {
        pulse_distance_um: 5_000,
        feed_forward_us_per_m_s: 100,
        proportional_us_per_m_s: 50,
        integral_us_per_m: 200,
        integral_limit_us: 80,
        max_forward_mm_s: 3_000,
        max_reverse_mm_s: 500,
    };
    const FREE: Room = Room {
        highest: 1_000,
        lagging: false,
    };

    #[test]
    fn feed_forward_proportional_and_integral_add_up() {
        let mut controller = SpeedController::new();
        // 100 us + 50 us, and 200 us/m * 1 m/s * 10 ms = 2 us.
        assert_eq!(controller.update(&GAINS, 1_000, 0, FREE), 150);
        assert_eq!(controller.update(&GAINS, 1_000, 1_000, FREE), 102);
        assert_eq!(controller.update(&GAINS, 1_000, 1_500, FREE), 77);
        assert_eq!(controller.update(&GAINS, 1_000, 1_000, FREE), 101);
    }

    #[test]
    fn the_integral_ends_at_its_limit_on_both_sides() {
        let mut controller = SpeedController::new();
        for _ in 0..1_000 {
            controller.update(&GAINS, 1_000, 500, FREE);
        }
        assert_eq!(controller.update(&GAINS, 1_000, 1_000, FREE), 180);
        for _ in 0..1_000 {
            controller.update(&GAINS, 2_500, 3_000, FREE);
        }
        assert_eq!(controller.update(&GAINS, 2_500, 2_500, FREE), 170);
    }

    #[test]
    fn a_saturated_pulse_stops_the_integration() {
        for room in [
            Room {
                highest: 120,
                lagging: false,
            },
            Room {
                highest: 1_000,
                lagging: true,
            },
        ] {
            let mut controller = SpeedController::new();
            for _ in 0..1_000 {
                controller.update(&GAINS, 1_000, 0, room);
            }
            assert_eq!(controller.update(&GAINS, 1_000, 1_000, FREE), 100);
        }
        let mut controller = SpeedController::new();
        for _ in 0..1_000 {
            controller.update(&GAINS, 100, 1_000, FREE);
        }
        assert_eq!(controller.update(&GAINS, 100, 100, FREE), 10);
    }

    #[test]
    fn the_extremes_of_a_valid_configuration_do_not_overflow() {
        let gains = SpeedLoop {
            feed_forward_us_per_m_s: 5_000,
            proportional_us_per_m_s: 5_000,
            integral_us_per_m: 5_000,
            integral_limit_us: 700,
            ..GAINS
        };
        let mut controller = SpeedController::new();
        let free = Room {
            highest: i32::MAX,
            lagging: false,
        };
        for (target, measured) in [(20_000, 0), (0, 32_767), (20_000, 32_767)] {
            for _ in 0..100 {
                controller.update(&gains, target, measured, free);
            }
        }
    }
}
