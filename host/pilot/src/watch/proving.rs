//! The first metre of an unproved configuration: every sensor against every other.

use core::f64::consts::TAU;

use libm::{atan2, copysign, fabs, sin, tan};
use singletrack_control::Time;

use super::{roll_out::RollOut, steps::Step};
use crate::supervisor::Reason;

/// The highest speed until everything has been compared, m/s.
pub(crate) const PROVING_SPEED: f64 = 0.3;
/// The least way until then, m.
const METRE: f64 = 1.0;

/// Steering angles below this prove nothing, rad: trim and backlash.
const LEAST_STEERING: f64 = 0.04;
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
const WAVE: f64 = 0.18;
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
    found: Option<Reason>,
    /// Turn that the steering should have made, without its signs, and that made with it.
    wanted: f64,
    made: f64,
    /// Turn of the cameras, without its signs, and of the gyro with it.
    seen: f64,
    felt: f64,
    span: GyroSpan,
    /// Way along and to the left of the yaw.
    along: f64,
    across: f64,
    motor_way: f64,
    coast: Coast,
}

/// The turn of some steps, by the cameras and by the gyro.
#[derive(Clone, Copy, Debug, Default)]
struct GyroSpan {
    time: f64,
    turn: f64,
    gyro_turn: f64,
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
    /// What contradicts, if anything does.
    pub(crate) const fn found(&self) -> Option<Reason> {
        self.found
    }

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
        if fabs(step.steering) > LEAST_STEERING {
            let wanted = copysign(way, step.motor_way) * tan(step.steering) / wheelbase;
            self.wanted += fabs(wanted);
            self.made += copysign(1.0, wanted) * step.turn;
        }
        self.span.time += step.time;
        self.span.turn += step.turn;
        self.span.gyro_turn += step.gyro_turn;
        if self.span.time >= GYRO_SPAN {
            let span = core::mem::take(&mut self.span);
            if fabs(span.turn) > LEAST_TURN {
                self.seen += fabs(span.turn);
                self.felt += copysign(1.0, span.turn) * span.gyro_turn;
            }
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
        let angle = fabs(atan2(self.across, self.along));
        if (way > YAW_AFTER && angle > YAW_ERROR) || (way > CROSSWISE_AFTER && angle > 1.0) {
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
        if self.way < METRE || self.wanted <= PROVED_AFTER {
            tick.steering = WAVE * sin(TAU * self.way / WAVE_LENGTH);
        }
        tick.passed = self.found.is_none()
            && self.way >= METRE
            && self.wanted > PROVED_AFTER
            && start_judged
            && matches!(self.coast, Coast::Over);
        tick
    }
}
