//! Set-points of a controller outside: what it wants, and when it decided so.
//!
//! They come from another program, so nothing about them is taken on trust. The checks are
//! here, and both ends use them: the socket, to answer the program, and the reference
//! ([`crate::External`]), which refuses by itself what must not be obeyed.

use heapless::Vec;
use libm::{cos, fabs};

use crate::{Position, ReferencePoint, Time, Velocity};

/// The largest number of points of a trajectory.
pub const MAX_TRAJECTORY_POINTS: usize = 100;

/// The largest values of a set-point. Beyond them it is a mistake for any car; the limits of
/// the car are applied to the rest.
const MAX_COORDINATE: f64 = 10_000.0;
const MAX_STEERING: f64 = core::f64::consts::FRAC_PI_2;
/// The largest velocity (m/s), acceleration (m/s²) and steering rate (rad/s).
const MAX_RATE: f64 = 100.0;

/// The longest time until a trajectory begins, s.
const MAX_START: f64 = 1.0;

/// Where a set-point comes from in time.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SetpointStamp {
    /// When it was decided. Its age counts from here.
    pub time: Time,
    /// The sender's number for it, if it numbers them.
    pub sequence: Option<u32>,
}

/// A set-point from outside.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Setpoint {
    /// When it was decided, and its number.
    pub stamp: SetpointStamp,
    /// What the controller outside wants.
    pub demand: Demand,
}

/// What a controller outside wants of the car.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Demand {
    /// A velocity of P, with a position for the outer loop or without; the law steers.
    Point(ReferencePoint),
    /// Steering and speed, in place of the law.
    Actuation {
        /// The steering.
        steering: SteeringDemand,
        /// The speed.
        speed: SpeedDemand,
    },
}

/// Steering that a controller outside wants; positive to the left.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum SteeringDemand {
    /// Steering angle, in rad.
    Angle(f64),
    /// Steering angle, in rad, approached at no more than a rate.
    AngleWithin {
        /// Steering angle, in rad.
        angle: f64,
        /// Largest steering rate to either side, in rad/s; its sign has no meaning.
        rate: f64,
    },
    /// Steering rate, in rad/s.
    Rate(f64),
}

/// Speed that a controller outside wants.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum SpeedDemand {
    /// Speed of the centre of mass, in m/s; negative in reverse.
    Speed(f64),
    /// Speed of the rear axle, in m/s; negative in reverse.
    RearSpeed(f64),
    /// Change of the commanded speed, in m/s².
    Acceleration(f64),
}

/// A point of a trajectory.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TrajectoryPoint {
    /// When P should be there.
    pub time: Time,
    /// Position of P, in m.
    pub position: Position,
    /// Velocity of P, in m/s.
    pub velocity: Velocity,
}

/// Points that P should pass in time, between them a cubic curve with their velocities.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Trajectory {
    /// When it was decided, and its number.
    pub stamp: SetpointStamp,
    /// At least two points, in order of time.
    pub points: Vec<TrajectoryPoint, MAX_TRAJECTORY_POINTS>,
}

/// One point of a trajectory on its way to the pilot: a whole one would not fit into an event.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TrajectoryPiece {
    /// The stamp of the trajectory, the same in every piece.
    pub stamp: SetpointStamp,
    /// The place of the point, from 0.
    pub index: u8,
    /// The number of points.
    pub count: u8,
    /// The point.
    pub point: TrajectoryPoint,
}

/// Why a set-point is not obeyed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum SetpointError {
    /// A value is infinite or not a number.
    #[error("a value is not finite")]
    NotFinite,
    /// A value is beyond that of any car, or a trajectory is not one.
    #[error("{0}")]
    OutOfRange(&'static str),
    /// It was decided later than now.
    #[error("it was decided in the future")]
    Future,
    /// It was decided too long ago, or its last point is over.
    #[error("it is too old")]
    Old,
    /// A later one is in force.
    #[error("a later one is in force")]
    Superseded,
    /// Points of the trajectory are missing.
    #[error("points of the trajectory are missing")]
    Incomplete,
}

impl SetpointStamp {
    /// A decision at `time` without a number.
    pub const fn at(time: Time) -> Self {
        Self {
            time,
            sequence: None,
        }
    }

    /// Checks that a set-point with this stamp may be obeyed at `now` for it is neither from the
    /// future nor older than `timeout` seconds.
    ///
    /// # Errors
    ///
    /// [`SetpointError::Future`] or [`SetpointError::Old`].
    pub fn check(&self, now: Time, timeout: f64) -> Result<(), SetpointError> {
        if self.time > now {
            Err(SetpointError::Future)
        } else if now.seconds_since(self.time) > timeout {
            Err(SetpointError::Old)
        } else {
            Ok(())
        }
    }
}

impl SpeedDemand {
    /// The demand as one of the centre of mass, which has this sideslip (rad): its velocity and that of
    /// the rear axle have one forward component.
    #[must_use]
    pub fn of_centre(self, sideslip: f64) -> Self {
        match self {
            Self::RearSpeed(speed) => Self::Speed(speed / cos(sideslip)),
            Self::Speed(_) | Self::Acceleration(_) => self,
        }
    }
}

impl Demand {
    /// Checks the values.
    ///
    /// # Errors
    ///
    /// [`SetpointError::NotFinite`] or [`SetpointError::OutOfRange`].
    pub fn check(&self) -> Result<(), SetpointError> {
        match *self {
            Self::Point(ReferencePoint { position, velocity }) => {
                position.map_or(Ok(()), |position| check_position(&position))?;
                check_velocity(&velocity)
            }
            Self::Actuation { steering, speed } => {
                let (angle, rate) = match steering {
                    SteeringDemand::Angle(angle) => (angle, 0.0),
                    SteeringDemand::AngleWithin { angle, rate } => (angle, rate),
                    SteeringDemand::Rate(rate) => (0.0, rate),
                };
                let (value, text) = match speed {
                    SpeedDemand::Speed(it) => (it, "speed_m_s must lie between -100 and 100"),
                    SpeedDemand::RearSpeed(it) => {
                        (it, "rear_speed_m_s must lie between -100 and 100")
                    }
                    SpeedDemand::Acceleration(it) => {
                        (it, "acceleration_m_s2 must lie between -100 and 100")
                    }
                };
                let of_angle = "steering_rad must lie between -pi/2 and pi/2";
                let of_rate = "steering_rate_rad_s must lie between -100 and 100";
                within(&[angle], MAX_STEERING, of_angle)?;
                within(&[rate], MAX_RATE, of_rate)?;
                within(&[value], MAX_RATE, text)
            }
        }
    }
}

impl Setpoint {
    /// A velocity of P, with a position or without, decided at `time`.
    pub const fn point(time: Time, position: Option<Position>, velocity: Velocity) -> Self {
        Self {
            stamp: SetpointStamp::at(time),
            demand: Demand::Point(ReferencePoint { position, velocity }),
        }
    }

    /// Steering and speed, decided at `time`.
    pub const fn actuation(time: Time, steering: SteeringDemand, speed: SpeedDemand) -> Self {
        Self {
            stamp: SetpointStamp::at(time),
            demand: Demand::Actuation { steering, speed },
        }
    }

    /// Checks that it may be obeyed at `now`, when one is valid for `timeout` seconds.
    ///
    /// # Errors
    ///
    /// The reason against it.
    pub fn check(&self, now: Time, timeout: f64) -> Result<(), SetpointError> {
        self.demand.check()?;
        self.stamp.check(now, timeout)
    }
}

impl Trajectory {
    /// Checks that it may be obeyed at `now`, when one is valid for `timeout` seconds.
    ///
    /// # Errors
    ///
    /// The reason against it.
    pub fn check(&self, now: Time, timeout: f64) -> Result<(), SetpointError> {
        const TOO_FEW: SetpointError =
            SetpointError::OutOfRange("a trajectory has at least two points");
        let (Some(first), Some(last)) = (self.points.first(), self.points.last()) else {
            return Err(TOO_FEW);
        };
        if self.points.len() < 2 {
            return Err(TOO_FEW);
        }
        for point in &self.points {
            check_position(&point.position)?;
            check_velocity(&point.velocity)?;
        }
        for (point, next) in self.points.iter().zip(self.points.iter().skip(1)) {
            let time = next.time.seconds_since(point.time);
            if time <= 0.0 {
                return Err(SetpointError::OutOfRange(
                    "the points of a trajectory must be in order of time",
                ));
            }
            if (next.position - point.position).norm() > MAX_RATE * time {
                return Err(SetpointError::OutOfRange(
                    "two points of a trajectory are more than 100 m/s apart",
                ));
            }
        }
        if first.time.seconds_since(now) > MAX_START {
            return Err(SetpointError::Future);
        }
        if last.time < now {
            return Err(SetpointError::Old);
        }
        self.stamp.check(now, timeout)
    }

    /// Where P should be at `now`, and its velocity. Before the first point and after the last
    /// P should stand there.
    pub fn at(&self, now: Time) -> Option<ReferencePoint> {
        let next = self.points.partition_point(|point| point.time <= now);
        let begin = next.checked_sub(1).and_then(|index| self.points.get(index));
        let end = self.points.get(next);
        let (Some(begin), Some(end)) = (begin, end) else {
            return Some(ReferencePoint {
                position: Some(begin.or(end)?.position),
                velocity: Velocity::zeros(),
            });
        };
        let duration = end.time.seconds_since(begin.time);
        let part = now.seconds_since(begin.time) / duration;
        let way = end.position - begin.position;
        // The curve is the straight line and a correction at either end.
        let (from, from_rate) = decay(part);
        let (to, to_rate) = decay(1.0 - part);
        let slope = way / duration;
        let (before, after) = (begin.velocity - slope, end.velocity - slope);
        let bent = duration * (before * from.velocity - after * to.velocity);
        Some(ReferencePoint {
            position: Some(begin.position + way * part + bent),
            velocity: slope + before * from_rate.velocity + after * to_rate.velocity,
        })
    }

    /// The pieces in which it reaches the pilot.
    pub fn pieces(&self) -> impl Iterator<Item = TrajectoryPiece> + '_ {
        let count = self.points.len() as u8;
        let points = (0..).zip(&self.points);
        points.map(move |(index, point)| TrajectoryPiece {
            stamp: self.stamp,
            index,
            count,
            point: *point,
        })
    }
}

/// How much of an offset of position, and of one of velocity, is left.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Share {
    pub(crate) position: f64,
    pub(crate) velocity: f64,
}

/// Cubic curves that end at zero with the slope zero: one from 1 with the slope zero, and one
/// from 0 with the slope one. Returns their values and slopes at `part`, from 0 to 1.
pub(crate) fn decay(part: f64) -> (Share, Share) {
    let rest = 1.0 - part;
    let value = Share {
        position: rest * rest * (1.0 + 2.0 * part),
        velocity: rest * rest * part,
    };
    let slope = Share {
        position: -6.0 * part * rest,
        velocity: rest * (1.0 - 3.0 * part),
    };
    (value, slope)
}

fn check_position(position: &Position) -> Result<(), SetpointError> {
    let text = "position_m must lie between -10000 and 10000";
    within(position.coords.as_slice(), MAX_COORDINATE, text)
}

fn check_velocity(velocity: &Velocity) -> Result<(), SetpointError> {
    let text = "velocity_m_s must lie between -100 and 100";
    within(velocity.as_slice(), MAX_RATE, text)
}

fn within(values: &[f64], limit: f64, text: &'static str) -> Result<(), SetpointError> {
    if !values.iter().all(|value| value.is_finite()) {
        Err(SetpointError::NotFinite)
    } else if values.iter().any(|value| fabs(*value) > limit) {
        Err(SetpointError::OutOfRange(text))
    } else {
        Ok(())
    }
}
