//! How fast a car slows down on its way to standstill.

/// The longest time after which the car slows down, s: command, ESC and motor.
pub(super) const REACTION: f64 = 0.25;
/// The fall of the speed by which a car slows down, m/s: beyond the noise of the estimate.
const FALLEN: f64 = 0.03;
/// The highest deceleration that can be measured, m/s².
const MOST: f64 = 10.0;

/// A car that is to slow down, measured from the first fall of its speed: the time until
/// then depends on its ESC, and counts neither for its brakes nor against them.
#[derive(Clone, Copy, Debug)]
pub(super) struct RollOut {
    /// The highest speed, m/s.
    highest: f64,
    /// The speed when it began to fall, m/s, and the way since, m.
    from: f64,
    way: f64,
}

impl RollOut {
    /// Begins at this speed, m/s.
    pub(super) const fn begin(speed: f64) -> Self {
        Self {
            highest: speed,
            from: speed,
            way: 0.0,
        }
    }

    /// A tick, with the time since the beginning (s), the speed (m/s), and the way of the tick
    /// (m).
    pub(super) fn tick(&mut self, elapsed: f64, speed: f64, way: f64) {
        self.way += way;
        self.highest = self.highest.max(speed);
        if elapsed < REACTION && speed > self.highest - FALLEN {
            self.from = speed;
            self.way = 0.0;
        }
    }

    /// The speed when it began to fall, m/s.
    pub(super) const fn from(&self) -> f64 {
        self.from
    }

    /// The deceleration until now, with the speed that is left (m/s), in m/s².
    pub(super) fn deceleration(&self, left: f64) -> f64 {
        let fallen = (self.from * self.from - left * left).max(0.0);
        if self.way <= fallen / (2.0 * MOST) {
            MOST
        } else {
            fallen / (2.0 * self.way)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The deceleration measured of a car that sets on to slow down after `reaction` s.
    fn measured(speed: f64, deceleration: f64, reaction: f64, acceleration: f64) -> f64 {
        let mut now = speed;
        let mut roll_out = RollOut::begin(now);
        let mut tick = 0;
        while now > 0.08 {
            tick += 1;
            let elapsed = 0.01 * f64::from(tick);
            let change = if elapsed <= reaction {
                acceleration
            } else {
                -deceleration
            };
            let next = now + 0.01 * change;
            roll_out.tick(elapsed, next, 0.005 * (now + next));
            now = next;
        }
        roll_out.deceleration(now)
    }

    #[test]
    fn the_deceleration_is_measured_whatever_the_reaction_time() {
        for speed in [0.3, 0.5, 1.5] {
            for deceleration in [0.25, 0.7, 1.4, 2.5] {
                for reaction in [0.0, 0.05, 0.1, 0.2] {
                    for acceleration in [0.0, 0.5] {
                        let found = measured(speed, deceleration, reaction, acceleration);
                        assert!(
                            (found / deceleration - 1.0).abs() < 0.1,
                            "{found} of {deceleration} from {speed}, {reaction}, {acceleration}"
                        );
                    }
                }
            }
        }
    }

    #[test]
    fn a_car_that_hardly_slows_down_is_measured_from_the_reaction_time_on() {
        let found = measured(0.5, 0.05, 0.0, 0.0);
        assert!((0.045..0.055).contains(&found), "{found}");
    }

    #[test]
    fn the_fall_begins_below_the_highest_speed_less_its_noise_or_after_the_reaction_time() {
        let mut roll_out = RollOut::begin(0.5);
        for (elapsed, speed, from) in [
            (0.01, 0.471, 0.471),
            (0.02, 0.5 - 0.03, 0.471),
            (0.03, 0.6, 0.6),
            (0.04, 0.5, 0.6),
            (0.05, 0.571, 0.571),
            (0.25, 0.6, 0.571),
            (0.3, 0.7, 0.571),
        ] {
            roll_out.tick(elapsed, speed, 0.1);
            assert_eq!(roll_out.from(), from, "{elapsed}");
        }
        assert!((roll_out.way - 0.2).abs() < 1e-12, "{}", roll_out.way);
    }

    #[test]
    fn the_deceleration_is_that_of_the_lost_speed_over_the_way_up_to_a_limit() {
        // 0.16 m²/s² are lost.
        for (way, left, expected) in [
            (0.1, 0.3, 0.8),
            (0.01, 0.3, 8.0),
            (0.007, 0.3, 10.0),
            (0.0, 0.3, 10.0),
            (0.1, 0.6, 0.0),
        ] {
            let mut roll_out = RollOut::begin(0.5);
            roll_out.tick(0.3, 0.3, way);
            let found = roll_out.deceleration(left);
            assert!((found - expected).abs() < 1e-9, "{way} {left}: {found}");
        }
    }
}
