//! A program that sends the daemon set-points along a circle, and may turn hostile.

use singletrack_control::{
    Position, Setpoint, SpeedDemand, SteeringDemand, Time, Trajectory, TrajectoryPoint, Velocity,
    direction,
};
use singletrack_core::setpoint::SetpointCommand;

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
