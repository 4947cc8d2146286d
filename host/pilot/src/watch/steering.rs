//! Whether the car turns as it is steered: in every drive, and more closely on the first metre.

use libm::{copysign, fabs, tan};

use super::{WatchConfig, count, steps::Step};

/// The way of a step in wheelbases, negative in reverse: the turn that it makes per tangent of the
/// steering, rad; `wheelbase` in m.
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

/// The turn of the car by its steering: turn = (gain tan(steering) + trim) way / wheelbase. Gain and trim
/// are least squares of the steps, weighted by their way, and of a trim that is known for
/// [`TRIM_KNOWN`]. In a bend to one side a trim is much like a gain: the wave about the bend tells them
/// apart, the less the steeper the bend. What is left of a trim stays in the gain, and a large one shows in
/// the plain ratio of `made` to `wanted`.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct SteeringFit {
    /// Turn that angles beyond [`LEAST_STEERING`] should have made, without its signs, and that made with
    /// it, rad.
    pub(super) wanted: f64,
    pub(super) made: f64,
    /// Way, in wheelbases; and its integrals of the tangent of the steering and of its square.
    way: f64,
    steered: f64,
    steered_squared: f64,
    /// Turn as if driven forward, rad; and its integral of the tangent of the steering.
    turn: f64,
    steered_turn: f64,
}

/// The way by which a trim of zero is known before the first step, in wheelbases: a calibrated one is within
/// 0.025 rad, and cameras show as much in half a metre.
const TRIM_KNOWN: f64 = 2.0;

impl SteeringFit {
    /// A fit to so much turn to either side alike, rad: without a trim.
    #[cfg(test)]
    pub(super) fn of(wanted: f64, made: f64) -> Self {
        Self {
            wanted,
            made,
            steered_squared: wanted * wanted,
            steered_turn: wanted * made,
            ..Self::default()
        }
    }

    /// A step of a drive; `wheelbase` in m.
    pub(super) fn step(&mut self, step: &Step, wheelbase: f64) {
        let (way, tangent) = (wheelbases(step, wheelbase), tan(step.steering));
        let turn = copysign(1.0, way) * step.turn;
        let way = fabs(way);
        if fabs(step.steering) > LEAST_STEERING {
            self.wanted += way * fabs(tangent);
            self.made += copysign(1.0, tangent) * turn;
        }
        self.way += way;
        self.steered += way * tangent;
        self.steered_squared += way * tangent * tangent;
        self.turn += turn;
        self.steered_turn += tangent * turn;
    }

    /// The turn that was made per turn that the steering should have made, less what a trim explains;
    /// and the tangent of that trim.
    pub(super) fn gain_and_trim(&self) -> (f64, f64) {
        let way = self.way + TRIM_KNOWN;
        let mean = self.steered / way;
        let gain =
            (self.steered_turn - mean * self.turn) / (self.steered_squared - mean * self.steered);
        (gain, (self.turn - gain * self.steered) / way)
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
            assert!((fit.made - 0.02 * sign).abs() < 1e-12, "{fit:?}");
            assert!(
                (fit.gain_and_trim().0 - sign * 0.01 / expected).abs() < 1e-12,
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
        for bend in [-0.3, -0.2, -0.1, 0.1, 0.2, 0.3] {
            for way in [0.005, 0.015, 0.03] {
                for (gain, trim) in [(1.0, 0.0), (0.92, -0.025), (1.08, 0.025), (0.74, 0.025)] {
                    let fit = fitted((0..(1.0 / way) as u32).map(|number| {
                        let steering = bend + FirstMetre::wave(way * f64::from(number));
                        Step {
                            turn: way * (gain * tan(steering) + trim) / WHEELBASE,
                            steering,
                            ..ahead(way)
                        }
                    }));
                    assert!(fit.wanted > 0.3, "{fit:?}");
                    // In each of these bends, less than two thirds of what the trim is to the turn.
                    let ratio = fabs(trim) / fabs(bend);
                    let (fitted, explained) = fit.gain_and_trim();
                    let error = fabs(fitted - gain);
                    assert!(
                        error <= 2.0 / 3.0 * ratio + 1e-9,
                        "{bend} {way} {gain}: {fitted}"
                    );
                    assert!(explained * trim >= 0.0 && fabs(explained) <= fabs(trim) + 1e-9);
                }
            }
        }
    }

    #[test]
    fn a_turn_or_an_angle_that_is_no_number_has_no_gain() {
        for lost in [
            Step {
                turn: f64::NAN,
                ..ahead(0.02)
            },
            Step {
                steering: f64::NAN,
                ..ahead(0.02)
            },
        ] {
            let (gain, trim) = fitted([lost, steered(0.2)]).gain_and_trim();
            assert!(gain.is_nan() && trim.is_nan());
        }
    }
}
