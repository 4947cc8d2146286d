//! Whether the car turns as it is steered: in every drive, and more closely on the first metre.

use libm::{copysign, fabs, tan};

use super::{WatchConfig, count, steps::Step};

/// The way of a step in wheelbases (m), negative in reverse: the turn that it makes per tangent of the
/// steering, rad.
fn wheelbases(step: &Step, wheelbase: f64) -> f64 {
    copysign(step.rear.norm(), step.motor_way) / wheelbase
}

/// Turn and steering, as sums over a way.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct SteeringWatch {
    wanted: f64,
    made: f64,
    way: f64,
    exceeded: u32,
}

/// The way of one comparison, m.
const WAY: f64 = 0.4;
/// The turns may differ by this, rad: a bent course has lags, and a floor has bumps.
const MARGIN: f64 = 0.2;
/// The number of comparisons in a row beyond the limit.
const TIMES: u32 = 2;

impl SteeringWatch {
    /// A step of a drive; `wheelbase` in m.
    pub(crate) fn step(&mut self, step: &Step, wheelbase: f64, config: &WatchConfig) {
        self.wanted += wheelbases(step, wheelbase) * tan(step.steering);
        self.made += step.turn;
        self.way += step.rear.norm();
        // A NaN is no way that is too short, and exceeds the limit.
        if self.way < WAY {
            return;
        }
        let allowed = MARGIN + config.steering_ratio * fabs(self.wanted);
        let fits = fabs(self.made - self.wanted) <= allowed;
        count(&mut self.exceeded, !fits);
        *self = Self {
            exceeded: self.exceeded,
            ..Self::default()
        };
    }

    /// Whether the last comparison showed it.
    pub(crate) const fn is_doubtful(&self) -> bool {
        self.exceeded > 0
    }

    /// Whether the car turns otherwise than it is steered.
    pub(crate) const fn is_exceeded(&self) -> bool {
        self.exceeded >= TIMES
    }
}

/// Steering angles below this prove nothing, rad: trim and backlash.
const LEAST_STEERING: f64 = 0.04;

/// The turn of the car by its steering, as least squares of every step for a gain and a trim. In a bend
/// to one side a trim is much like a gain: the wave about the bend tells them apart.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct SteeringFit {
    /// Turn that angles beyond [`LEAST_STEERING`] should have made, without its signs, rad.
    pub(super) wanted: f64,
    /// Sums of products of the turn w that the steering should have made, the way x in wheelbases, and
    /// the turn y that was made.
    ww: f64,
    wx: f64,
    xx: f64,
    wy: f64,
    xy: f64,
}

/// What is known of a calibrated trim before the first step, as a sum of x²: a step's turn is off by 4 mrad,
/// the trim by 12.5 mrad.
const TRIM_KNOWN: f64 = 0.1;

impl SteeringFit {
    /// A fit to so much turn to either side, rad.
    #[cfg(test)]
    pub(super) fn of(wanted: f64, made: f64) -> Self {
        Self {
            wanted,
            ww: wanted * wanted,
            wy: wanted * made,
            ..Self::default()
        }
    }

    /// A step of a drive; `wheelbase` in m.
    pub(super) fn step(&mut self, step: &Step, wheelbase: f64) {
        let x = wheelbases(step, wheelbase);
        let (w, y) = (x * tan(step.steering), step.turn);
        if fabs(step.steering) > LEAST_STEERING {
            self.wanted += fabs(w);
        }
        self.ww += w * w;
        self.wx += w * x;
        self.xx += x * x;
        self.wy += w * y;
        self.xy += x * y;
    }

    /// The turn that was made per turn that the steering should have made, less what a trim explains.
    pub(super) fn gain(&self) -> f64 {
        let trim = self.wx / (self.xx + TRIM_KNOWN);
        (self.wy - trim * self.xy) / (self.ww - trim * self.wx)
    }
}

#[cfg(test)]
mod tests {
    use libm::atan;
    use singletrack_control::{Velocity, direction};

    use super::*;
    use crate::watch::FirstMetre;

    /// A step straight ahead along the axis of the world (m).
    fn ahead(way: f64) -> Step {
        Step {
            time: 0.0625,
            rear: Velocity::new(way, 0.0),
            yaw: 0.0,
            turn: 0.0,
            gyro_turn: 0.0,
            forward: 0.0,
            left: 0.0,
            steering: 0.0,
            motor_way: way,
        }
    }

    const WHEELBASE: f64 = 0.25;

    /// A step of an eighth of a metre whose steering wants a turn of 0.2 rad.
    fn steered(turn: f64) -> Step {
        Step {
            rear: 0.125 * direction(0.7),
            turn,
            steering: atan(0.4),
            ..ahead(0.0625)
        }
    }

    /// The number of equal steps after which the turn differs from the steering.
    fn steering(step: Step) -> Option<usize> {
        let mut watch = SteeringWatch::default();
        (1..=1_000).find(|_| {
            watch.step(&step, WHEELBASE, &WatchConfig::paper());
            watch.is_exceeded()
        })
    }

    #[test]
    fn a_car_that_turns_otherwise_than_steered_is_implausible_after_two_ways() {
        // 4 steps want 0.8 rad, to within 0.2 rad and the half of it.
        for (turn, steps) in [
            (0.2, None),
            (0.051, None),
            (0.049, Some(8)),
            (-0.2, Some(8)),
            (0.349, None),
            (0.351, Some(8)),
            (f64::NAN, Some(8)),
        ] {
            assert_eq!(steering(steered(turn)), steps, "{turn}");
            let reverse = Step {
                motor_way: -0.01,
                ..steered(-turn)
            };
            assert_eq!(steering(reverse), steps, "{turn} in reverse");
        }
    }

    #[test]
    fn a_fitting_way_and_a_reset_forget_the_turns() {
        let mut watch = SteeringWatch::default();
        let mut steer = |turn: f64, reset: bool| {
            if reset {
                watch = SteeringWatch::default();
            }
            for _ in 0..4 {
                watch.step(&steered(turn), WHEELBASE, &WatchConfig::paper());
            }
            watch.is_exceeded()
        };
        for (turn, reset, exceeded) in [
            (0.0, false, false),
            (0.2, false, false),
            (0.0, false, false),
            (0.0, false, true),
            (0.0, false, true),
            (0.0, true, false),
            (0.0, false, true),
            (0.2, false, false),
        ] {
            assert_eq!(steer(turn, reset), exceeded);
        }
    }

    #[test]
    fn a_way_that_is_no_number_exceeds_the_limit() {
        let lost = Step {
            rear: f64::NAN * direction(0.7),
            ..ahead(0.0625)
        };
        assert_eq!(steering(lost), Some(2));
    }

    fn fitted(steps: impl IntoIterator<Item = Step>) -> SteeringFit {
        let mut fit = SteeringFit::default();
        for step in steps {
            fit.step(&step, WHEELBASE);
        }
        fit
    }

    #[test]
    fn the_turn_that_the_steering_should_make_has_the_sign_of_steering_and_motor() {
        // 0.02 m at 0.2 rad.
        let expected = 0.02 * tan(0.2) / 0.25;
        for (motor_way, steering, sign) in [
            (0.02, 0.2, 1.0),
            (0.02, -0.2, -1.0),
            (-0.02, 0.2, -1.0),
            (-0.02, -0.2, 1.0),
        ] {
            let step = Step {
                motor_way,
                steering,
                turn: 0.01,
                ..ahead(0.02)
            };
            let fit = fitted([step, step]);
            assert!((fit.wanted - 2.0 * expected).abs() < 1e-12, "{fit:?}");
            assert!(
                (fit.gain() - sign * 0.01 / expected).abs() < 1e-12,
                "{fit:?}"
            );
        }
    }

    #[test]
    fn a_steering_angle_of_trim_and_backlash_proves_nothing() {
        let step = |steering| Step {
            steering,
            ..ahead(0.02)
        };
        let wanted = |steps: &[Step]| fitted(steps.iter().copied()).wanted;
        assert_eq!(wanted(&[step(0.04), step(-0.04)]), 0.0);
        assert!(wanted(&[step(0.041)]) > 0.0);
        assert!(wanted(&[step(-0.041)]) > 0.0);
    }

    #[test]
    fn in_a_bend_to_one_side_a_trim_is_not_taken_for_a_gain() {
        let bend = |gain: f64, trim: f64| {
            fitted((0..66).map(|number| {
                let steering = 0.2 + FirstMetre::wave(0.015 * f64::from(number));
                Step {
                    steering,
                    turn: 0.015 * tan(gain * steering + trim) / WHEELBASE,
                    ..ahead(0.015)
                }
            }))
        };
        // Without the fit, a trim of 0.025 rad is a gain that is wrong by 0.12.
        for (gain, trim) in [(1.0, 0.0), (0.92, -0.025), (1.08, 0.025), (0.74, 0.025)] {
            let fit = bend(gain, trim);
            assert!(fit.wanted > 0.3, "{fit:?}");
            assert!(
                (fit.gain() - gain).abs() < 0.07,
                "{gain} {trim}: {}",
                fit.gain()
            );
        }
    }
}
