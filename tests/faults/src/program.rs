//! The programs beside the daemon: one that sends set-points along a circle, and may turn hostile;
//! the operator's, which holds the drive that it has armed, or gives the pulses of a jog; and a
//! learner that tells the pilot anything: what is true, its opposite, by turns, or no number.

use singletrack_control::{
    Position, Setpoint, SpeedDemand, SteeringDemand, Time, Trajectory, TrajectoryPoint, Velocity,
    direction,
};
use singletrack_core::setpoint::SetpointCommand;
use singletrack_pilot::{Jog, Learned};
use singletrack_protocol::Configuration;

use crate::{
    daemon::host_ns,
    random::{Random, Stream},
    schedule::{Fault, FaultKind, Situation},
    setting::radius,
};

/// Interval between two set-points, in µs.
const INTERVAL_US: u64 = 20_000;

/// Set-points at a time of a program that sends without a pause.
const FLOOD: u32 = 20;

/// More than any car is allowed, in m/s and rad.
const FAST: f64 = 50.0;
const LOCK: f64 = 1.5;

/// The program. It follows the daemon's drive time.
#[derive(Clone, Debug)]
pub(crate) struct Program {
    next_us: u64,
    random: Random,
    /// The velocity of a loop that wants P to move anywhere, and until when.
    anywhere: (Velocity, u64),
}

/// What the program knows of the car.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Sight {
    pub(crate) position: Position,
    pub(crate) yaw: f64,
    /// Time since the drive began, in s; `None` while the car does not drive.
    pub(crate) drive_time_s: Option<f64>,
}

impl Program {
    pub(crate) fn new(seed: u64) -> Self {
        Self {
            next_us: 0,
            random: Random::new(seed, Stream::Program),
            anywhere: (Velocity::zeros(), 0),
        }
    }

    /// The set-points that are due at `now_us`, as the fault of the program has them.
    pub(crate) fn poll(
        &mut self,
        now_us: u64,
        situation: &Situation,
        sight: Sight,
        fault: Option<Fault>,
    ) -> Vec<SetpointCommand> {
        if now_us < self.next_us {
            return Vec::new();
        }
        self.next_us = now_us + INTERVAL_US;
        let now = Time(host_ns(now_us));
        let speed = f64::from(situation.speed_mm_s) * 1e-3;
        let radius = radius(speed);
        let angle = sight.drive_time_s.unwrap_or(0.0) * speed / radius;
        let (sin, cos) = (libm::sin(angle), libm::cos(angle));
        let position = Some(Position::new(radius * cos, radius * sin));
        let velocity = Velocity::new(-speed * sin, speed * cos);
        let good = |time| Setpoint::point(time, position, velocity);
        let Some(fault) = fault else {
            return vec![SetpointCommand::Setpoint(good(now))];
        };
        let severity = u64::from(fault.severity);
        let away = libm::atan2(sight.position.y, sight.position.x);
        let one = |setpoint| vec![SetpointCommand::Setpoint(setpoint)];
        match fault.kind {
            FaultKind::SetpointsGone => Vec::new(),
            FaultKind::SetpointsNotANumber => {
                one(Setpoint::point(now, None, Velocity::new(f64::NAN, 0.0)))
            }
            FaultKind::SetpointsOld => one(good(Time(now.0.saturating_sub(severity * 1_000_000)))),
            FaultKind::SetpointsFuture => {
                one(good(Time(now.0.saturating_add(severity * 1_000_000_000))))
            }
            FaultKind::SetpointsAtFullLock => {
                let side = if (now_us / 1_000 / severity).is_multiple_of(2) {
                    LOCK
                } else {
                    -LOCK
                };
                one(Setpoint::actuation(
                    now,
                    SteeringDemand::Angle(side),
                    SpeedDemand::Speed(FAST),
                ))
            }
            FaultKind::SetpointsOutward => one(Setpoint::actuation(
                now,
                SteeringDemand::Angle(0.0),
                SpeedDemand::Acceleration(FAST),
            )),
            FaultKind::SetpointsTrajectory => {
                let way = |seconds: f64| sight.position + FAST * 0.2 * seconds * direction(away);
                let points = (0..40)
                    .map(|index| {
                        let seconds = 0.05 * f64::from(index);
                        TrajectoryPoint {
                            time: now.after(seconds),
                            position: way(seconds),
                            velocity: FAST * direction(away),
                        }
                    })
                    .collect();
                let stamp = good(now).stamp;
                vec![SetpointCommand::Trajectory(Box::new(Trajectory {
                    stamp,
                    points,
                }))]
            }
            kind if kind.is_hostile_loop() => {
                let velocity = self.hostile_loop(now_us, kind, severity, sight);
                one(Setpoint::point(now, None, velocity))
            }
            _ => {
                // Without a pause.
                self.next_us = now_us;
                (0..FLOOD)
                    .map(|_| SetpointCommand::Setpoint(self.any(now)))
                    .collect()
            }
        }
    }

    /// The velocity of P that a hostile outer loop wants, in m/s.
    fn hostile_loop(
        &mut self,
        now_us: u64,
        kind: FaultKind,
        severity: u64,
        sight: Sight,
    ) -> Velocity {
        let Position { coords, .. } = sight.position;
        // The geofence is a square around the origin.
        let outward = if coords.x.abs() > coords.y.abs() {
            Velocity::new(coords.x.signum(), 0.0)
        } else {
            Velocity::new(0.0, coords.y.signum())
        };
        let turn = now_us / 1_000 / severity;
        let wanted = match kind {
            FaultKind::LoopBangBang => {
                let side = if turn.is_multiple_of(2) { 1.2 } else { -1.2 };
                direction(sight.yaw + side)
            }
            FaultKind::LoopFeint if !turn.is_multiple_of(4) => {
                // The way that the car already goes.
                let along = Velocity::new(-outward.y, outward.x);
                along * along.dot(&direction(sight.yaw)).signum()
            }
            FaultKind::LoopRandom => {
                let (velocity, until_us) = self.anywhere;
                if now_us < until_us {
                    return velocity;
                }
                let angle = f64::from(self.random.between(0, 6_283)) * 1e-3;
                let speed = f64::from(self.random.between(0, 3_000)) * 1e-3;
                self.anywhere = (speed * direction(angle), now_us + severity * 1_000);
                return self.anywhere.0;
            }
            _ => outward,
        };
        FAST * wanted
    }

    /// Any set-point at all.
    fn any(&mut self, now: Time) -> Setpoint {
        let random = &mut self.random;
        let mut value = || match random.between(0, 9) {
            0 => f64::NAN,
            1 => f64::INFINITY,
            2 => -1e300,
            _ => f64::from(random.signed(-2_000, 2_000)) * 1e-3,
        };
        let (a, b, c, d) = (value(), value(), value(), value());
        let time = match random.between(0, 9) {
            0 => Time(now.0.saturating_add(u64::from(random.between(1, u32::MAX)))),
            1 => Time(u64::MAX),
            2 => Time(now.0.saturating_sub(u64::from(random.between(1, u32::MAX)))),
            _ => now,
        };
        match random.between(0, 3) {
            0 => Setpoint::point(time, None, Velocity::new(a, b)),
            1 => Setpoint::point(time, Some(Position::new(a, b)), Velocity::new(c, d)),
            2 => Setpoint::actuation(time, SteeringDemand::Angle(a), SpeedDemand::Speed(b)),
            _ => Setpoint::actuation(time, SteeringDemand::Rate(a), SpeedDemand::Acceleration(b)),
        }
    }
}

/// Intervals of the renewals, in µs: as `singletrack` sends them.
const HOLD_US: u64 = 100_000;
const JOG_US: u64 = 50_000;

/// Half a period of throttle and steering by turns, in µs.
const TAP_US: u64 = 500_000;

/// Pulse of the throttle beyond the configured deadband, and steering beside the centre, in µs.
const THROTTLE_US: u16 = 25;
const STEERING_US: u16 = 150;

/// What the program attends to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Attends {
    /// A drive.
    Drive,
    /// Jogging, with throttle and steering by turns.
    Taps,
    /// Jogging, with the throttle held.
    Throttle,
}

/// What the program sends.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Renewal {
    Hold,
    Jog(Jog),
}

/// When the daemon was last sent a renewal, in µs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Renewed {
    /// A request of any kind: each renews a held drive.
    pub(crate) drive_us: Option<u64>,
    /// Pulses, which alone renew a jog.
    pub(crate) jog_us: Option<u64>,
}

/// The operator's program.
#[derive(Debug)]
pub(crate) struct Operator {
    random: Random,
    attends: Option<Attends>,
    since_us: u64,
    sent_us: u64,
    renewed: Renewed,
}

impl Operator {
    pub(crate) fn new(seed: u64) -> Self {
        Self {
            random: Random::new(seed, Stream::Operator),
            attends: None,
            since_us: 0,
            sent_us: 0,
            renewed: Renewed::default(),
        }
    }

    pub(crate) const fn renewed(&self) -> Renewed {
        self.renewed
    }

    /// The program has asked to arm, and renews what it has asked for from now on.
    pub(crate) const fn attend(&mut self, now_us: u64, attends: Attends) {
        self.attends = Some(attends);
        self.since_us = now_us;
        self.sent_us = now_us;
        self.renewed.drive_us = Some(now_us);
    }

    /// The program has ended the drive, or its connection is lost.
    pub(crate) const fn leave(&mut self) {
        self.attends = None;
    }

    /// Another client has renewed the drive.
    pub(crate) const fn was_renewed(&mut self, now_us: u64) {
        self.renewed.drive_us = Some(now_us);
    }

    /// What the program sends now.
    pub(crate) fn poll(
        &mut self,
        now_us: u64,
        faults: &[Fault],
        board: &Configuration,
    ) -> Option<Renewal> {
        let attends = self.attends?;
        let is_active = |kind| faults.iter().any(|fault| fault.kind == kind);
        let interval_us = match attends {
            Attends::Drive => HOLD_US,
            Attends::Taps | Attends::Throttle => JOG_US,
        };
        if is_active(FaultKind::OperatorHangs) || now_us < self.sent_us + interval_us {
            return None;
        }
        self.sent_us = now_us;
        self.renewed.drive_us = Some(now_us);
        if attends == Attends::Drive {
            return Some(Renewal::Hold);
        }
        self.renewed.jog_us = Some(now_us);
        if is_active(FaultKind::JogWild) {
            let mut any = || self.random.between(0, u16::MAX.into()) as u16;
            return Some(Renewal::Jog(Jog {
                servo_us: any(),
                esc_us: any(),
            }));
        }
        let half = (now_us - self.since_us) / TAP_US;
        let drives = attends == Attends::Throttle || half.is_multiple_of(2);
        let (servo, esc) = (&board.servo, &board.esc);
        let beside = if (half / 2).is_multiple_of(2) { -1 } else { 1 } * STEERING_US.cast_signed();
        Some(Renewal::Jog(Jog {
            servo_us: servo.centre_us.saturating_add_signed(beside),
            esc_us: esc.neutral_us + u16::from(drives) * (esc.deadband_us + THROTTLE_US),
        }))
    }
}

/// What it says in this second of a schedule with this seed; `None` if it is silent.
pub(crate) fn learned(seed: u64, second: u64) -> Option<Learned> {
    let kind = seed / 3 % 5;
    // A pattern of signs, one for each schedule.
    let signs = seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 58;
    let sign = |bit: u64| if signs >> bit & 1 == 0 { 1.0 } else { -1.0 };
    let factor = match kind {
        0 => 1.0,
        1 => 0.3,
        2 if second.is_multiple_of(2) => 1e9,
        2 => -1e9,
        3 if second.is_multiple_of(3) => f64::NAN,
        3 => f64::INFINITY,
        _ if second.is_multiple_of(4) => return None,
        _ => -1.0,
    };
    let most = Learned::MOST;
    Some(Learned {
        steering_gain: sign(0) * factor * most.steering_gain,
        steering_trim: sign(1) * factor * most.steering_trim,
        stamp_offset: sign(2) * factor * most.stamp_offset,
        body_yaw: sign(3) * factor * most.body_yaw,
        pivot_forward: sign(4) * factor * most.pivot_forward,
        pivot_left: sign(5) * factor * most.pivot_left,
    })
}
