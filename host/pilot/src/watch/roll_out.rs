//! How fast a car slows down on its way to standstill.

use singletrack_control::Time;

/// The longest time after which the car slows down, s: command, ESC and motor.
pub(super) const REACTION: f64 = 0.25;
/// The fall of the speed by which a car slows down, m/s: beyond the noise of the estimate.
const FALLEN: f64 = 0.03;
/// The highest deceleration that can be measured, m/s².
const MOST: f64 = 10.0;
/// From this speed on, m/s, all speeds of the way count. Below, most of the few that are left are
/// those of a coarse motor sensor that still shows the mean since its last pulse: a line through them
/// gave half of the true deceleration from 0.3 m/s.
const LINE_FROM: f64 = 0.5;

/// A car that is to slow down, measured from the first fall of its speed: the time until
/// then depends on its ESC, and counts neither for its brakes nor against them.
///
/// v²/2s from the speed at which it began to fall would be as wrong as twice that speed is, and it is
/// the last of the high ones, whose error is mostly upward. So all speeds since then count, from
/// [`LINE_FROM`] on: those of a car that slows down steadily lie on a line over the way, which falls to
/// the last one.
#[derive(Clone, Copy, Debug)]
pub(super) struct RollOut {
    /// The highest speed, m/s.
    highest: f64,
    /// The speed when it began to fall, m/s, and the way since, m.
    pub(super) from: f64,
    way: f64,
    line: SquareLine,
}

/// Squares of speeds over the way, in sums.
#[derive(Clone, Copy, Debug, Default)]
struct SquareLine {
    count: f64,
    ways: f64,
    ways_squared: f64,
    squares: f64,
    products: f64,
}

impl SquareLine {
    fn add(&mut self, way: f64, speed: f64) {
        let square = speed * speed;
        self.count += 1.0;
        self.ways += way;
        self.ways_squared += way * way;
        self.squares += square;
        self.products += way * square;
    }

    /// Half of the slope towards the speed that is left (m/s) at this way (m), m/s²: the least squares
    /// over the way that remained at each.
    fn deceleration(&self, way: f64, left: f64) -> f64 {
        let remained = self.count * way - self.ways;
        let fallen = way * self.squares - self.products - left * left * remained;
        let squared = way * (remained - self.ways) + self.ways_squared;
        0.5 * fallen / squared
    }
}

impl RollOut {
    /// Begins at this speed, m/s.
    pub(super) fn begin(speed: f64) -> Self {
        let mut line = SquareLine::default();
        line.add(0.0, speed);
        Self {
            highest: speed,
            from: speed,
            way: 0.0,
            line,
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
            self.line = SquareLine::default();
        }
        self.line.add(self.way, speed);
    }

    /// The deceleration until now, with the speed that is left (m/s), in m/s².
    pub(super) fn deceleration(&self, left: f64) -> f64 {
        let fallen = (self.from * self.from - left * left).max(0.0);
        if self.way <= fallen / (2.0 * MOST) {
            MOST
        } else if self.from < LINE_FROM {
            fallen / (2.0 * self.way)
        } else {
            // A NaN stays one.
            self.line.deceleration(self.way, left).clamp(0.0, MOST)
        }
    }
}

/// How far beyond the ramp a car may be that its motor leads along it, m/s.
pub(super) const BEYOND: f64 = 0.03;
/// Approach to the ramp by which a car counts as braked, m/s. A brake of two servo periods,
/// the shortest one, takes 0.025 m/s off a car; the estimate is steadier than a speed against its
/// highest one ([`FALLEN`]), for only a fall that is faster than the ramp counts.
const NEARER: f64 = 0.02;

/// The last part of a stop in which the motor is free: the car is faster than the ramp that
/// the motor is to follow, and does not come nearer to it. As long as it does come nearer, its
/// ESC brakes it. No geofence can rely on that: the board brakes for half a second at most, and
/// not again before the motor has driven.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct FreePart(Option<Beyond>);

/// A car that is faster than the ramp.
#[derive(Clone, Copy, Debug)]
struct Beyond {
    begin: Time,
    roll_out: RollOut,
    /// How far it is beyond the ramp, m/s: when it began, and at most since.
    least: f64,
    most: f64,
}

impl FreePart {
    /// A tick with the speed, that of the ramp, the lowest one from which a part may begin
    /// (m/s), and the way of the tick (m).
    pub(super) fn tick(&mut self, now: Time, speed: f64, ramp: f64, lowest: f64, way: f64) {
        let beyond = speed - ramp;
        // There is nothing to come nearer to once the car is to stand.
        let ramps = ramp > 0.0;
        if ramps && beyond <= BEYOND {
            self.0 = None;
            return;
        }
        let comes_nearer = self
            .0
            .is_none_or(|part| beyond < part.least || beyond < part.most - NEARER);
        if ramps && comes_nearer && speed >= lowest {
            self.0 = Some(Beyond {
                begin: now,
                roll_out: RollOut::begin(speed),
                least: beyond,
                most: beyond,
            });
        } else if let Some(part) = &mut self.0 {
            part.most = part.most.max(beyond);
            let elapsed = now.seconds_since(part.begin);
            part.roll_out.tick(elapsed, speed, way);
        }
    }

    /// The part, if there is one.
    pub(super) fn roll_out(&self) -> Option<RollOut> {
        self.0.map(|part| part.roll_out)
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
    fn the_error_of_no_single_speed_counts_twice() {
        // A speed wave of 0.035 m/s and 60 ms, as the estimate has it beside a wheel that shakes the IMU: the
        // last high speed is one of its crests, 4 % beyond 0.7 m/s.
        let deceleration = 1.3;
        let mut worst: f64 = 0.0;
        for phase in 0..12 {
            let mut roll_out = RollOut::begin(0.7);
            let mut now: f64 = 0.7;
            let mut tick = 0;
            while now > 0.0 {
                tick += 1;
                let next = if tick > 10 {
                    f64::max(now - 0.01 * deceleration, 0.0)
                } else {
                    now
                };
                let turn =
                    core::f64::consts::TAU * (f64::from(tick) / 6.0 + f64::from(phase) / 12.0);
                let seen = next + 0.035 * libm::sin(turn);
                roll_out.tick(0.01 * f64::from(tick), seen, 0.01 * libm::fabs(seen));
                now = next;
            }
            worst = worst.max(libm::fabs(roll_out.deceleration(0.0) / deceleration - 1.0));
        }
        assert!(worst < 0.05, "{worst}");
    }

    #[test]
    fn a_coarse_sensor_that_lags_at_the_end_does_not_halve_the_deceleration_of_a_slow_car() {
        // The estimate follows with 40 ms, as beside a pulse each 25 mm.
        let deceleration = 1.9;
        for speed in [0.27, 0.3, 0.35] {
            let mut roll_out = RollOut::begin(speed);
            let (mut now, mut seen): (f64, f64) = (speed, speed);
            for tick in 1..40 {
                now = f64::max(now - 0.01 * deceleration, 0.0);
                seen += (now - seen) * 0.25;
                roll_out.tick(0.01 * f64::from(tick), seen, 0.01 * seen);
            }
            let found = roll_out.deceleration(0.0);
            assert!(found > 0.6 * deceleration, "{speed}: {found}");
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
            assert_eq!(roll_out.from, from, "{elapsed}");
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

    #[test]
    fn the_free_part_begins_anew_while_the_car_comes_nearer_to_the_ramp() {
        // Time (ms), speed, ramp, and the speed from which the part counts.
        for ticks in [
            // As far beyond the ramp as its motor may lead it; then farther.
            &[(0, 0.629, 0.6, None), (10, 0.62, 0.58, Some(0.62))][..],
            // It comes nearer than where it began.
            &[
                (0, 0.65, 0.6, Some(0.65)),
                (10, 0.6, 0.56, Some(0.6)),
                (20, 0.58, 0.53, Some(0.58)),
            ],
            // It comes nearer than it has been, beyond the noise.
            &[
                (0, 0.64, 0.6, Some(0.64)),
                (10, 0.63, 0.53, Some(0.63)),
                (20, 0.58, 0.499, Some(0.63)),
                (30, 0.53, 0.461, Some(0.53)),
                (40, 0.495, 0.436, Some(0.495)),
            ],
            // The motor drives it, and lets it go.
            &[
                (0, 0.64, 0.6, Some(0.64)),
                (10, 0.59, 0.57, None),
                (20, 0.59, 0.54, Some(0.59)),
            ],
            // It is too slow to begin; but a part goes on.
            &[(0, 0.249, 0.2, None)],
            &[(0, 0.255, 0.2, Some(0.255)), (10, 0.22, 0.18, Some(0.255))],
            // After the ramp nothing begins.
            &[(0, 0.6, 0.0, None)],
            &[(0, 0.6, 0.5, Some(0.6)), (10, 0.55, -0.1, Some(0.6))],
        ] {
            let mut free = FreePart::default();
            for &(ms, speed, ramp, from) in ticks {
                free.tick(Time(1_000_000 * ms), speed, ramp, 0.25, 0.01 * speed);
                let found = free.roll_out().map(|roll_out| roll_out.from);
                assert_eq!(found, from, "{ticks:?} at {ms} ms");
            }
        }
    }
}
