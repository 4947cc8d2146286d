//! The keys of a set-point, and the checks of their values.

use serde::Deserialize;
use singletrack_control::{
    Demand, MAX_TRAJECTORY_POINTS, Position, ReferencePoint, Setpoint, SetpointError,
    SetpointStamp, SpeedDemand, SteeringDemand, Time, Trajectory, TrajectoryPoint, Velocity,
};

use super::{
    SetpointCommand,
    rejection::{Rejected, Rejection},
};

/// The keys of a set-point.
#[derive(Debug, Default)]
pub(in crate::socket) struct SetpointKeys {
    pub(in crate::socket) velocity_m_s: Option<[f64; 2]>,
    pub(in crate::socket) position_m: Option<[f64; 2]>,
    pub(in crate::socket) steering_rad: Option<f64>,
    pub(in crate::socket) steering_rate_rad_s: Option<f64>,
    pub(in crate::socket) speed_m_s: Option<f64>,
    pub(in crate::socket) acceleration_m_s2: Option<f64>,
    pub(in crate::socket) trajectory: Option<Vec<PointKeys>>,
    pub(in crate::socket) time_ns: Option<u64>,
    pub(in crate::socket) sequence: Option<u32>,
}

/// A point of a trajectory, as a client writes it.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(in crate::socket) struct PointKeys {
    time_ns: u64,
    position_m: [f64; 2],
    velocity_m_s: [f64; 2],
}

impl SetpointKeys {
    /// The set-point of a line that was read at `now_ns`.
    pub(in crate::socket) fn parse(self, now_ns: u64) -> Result<SetpointCommand, Rejected> {
        let now = Time(now_ns);
        let stamp = SetpointStamp {
            time: self.time_ns.map_or(now, Time),
            sequence: self.sequence,
        };
        let command = self.command(stamp)?;
        let checked = match &command {
            SetpointCommand::Setpoint(setpoint) => setpoint.check(now, f64::INFINITY),
            SetpointCommand::Trajectory(trajectory) => trajectory.check(now, f64::INFINITY),
        };
        checked.map_err(|error| {
            let why = error.into();
            match (error, &command) {
                (SetpointError::Future, _) if stamp.time > now => Rejected::new(
                    why,
                    format_args!(
                        "time_ns is {}: CLOCK_MONOTONIC of this computer says {now_ns}",
                        stamp.time.0
                    ),
                ),
                (SetpointError::Future, _) => Rejected::new(
                    why,
                    format_args!(
                        "the trajectory begins more than a second after now, which is {now_ns}"
                    ),
                ),
                (SetpointError::Old, SetpointCommand::Trajectory(_)) => Rejected::new(
                    why,
                    format_args!("the trajectory ends before now, which is {now_ns}"),
                ),
                _ => Rejected::new(why, error),
            }
        })?;
        Ok(command)
    }

    fn command(self, stamp: SetpointStamp) -> Result<SetpointCommand, Rejected> {
        let invalid = |text: &str| Rejected::new(Rejection::Invalid, text);
        let acts = self.steering_rad.is_some()
            || self.steering_rate_rad_s.is_some()
            || self.speed_m_s.is_some()
            || self.acceleration_m_s2.is_some();
        let points = self.velocity_m_s.is_some() || self.position_m.is_some();
        let demand = match (points, acts, self.trajectory) {
            (false, false, Some(points)) => {
                if points.len() > MAX_TRAJECTORY_POINTS {
                    return Err(Rejected::new(
                        Rejection::OutOfRange,
                        format_args!("a trajectory has at most {MAX_TRAJECTORY_POINTS} points"),
                    ));
                }
                let points = points.iter().map(PointKeys::point).collect();
                let trajectory = Trajectory { stamp, points };
                return Ok(SetpointCommand::Trajectory(Box::new(trajectory)));
            }
            (true, false, None) => Demand::Point(ReferencePoint {
                position: self.position_m.map(|[x, y]| Position::new(x, y)),
                velocity: self
                    .velocity_m_s
                    .map(|[x, y]| Velocity::new(x, y))
                    .ok_or_else(|| invalid("position_m needs velocity_m_s, such as [0.0,0.0]"))?,
            }),
            (false, true, None) => Demand::Actuation {
                steering: match (self.steering_rad, self.steering_rate_rad_s) {
                    (Some(angle), None) => SteeringDemand::Angle(angle),
                    (None, Some(rate)) => SteeringDemand::Rate(rate),
                    _ => {
                        return Err(invalid(
                            "setpoint needs steering_rad or steering_rate_rad_s",
                        ));
                    }
                },
                speed: match (self.speed_m_s, self.acceleration_m_s2) {
                    (Some(speed), None) => SpeedDemand::Speed(speed),
                    (None, Some(acceleration)) => SpeedDemand::Acceleration(acceleration),
                    _ => return Err(invalid("setpoint needs speed_m_s or acceleration_m_s2")),
                },
            },
            _ => {
                return Err(invalid(
                    "setpoint needs velocity_m_s, such as [0.4,0.0]; or steering_rad and \
                     speed_m_s; or trajectory",
                ));
            }
        };
        Ok(SetpointCommand::Setpoint(Setpoint { stamp, demand }))
    }
}

impl PointKeys {
    const fn point(&self) -> TrajectoryPoint {
        let ([x, y], [v_x, v_y]) = (self.position_m, self.velocity_m_s);
        TrajectoryPoint {
            time: Time(self.time_ns),
            position: Position::new(x, y),
            velocity: Velocity::new(v_x, v_y),
        }
    }
}
