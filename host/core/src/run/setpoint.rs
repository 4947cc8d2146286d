//! Set-points of a program: the keys of the control socket, and the checks of their values.

use singletrack_api::{Code, Refused, Setpoint};
use singletrack_control::{
    self as control, Demand, MAX_TRAJECTORY_POINTS, Position, ReferencePoint, SetpointError,
    SetpointStamp, SpeedDemand, SteeringDemand, Time, Trajectory, TrajectoryPoint, Velocity,
};

/// A set-point of a program.
#[derive(Clone, Debug, PartialEq)]
pub enum SetpointCommand {
    /// A velocity of P, or steering and speed.
    Setpoint(control::Setpoint),
    /// Points in time.
    Trajectory(Box<Trajectory>),
}

impl SetpointCommand {
    /// The set-point with these keys that was received at `now`.
    ///
    /// # Errors
    ///
    /// The keys are no set-point, or a value of them is that of no car.
    pub fn of(keys: Setpoint, now: Time) -> Result<Self, Refused> {
        let stamp = SetpointStamp {
            time: keys.time_ns.map_or(now, Time),
            sequence: keys.sequence,
        };
        let command = command(keys, stamp)?;
        command.check(now, f64::INFINITY).map_err(|error| {
            let now = now.0;
            let text = match (error, &command) {
                (SetpointError::Future, _) if stamp.time.0 > now => format!(
                    "time_ns is {}: CLOCK_MONOTONIC of this computer says {now}",
                    stamp.time.0
                ),
                (SetpointError::Future, _) => {
                    format!("the trajectory begins more than a second after now, which is {now}")
                }
                (SetpointError::Old, SetpointCommand::Trajectory(_)) => {
                    format!("the trajectory ends before now, which is {now}")
                }
                _ => error.to_string(),
            };
            Refused::new(code(error), text)
        })?;
        Ok(command)
    }

    /// Whether the pilot would obey it at `now`, not older than `timeout` (s).
    ///
    /// # Errors
    ///
    /// A value is that of no car, or its time is not the present.
    pub fn check(&self, now: Time, timeout: f64) -> Result<(), SetpointError> {
        match self {
            Self::Setpoint(setpoint) => setpoint.check(now, timeout),
            Self::Trajectory(trajectory) => trajectory.check(now, timeout),
        }
    }

    /// When it was decided, and its number.
    pub const fn stamp(&self) -> SetpointStamp {
        match self {
            Self::Setpoint(setpoint) => setpoint.stamp,
            Self::Trajectory(trajectory) => trajectory.stamp,
        }
    }
}

/// The word for an error of a set-point's values.
pub const fn code(error: SetpointError) -> Code {
    match error {
        SetpointError::NotFinite => Code::NotFinite,
        SetpointError::OutOfRange(_) | SetpointError::Incomplete => Code::OutOfRange,
        SetpointError::Future => Code::Future,
        SetpointError::Old | SetpointError::Superseded => Code::Old,
    }
}

fn command(keys: Setpoint, stamp: SetpointStamp) -> Result<SetpointCommand, Refused> {
    let needs = |what: &str| Refused::new(Code::Invalid, format_args!("setpoint needs {what}"));
    let acts = keys.steering_rad.is_some()
        || keys.steering_rate_rad_s.is_some()
        || keys.speed_m_s.is_some()
        || keys.rear_speed_m_s.is_some()
        || keys.acceleration_m_s2.is_some();
    let points = keys.velocity_m_s.is_some() || keys.position_m.is_some();
    let demand = match (points, acts, keys.trajectory) {
        (false, false, Some(points)) => {
            if points.len() > MAX_TRAJECTORY_POINTS {
                let text = format!("a trajectory has at most {MAX_TRAJECTORY_POINTS} points");
                return Err(Refused::new(Code::OutOfRange, text));
            }
            let points = points.iter().map(point).collect();
            let trajectory = Trajectory { stamp, points };
            return Ok(SetpointCommand::Trajectory(Box::new(trajectory)));
        }
        (true, false, None) => Demand::Point(ReferencePoint {
            position: keys.position_m.map(Position::from),
            velocity: keys.velocity_m_s.map(Velocity::from).ok_or_else(|| {
                let text = "position_m needs velocity_m_s, such as [0.0,0.0]";
                Refused::new(Code::Invalid, text)
            })?,
        }),
        (false, true, None) => Demand::Actuation {
            steering: match (keys.steering_rad, keys.steering_rate_rad_s) {
                (Some(angle), None) => SteeringDemand::Angle(angle),
                (Some(angle), Some(rate)) => SteeringDemand::AngleWithin { angle, rate },
                (None, Some(rate)) => SteeringDemand::Rate(rate),
                (None, None) => return Err(needs("steering_rad or steering_rate_rad_s")),
            },
            speed: match (keys.speed_m_s, keys.rear_speed_m_s, keys.acceleration_m_s2) {
                (Some(speed), None, None) => SpeedDemand::Speed(speed),
                (None, Some(speed), None) => SpeedDemand::RearSpeed(speed),
                (None, None, Some(acceleration)) => SpeedDemand::Acceleration(acceleration),
                _ => {
                    return Err(needs(
                        "one of speed_m_s, rear_speed_m_s and acceleration_m_s2",
                    ));
                }
            },
        },
        _ => {
            let one =
                "velocity_m_s, such as [0.4,0.0]; or steering_rad and speed_m_s; or trajectory";
            return Err(needs(one));
        }
    };
    let setpoint = control::Setpoint { stamp, demand };
    Ok(SetpointCommand::Setpoint(setpoint))
}

fn point(point: &singletrack_api::TrajectoryPoint) -> TrajectoryPoint {
    TrajectoryPoint {
        time: Time(point.time_ns),
        position: Position::from(point.position_m),
        velocity: Velocity::from(point.velocity_m_s),
    }
}
