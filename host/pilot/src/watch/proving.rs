//! The first metre of an unproved configuration: every sensor against every other.

use core::f64::consts::TAU;

use libm::{atan2, fabs, sin};
use singletrack_control::Time;

use super::{imu::Turns, roll_out::RollOut, steering::SteeringFit, steps::Step};
use crate::supervisor::Reason;

/// What holds until every sensor has been compared with every other.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FirstMetre {
    /// The least way until then, m.
    pub way: f64,
    /// The highest speed, m/s.
    pub speed: f64,
    /// The deceleration that the geofence relies on at most, m/s²: that of a car that rolls well.
    pub braking: f64,
}

/// The limits of the first metre of an unproved configuration.
pub const FIRST_METRE: FirstMetre = FirstMetre {
    way: 1.0,
    speed: 0.3,
    braking: 0.25,
};

/// The span of the comparison of the gyro, s, and the least turn in it, rad: the cameras' yaw
/// has noise.
const GYRO_SPAN: f64 = 0.2;
const LEAST_TURN: f64 = 0.015;
/// The turn that the steering should have made by which a reversed servo shows, rad.
const SIGN_AFTER: f64 = 0.08;
/// The turn by which a servo with a wrong gain shows, rad.
const SIZE_AFTER: f64 = 0.17;
/// The turn by which the steering is proved, rad.
const PROVED_AFTER: f64 = 0.3;
/// Turn per turn that the steering should have made.
const STEERING_RATIO: (f64, f64) = (0.65, 1.4);
/// The ratio once the steering has made [`PROVED_AFTER`]: in a bend, the trim of a calibrated car takes a
/// seventh of it.
const PROVED_RATIO: (f64, f64) = (0.68, 1.29);
/// The ratio less what a trim explains, once a wave is driven as well: a wheelbase that is wrong by a quarter
/// shows. A gain that is wrong by a fifth drives on, and online calibration finds it.
const PROVED_GAIN: (f64, f64) = (0.757, 1.29);
/// The largest trim then, as a tangent: on a straight about half of a true one is fitted, in a bend less, and
/// a calibrated one is 0.025 at most.
const MOST_TRIM: f64 = 0.03;
/// Turn of the gyro per turn of the cameras.
const GYRO_RATIO: (f64, f64) = (0.75, 1.3);
/// The way after which a wrong yaw of the body shows, m.
const YAW_AFTER: f64 = 0.15;
/// The way across the yaw that is more than noise, m.
const LEAST_ACROSS: f64 = 0.004;
/// The way after which a yaw that is wrong by a right angle or more shows, m.
const CROSSWISE_AFTER: f64 = 0.04;
/// The largest angle between the motion of the rear axle and the yaw, rad.
const YAW_ERROR: f64 = 0.115;
/// The way by which the motor and the cameras are compared, m...
const MOTOR_AFTER: f64 = 0.2;
/// ...and how much they may differ: in m, beyond the two pulses that a speed takes, and as
/// a share.
const MOTOR_TOLERANCE: (f64, f64) = (0.02, 0.15);

/// The steering follows a wave until it is proved: its amplitude, rad, and its length, m.
pub(crate) const WAVE: f64 = 0.18;
const WAVE_LENGTH: f64 = 0.5;

/// The way at which the car is left to roll, m, for how long at most, s, and the lowest
/// speed at which that says anything, m/s. A slower reference is never proved.
const COAST_AT: f64 = 0.7;
const COAST_FOR: f64 = 0.5;
const COAST_FROM: f64 = 0.22;
/// The roll ends below this speed, m/s.
const COAST_UNTIL: f64 = 0.08;
/// A roll that loses less than this share of the configured deceleration is too weak.
const COAST_SHARE: f64 = 0.8;

impl FirstMetre {
    /// What is added to the steering after a way (m), in rad: a straight reference shows no sign of the
    /// servo.
    pub fn wave(way: f64) -> f64 {
        WAVE * sin(TAU * way / WAVE_LENGTH)
    }
}

/// What the proving run asks of the next command, and what it found.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct ProvingTick {
    /// The car is to roll at neutral.
    pub(crate) coast: bool,
    /// What to add to the steering, rad: a straight reference shows no sign of the servo.
    pub(crate) steering: f64,
    /// Everything has been compared, and nothing contradicts.
    pub(crate) passed: bool,
    /// The deceleration of the roll that ended in this tick, m/s².
    pub(crate) coasted: Option<f64>,
}

/// Compares the sensors during a drive.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Proving {
    /// Driven way, m.
    way: f64,
    last: Option<Time>,
    /// What contradicts, if anything does.
    pub(crate) found: Option<Reason>,
    steering: SteeringFit,
    turns: Turns,
    /// Way along and to the left of the yaw.
    along: f64,
    across: f64,
    motor_way: f64,
    coast: Coast,
}

/// The roll at neutral.
#[derive(Clone, Copy, Debug, Default)]
enum Coast {
    #[default]
    Ahead,
    Begun {
        since: Time,
        roll_out: RollOut,
    },
    Over,
}

impl Proving {
    /// Whether the car moves across the yaw of the body rather than along it: at that angle
    /// the law is singular, before the way proves it.
    pub(crate) fn moves_across(&self) -> bool {
        fabs(self.across) > fabs(self.along) && fabs(self.across) > LEAST_ACROSS
    }

    /// A step of the drive; wheelbase and way of a motor pulse in m.
    pub(crate) fn step(&mut self, step: &Step, wheelbase: f64, pulse_distance: f64) {
        if self.found.is_some() {
            return;
        }
        let along = step.along();
        // A body whose yaw is wrong by more than a right angle moves backward.
        let way = step.rear.norm();
        if way > 0.002 {
            self.along += along;
            self.across += step.across();
            self.motor_way += step.motor_way;
        }
        self.steering.step(step, wheelbase);
        self.turns.step(step, GYRO_SPAN, LEAST_TURN);
        self.found = self.found.or(self.contradiction(pulse_distance));
    }

    fn contradiction(&self, pulse_distance: f64) -> Option<Reason> {
        // A NaN is outside.
        let outside = |ratio: f64, (low, high): (f64, f64)| !(low <= ratio && ratio <= high);
        // Gyro and cameras first: what they agree on is the turn of the car.
        let Turns { seen, felt, .. } = self.turns;
        let differs = seen > SIZE_AFTER && outside(felt / seen, GYRO_RATIO);
        let opposite = seen > SIGN_AFTER && felt < 0.3 * seen;
        if differs || opposite {
            return Some(Reason::GyroDiffers);
        }
        let SteeringFit { wanted, made, .. } = self.steering;
        if wanted > SIGN_AFTER && made < -0.3 * wanted {
            return Some(Reason::SteeringReversed);
        }
        let way = fabs(self.along) + fabs(self.across);
        let angle = fabs(atan2(self.across, self.along));
        if (way > YAW_AFTER && angle > YAW_ERROR) || (way > CROSSWISE_AFTER && angle > 1.0) {
            return Some(Reason::BodyYawWrong);
        }
        let differs = wanted > SIZE_AFTER && outside(made / wanted, STEERING_RATIO);
        let (gain, trim) = self.steering.gain_and_trim();
        let is_fitted = self.way >= WAVE_LENGTH;
        let is_off = wanted > PROVED_AFTER
            && (outside(made / wanted, PROVED_RATIO)
                || is_fitted && outside(gain, PROVED_GAIN)
                || is_fitted && outside(trim, (-MOST_TRIM, MOST_TRIM)));
        if differs || is_off {
            return Some(Reason::SteeringDiffers);
        }
        let (margin, share) = MOTOR_TOLERANCE;
        let most = self.along.max(self.motor_way);
        let allowed = margin + 2.0 * pulse_distance + share * most;
        if most > MOTOR_AFTER && fabs(self.along - self.motor_way) > allowed {
            return Some(Reason::MotorSpeedMismatch);
        }
        None
    }

    /// A tick of the drive with the estimated speed (m/s), the configured deceleration
    /// (m/s²), and whether the accelerometer has been compared at its start.
    pub(crate) fn tick(
        &mut self,
        now: Time,
        speed: f64,
        braking: f64,
        start_judged: bool,
    ) -> ProvingTick {
        let elapsed = self.last.replace(now).map(|last| now.seconds_since(last));
        let way = fabs(speed) * elapsed.unwrap_or(0.0);
        self.way += way;
        let mut tick = ProvingTick::default();
        match &mut self.coast {
            Coast::Ahead if self.way >= COAST_AT && speed > COAST_FROM => {
                self.coast = Coast::Begun {
                    since: now,
                    roll_out: RollOut::begin(speed),
                };
                tick.coast = true;
            }
            Coast::Begun { since, roll_out } => {
                let rolled = now.seconds_since(*since);
                roll_out.tick(rolled, fabs(speed), way);
                tick.coast = rolled < COAST_FOR && speed > COAST_UNTIL;
                if !tick.coast {
                    let measured = roll_out.deceleration(fabs(speed));
                    tick.coasted = Some(measured);
                    if measured < COAST_SHARE * braking && self.found.is_none() {
                        self.found = Some(Reason::BrakesLessThanConfigured);
                    }
                    self.coast = Coast::Over;
                }
            }
            Coast::Ahead | Coast::Over => {}
        }
        if self.way < FIRST_METRE.way || self.steering.wanted <= PROVED_AFTER {
            tick.steering = FirstMetre::wave(self.way);
        }
        tick.passed = self.found.is_none()
            && self.way >= FIRST_METRE.way
            && self.steering.wanted > PROVED_AFTER
            && start_judged
            && matches!(self.coast, Coast::Over);
        tick
    }
}

#[cfg(test)]
mod tests {
    use core::f64::consts::FRAC_1_SQRT_2;

    use libm::tan;

    use singletrack_control::Velocity;

    use super::*;

    const PULSE: f64 = 0.003;

    /// A step along (m) and to the left (m) of the yaw, as the motor counts it.
    fn motion(along: f64, across: f64) -> Step {
        Step {
            time: 0.05,
            rear: Velocity::new(along, across),
            yaw: 0.0,
            turn: 0.0,
            gyro_turn: 0.0,
            forward: 0.0,
            left: 0.0,
            steering: 0.0,
            motor_way: along,
        }
    }

    fn after(steps: &[Step]) -> Proving {
        let mut proving = Proving::default();
        for step in steps {
            proving.step(step, 0.25, PULSE);
        }
        proving
    }

    fn is_near(value: f64, expected: f64) -> bool {
        (value - expected).abs() < 1e-12
    }

    #[test]
    fn a_car_moves_across_its_yaw_beyond_noise_and_half_a_right_angle() {
        for (along, across, expected) in [
            (0.0, 0.0, false),
            (0.01, 0.01, false),
            (0.01, 0.011, true),
            (0.01, -0.011, true),
            (-0.01, 0.009, false),
            (0.003, 0.004, false),
            (0.003, 0.004_1, true),
        ] {
            let proving = after(&[motion(along, across)]);
            assert_eq!(proving.moves_across(), expected, "{along} {across}");
        }
    }

    #[test]
    fn the_ways_are_summed_beyond_noise() {
        let step = Step {
            motor_way: 0.015,
            ..motion(0.02, 0.001)
        };
        let noise = Step {
            motor_way: 0.1,
            ..motion(0.002, 0.0)
        };
        let proving = after(&[step, noise, step]);
        assert!(is_near(proving.along, 0.04), "{}", proving.along);
        assert!(is_near(proving.across, 0.002), "{}", proving.across);
        assert!(is_near(proving.motor_way, 0.03), "{}", proving.motor_way);
    }

    #[test]
    fn a_gyro_with_another_gain_or_sign_than_the_cameras_is_found() {
        for (seen, felt, differs) in [
            (0.17, 0.12, false),
            (0.171, 0.12, true),
            (0.2, 0.149, true),
            (0.2, 0.151, false),
            (0.2, 0.259, false),
            (0.2, 0.261, true),
            (0.2, f64::NAN, true),
            (0.08, 0.0, false),
            (0.081, 0.024, true),
            (0.081, 0.024_5, false),
            (0.1, 0.3 * 0.1, false),
        ] {
            let mut proving = Proving::default();
            (proving.turns.seen, proving.turns.felt) = (seen, felt);
            let expected = differs.then_some(Reason::GyroDiffers);
            assert_eq!(proving.contradiction(PULSE), expected, "{seen} {felt}");
        }
    }

    #[test]
    fn a_servo_with_another_sign_or_gain_is_found() {
        for (wanted, made, expected) in [
            (0.08, -0.08, None),
            (0.1, -0.029, None),
            (0.1, -0.3 * 0.1, None),
            (0.1, -0.031, Some(Reason::SteeringReversed)),
            (0.17, 0.0, None),
            (0.171, 0.0, Some(Reason::SteeringDiffers)),
            (0.2, 0.129, Some(Reason::SteeringDiffers)),
            (0.2, 0.131, None),
            (0.2, 0.279, None),
            (0.2, 0.281, Some(Reason::SteeringDiffers)),
            (0.31, 0.757 * 0.31 - 1e-9, Some(Reason::SteeringDiffers)),
            (0.31, 0.757 * 0.31 + 1e-9, None),
            (0.31, 1.29 * 0.31 - 1e-9, None),
            (0.31, 1.29 * 0.31 + 1e-9, Some(Reason::SteeringDiffers)),
        ] {
            let proving = Proving {
                way: WAVE_LENGTH,
                steering: SteeringFit::of(wanted, made),
                ..Proving::default()
            };
            assert_eq!(proving.contradiction(PULSE), expected, "{wanted} {made}");
        }
    }

    #[test]
    fn a_trim_that_is_far_off_is_found_once_a_wave_is_driven() {
        for bend in [-0.2, 0.0, 0.2] {
            for (trim, found) in [
                (0.0, false),
                (0.025, false),
                (-0.025, false),
                (0.09, true),
                (-0.09, true),
            ] {
                let run = |way: f64| {
                    let mut proving = Proving {
                        way,
                        ..Proving::default()
                    };
                    for number in 0..60 {
                        let steering = bend + FirstMetre::wave(0.015 * f64::from(number));
                        let turn = 0.015 * (tan(steering) + trim) / 0.25;
                        let step = Step {
                            steering,
                            turn,
                            gyro_turn: turn,
                            ..motion(0.015, 0.0)
                        };
                        proving.step(&step, 0.25, PULSE);
                    }
                    proving.found
                };
                let expected = found.then_some(Reason::SteeringDiffers);
                assert_eq!(run(WAVE_LENGTH), expected, "{bend} {trim}");
                // In a bend the plain ratio shows it before.
                let before = expected.filter(|_| bend != 0.0);
                assert_eq!(run(0.49), before, "{bend} {trim}");
            }
        }
    }

    #[test]
    fn a_wrong_yaw_of_the_body_is_found_and_one_by_a_right_angle_early() {
        for (along, across, wrong) in [
            // Both ways together are 0.15 m, and a little more.
            (0.125, 0.15 - 0.125, false),
            (0.125, 0.026, true),
            (0.125, -0.026, true),
            // 0.114 and 0.116 rad.
            (0.19, 0.19 * 0.114_5, false),
            (0.19, -0.19 * 0.114_5, false),
            (0.19, 0.19 * 0.117, true),
            (0.0, 0.04, false),
            (0.0, 0.041, true),
            (0.0, -0.041, true),
            (-0.041, 0.0, true),
            // 0.98 and 1.01 rad.
            (0.02, 0.03, false),
            (0.02, 0.032, true),
            (0.19, 0.0, false),
        ] {
            let proving = Proving {
                along,
                across,
                motor_way: along,
                ..Proving::default()
            };
            let expected = wrong.then_some(Reason::BodyYawWrong);
            assert_eq!(proving.contradiction(PULSE), expected, "{along} {across}");
        }
    }

    #[test]
    fn a_motor_that_counts_another_way_than_the_cameras_is_found() {
        for (along, motor_way, pulse, differs) in [
            (0.2, 0.0, PULSE, false),
            (0.201, 0.0, PULSE, true),
            // 0.02 m, two pulses and 15 % are 0.071 m.
            (0.3, 0.23, PULSE, false),
            (0.3, 0.228, PULSE, true),
            (0.23, 0.3, PULSE, false),
            (0.228, 0.3, PULSE, true),
            // Just as much as is allowed.
            (0.5, 0.0, 0.202_5, false),
            (0.5, 0.0, 0.202, true),
        ] {
            let proving = Proving {
                along,
                motor_way,
                ..Proving::default()
            };
            let expected = differs.then_some(Reason::MotorSpeedMismatch);
            assert_eq!(
                proving.contradiction(pulse),
                expected,
                "{along} {motor_way} {pulse}"
            );
        }
    }

    #[test]
    fn the_first_contradiction_stays() {
        let crosswise = motion(0.0, 0.05);
        let mut proving = after(&[crosswise]);
        assert_eq!(proving.found, Some(Reason::BodyYawWrong));
        for _ in 0..10 {
            proving.step(&motion(0.1, 0.0), 0.25, PULSE);
        }
        assert_eq!(proving.found, Some(Reason::BodyYawWrong));
        assert_eq!(after(&[motion(0.1, 0.0); 10]).found, None);
    }

    fn at(ms: u64) -> Time {
        Time(1_000_000_000 + ms * 1_000_000)
    }

    /// A proving run whose way is driven (m), with the turn of its steering (rad).
    fn driven(way: f64, wanted: f64, coast: Coast) -> Proving {
        Proving {
            way,
            steering: SteeringFit::of(wanted, wanted),
            coast,
            ..Proving::default()
        }
    }

    #[test]
    fn the_way_is_the_integral_of_the_speed_in_either_direction() {
        let mut proving = driven(0.1, 0.0, Coast::Ahead);
        proving.tick(at(0), 5.0, 1.4, true);
        proving.tick(at(100), -0.5, 1.4, true);
        proving.tick(at(300), 0.5, 1.4, true);
        assert!(is_near(proving.way, 0.25), "{}", proving.way);
    }

    #[test]
    fn the_car_is_left_to_roll_once_far_and_fast_enough() {
        for (way, speed, coasts) in [
            (0.7, 0.221, true),
            (0.7, 0.22, false),
            (0.7, 0.1, false),
            (0.699, 0.3, false),
        ] {
            let mut proving = driven(way, 0.0, Coast::Ahead);
            let tick = proving.tick(at(0), speed, 1.4, true);
            assert_eq!(tick.coast, coasts, "{way} {speed}");
            assert_eq!(tick.coasted, None);
        }
        let mut proving = driven(0.9, 0.0, Coast::Over);
        assert!(!proving.tick(at(0), 0.3, 1.4, true).coast);
    }

    #[test]
    fn the_roll_ends_after_half_a_second_or_at_a_low_speed() {
        let mut proving = driven(0.7, 0.0, Coast::Ahead);
        for tick in 0..50 {
            assert!(proving.tick(at(10 * tick), 0.3, 1.4, true).coast, "{tick}");
        }
        let end = proving.tick(at(500), 0.3, 1.4, true);
        assert!(!end.coast && end.coasted == Some(0.0), "{end:?}");
        assert_eq!(proving.found, Some(Reason::BrakesLessThanConfigured));
        assert_eq!(proving.tick(at(510), 0.3, 1.4, true).coasted, None);

        for (speed, rolls) in [(0.08, false), (0.081, true), (-0.3, false)] {
            let mut proving = driven(0.7, 0.0, Coast::Ahead);
            proving.tick(at(0), 0.3, 1.4, true);
            let tick = proving.tick(at(10), speed, 1.4, true);
            assert_eq!(tick.coast, rolls, "{speed}");
            assert_eq!(tick.coasted.is_none(), rolls, "{speed}");
        }
    }

    #[test]
    fn a_roll_that_loses_less_than_four_fifths_of_the_configured_braking_is_found() {
        let roll = |braking, found| {
            let mut proving = driven(0.7, 0.0, Coast::Ahead);
            proving.found = found;
            proving.tick(at(0), 0.5, braking, true);
            // 10 m/s² is the most that is measured.
            let end = proving.tick(at(10), 0.08, braking, true);
            assert_eq!(end.coasted, Some(10.0));
            proving.found
        };
        assert_eq!(roll(12.5, None), None);
        assert_eq!(roll(12.6, None), Some(Reason::BrakesLessThanConfigured));
        assert_eq!(
            roll(12.6, Some(Reason::GyroDiffers)),
            Some(Reason::GyroDiffers)
        );
    }

    #[test]
    fn the_steering_follows_a_wave_of_the_way_until_it_is_proved() {
        for (way, wanted) in [(0.062_5, 0.0), (0.062_5, 0.31), (1.062_5, 0.3)] {
            let mut proving = driven(way, wanted, Coast::Over);
            let steering = proving.tick(at(0), 0.3, 1.4, true).steering;
            let expected = 0.18 * FRAC_1_SQRT_2;
            assert!(is_near(steering, expected), "{way} {wanted}: {steering}");
        }
        for way in [1.0, 1.062_5] {
            let mut proving = driven(way, 0.31, Coast::Over);
            assert_eq!(proving.tick(at(0), 0.3, 1.4, true).steering, 0.0);
        }
    }

    #[test]
    fn a_run_passes_when_everything_has_been_compared() {
        let whole = driven(1.0, 0.31, Coast::Over);
        let passes = |mut proving: Proving, judged| proving.tick(at(0), 0.2, 1.4, judged).passed;
        assert!(passes(whole, true));
        assert!(!passes(whole, false));
        assert!(!passes(driven(0.999, 0.31, Coast::Over), true));
        assert!(!passes(driven(1.0, 0.3, Coast::Over), true));
        assert!(!passes(driven(1.0, 0.31, Coast::Ahead), true));
        let found = Proving {
            found: Some(Reason::GyroDiffers),
            ..whole
        };
        assert!(!passes(found, true));
    }
}
