//! The first metre of an unproved configuration: every sensor against every other.

use libm::{atan2, copysign, fabs, tan};
use singletrack_control::Time;

use super::steps::Step;
use crate::supervisor::Reason;

/// The highest speed of the first metre, m/s.
pub(crate) const PROVING_SPEED: f64 = 0.3;
/// The way for which it holds, m.
const METRE: f64 = 1.0;

/// Steering angles below this prove nothing, rad: trim and backlash.
const LEAST_STEERING: f64 = 0.04;
/// A step must turn by this much to count for the gyro, rad: the noise of the cameras' yaw.
const LEAST_TURN: f64 = 0.006;
/// The turn that the steering should have made by which a reversed servo shows, rad.
const SIGN_AFTER: f64 = 0.12;
/// The turn by which a servo with a wrong gain shows, rad.
const SIZE_AFTER: f64 = 0.35;
/// The turn by which the steering is proved, rad.
const PROVED_AFTER: f64 = 0.5;
/// Turn per turn that the steering should have made.
const STEERING_RATIO: (f64, f64) = (0.6, 1.6);
/// Turn of the gyro per turn of the cameras.
const GYRO_RATIO: (f64, f64) = (0.75, 1.3);
/// The way after which a wrong yaw of the body shows, m.
const YAW_AFTER: f64 = 0.15;
/// The largest angle between the motion of the rear axle and the yaw, rad.
const YAW_ERROR: f64 = 0.115;
/// The change of speed by which the accelerometer is judged, m/s; if it does not come in
/// time, a lower one will do...
const ACCELERATED: f64 = 0.18;
const JUDGED_FROM: f64 = 0.08;
/// ...its tolerance, in m/s and as a share...
const ACCELERATION_TOLERANCE: (f64, f64) = (0.05, 0.5);
/// ...and that time, s: later the bias counts for more.
const ACCELERATES_WITHIN: f64 = 1.2;
/// The way by which the motor and the cameras are compared, m...
const MOTOR_AFTER: f64 = 0.2;
/// ...and how much they may differ: in m, beyond the two pulses that a speed takes, and as
/// a share.
const MOTOR_TOLERANCE: (f64, f64) = (0.02, 0.2);

/// The way at which the car is left to roll, m, for how long at most, s, and the lowest
/// speed at which that says anything, m/s.
const COAST_AT: f64 = 0.7;
const COAST_FOR: f64 = 0.25;
const COAST_FROM: f64 = 0.22;
/// When the deceleration of the roll begins to be measured, s.
const COAST_MEASURED_AFTER: f64 = 0.08;
/// A roll that loses less than this share of the configured deceleration is too weak.
const COAST_SHARE: f64 = 0.7;

/// What the proving run asks of the next command, and what it found.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct ProvingTick {
    /// The car is to roll at neutral.
    pub(crate) coast: bool,
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
    found: Option<Reason>,
    /// Turn that the steering should have made, without its signs, and that made with it.
    wanted: f64,
    made: f64,
    /// Turn of the cameras, without its signs, and of the gyro with it.
    seen: f64,
    felt: f64,
    /// Way along and to the left of the yaw.
    along: f64,
    across: f64,
    motor_way: f64,
    start: Start,
    coast: Coast,
}

/// The comparison of the accelerometer with the speed, while the car starts off.
#[derive(Clone, Copy, Debug, Default)]
struct Start {
    time: f64,
    forward: f64,
    left: f64,
    judged: bool,
}

/// The roll at neutral.
#[derive(Clone, Copy, Debug, Default)]
enum Coast {
    #[default]
    Ahead,
    Begun {
        since: Time,
        /// Time and speed when the measurement began.
        from: Option<(Time, f64)>,
    },
    Over,
}

impl Proving {
    /// What contradicts, if anything does.
    pub(crate) const fn found(&self) -> Option<Reason> {
        self.found
    }

    /// Whether the speed is still limited.
    pub(crate) fn is_slow(&self) -> bool {
        self.way < METRE
    }

    /// A step of the drive; wheelbase and way of a motor pulse in m.
    pub(crate) fn step(&mut self, step: &Step, wheelbase: f64, pulse_distance: f64) {
        if self.found.is_some() {
            return;
        }
        self.compare_acceleration(step);
        let along = step.along();
        // A body whose yaw is wrong by more than a right angle moves backward.
        let way = step.rear.norm();
        if way > 0.002 {
            self.along += along;
            self.across += step.across();
            self.motor_way += step.motor_way;
        }
        if fabs(step.steering) > LEAST_STEERING {
            let wanted = copysign(way, step.motor_way) * tan(step.steering) / wheelbase;
            self.wanted += fabs(wanted);
            self.made += copysign(1.0, wanted) * step.turn;
        }
        if fabs(step.turn) > LEAST_TURN {
            self.seen += fabs(step.turn);
            self.felt += copysign(1.0, step.turn) * step.gyro_turn;
        }
        self.found = self.found.or(self.contradiction(pulse_distance));
    }

    fn contradiction(&self, pulse_distance: f64) -> Option<Reason> {
        let outside = |part: f64, of: f64, (low, high): (f64, f64)| {
            let ratio = part / of;
            // A NaN is outside.
            !(low <= ratio && ratio <= high)
        };
        // Gyro and cameras first: what they agree on is the turn of the car.
        let differs = self.seen > SIZE_AFTER && outside(self.felt, self.seen, GYRO_RATIO);
        let opposite = self.seen > SIGN_AFTER && self.felt < 0.3 * self.seen;
        if differs || opposite {
            return Some(Reason::GyroDiffers);
        }
        if self.wanted > SIGN_AFTER && self.made < -0.3 * self.wanted {
            return Some(Reason::SteeringReversed);
        }
        let way = fabs(self.along) + fabs(self.across);
        if way > YAW_AFTER && fabs(atan2(self.across, self.along)) > YAW_ERROR {
            return Some(Reason::BodyYawWrong);
        }
        if self.wanted > SIZE_AFTER && outside(self.made, self.wanted, STEERING_RATIO) {
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

    fn compare_acceleration(&mut self, step: &Step) {
        let start = &mut self.start;
        if start.judged {
            return;
        }
        let speed = step.rear.norm() / step.time;
        start.time += step.time;
        start.forward += step.forward;
        start.left += step.left;
        let late = start.time > ACCELERATES_WITHIN;
        if late || speed >= ACCELERATED {
            start.judged = true;
            if speed < JUDGED_FROM {
                return;
            }
            let (margin, share) = ACCELERATION_TOLERANCE;
            // Over a step the speed is that of its middle; the integral is that of its end.
            let middle = start.forward - 0.5 * step.forward;
            let off = libm::hypot(middle - speed, start.left - 0.5 * step.left);
            if off > margin + share * speed {
                self.found = Some(Reason::AccelerometerDiffers);
            }
        }
    }

    /// A tick of the drive with the estimated speed (m/s) and the configured deceleration
    /// (m/s²).
    pub(crate) fn tick(&mut self, now: Time, speed: f64, braking: f64) -> ProvingTick {
        let elapsed = self.last.replace(now).map(|last| now.seconds_since(last));
        self.way += fabs(speed) * elapsed.unwrap_or(0.0);
        let mut tick = ProvingTick::default();
        match &mut self.coast {
            Coast::Ahead if self.way >= COAST_AT && speed > COAST_FROM => {
                self.coast = Coast::Begun {
                    since: now,
                    from: None,
                };
                tick.coast = true;
            }
            Coast::Begun { since, from } => {
                let rolled = now.seconds_since(*since);
                if rolled >= COAST_MEASURED_AFTER && from.is_none() {
                    *from = Some((now, speed));
                }
                tick.coast = rolled < COAST_FOR && speed > 0.1;
                if !tick.coast {
                    if let Some((begin, first)) = *from
                        && now.seconds_since(begin) >= 0.03
                    {
                        let measured = (first - speed) / now.seconds_since(begin);
                        tick.coasted = Some(measured.max(0.0));
                        if measured < COAST_SHARE * braking && self.found.is_none() {
                            self.found = Some(Reason::BrakesLessThanConfigured);
                        }
                    }
                    self.coast = Coast::Over;
                }
            }
            Coast::Ahead | Coast::Over => {}
        }
        tick.passed = self.found.is_none()
            && !self.is_slow()
            && self.wanted > PROVED_AFTER
            && self.start.judged
            && !matches!(self.coast, Coast::Begun { .. });
        tick
    }
}
