//! From a message of ROS to a set-point of the daemon, or the reason against it.
//!
//! The daemon checks every set-point again. What is refused here is what only ROS knows: stamps
//! on the wall clock, and frames.

use std::time::Duration;

use singletrack_api::{Code, Refused, Setpoint, TrajectoryPoint};

use crate::{
    frames::Frames,
    message::{AckermannDriveStamped, Header, Now, Path, Time, TwistStamped},
    shared::Car,
};

/// The map under the name that a record of an earlier version has for it.
const WORLD: &str = "world";

/// A largest steering rate above this limits no car, rad/s.
const UNLIMITED: f64 = 100.0;

/// A stamp may be ahead of this computer's clock by this: clocks of two computers differ. The
/// set-point then counts as decided now.
const AHEAD: Duration = Duration::from_millis(5);

/// The bounds of a trajectory's number of points.
const FEWEST: usize = 2;
const MOST: usize = 100;

/// The judge of set-points.
#[derive(Clone, Debug)]
pub(crate) struct Judge {
    pub(crate) max_age: Duration,
    pub(crate) frames: Frames,
}

/// Times of a message.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Arrival {
    /// Time of its arrival.
    pub(crate) now: Now,
    /// Time at which the sender's middleware sent it, on the wall clock, in ns.
    pub(crate) sent: Option<i128>,
}

/// Warnings of fields of a drive that have no effect.
pub(crate) fn ignored_of_drive(message: &AckermannDriveStamped) -> [Option<&'static str>; 2] {
    let acceleration = "drive: acceleration is ignored; limits.max_acceleration_m_s2 is in force";
    [
        (message.acceleration != 0.0).then_some(acceleration),
        (message.jerk != 0.0).then_some("drive: jerk is ignored"),
    ]
}

/// Warnings of fields of a twist that have no effect.
pub(crate) fn ignored_of_twist(message: &TwistStamped) -> [Option<&'static str>; 2] {
    let (linear, angular) = (message.linear, message.angular);
    let rest = [linear.y, linear.z, angular.x, angular.y];
    let has_rest = rest.iter().any(|&part| part != 0.0);
    let turns = linear.x == 0.0 && angular.z != 0.0;
    [
        has_rest.then_some(
            "cmd_vel: fields beside linear.x and angular.z are ignored: the car can't move so",
        ),
        turns.then_some(
            "cmd_vel: angular.z without linear.x turns the wheels, not the car: it can't turn on \
             the spot",
        ),
    ]
}

impl Judge {
    /// The velocity of P.
    pub(crate) fn velocity(
        &self,
        message: &TwistStamped,
        arrival: &Arrival,
    ) -> Result<Setpoint, Refused> {
        let time_ns = self.decided(message.header.stamp, arrival.now)?;
        self.in_map(&message.header)?;
        let (linear, angular) = (message.linear, message.angular);
        let rest = [linear.z, angular.x, angular.y, angular.z];
        finite([linear.x, linear.y].into_iter().chain(rest))?;
        if rest.iter().any(|&part| part != 0.0) {
            return Err(Refused::new(
                Code::Invalid,
                "only linear.x and linear.y of point_velocity may differ from zero",
            ));
        }
        Ok(Setpoint {
            velocity_m_s: Some([linear.x, linear.y]),
            time_ns: Some(time_ns),
            ..Setpoint::default()
        })
    }

    /// Steering and speed of the rear axle, whatever the frame: programs write that of a sensor.
    pub(crate) fn drive(
        &self,
        message: &AckermannDriveStamped,
        arrival: &Arrival,
    ) -> Result<Setpoint, Refused> {
        let time_ns = self.decided_or_sent(&message.header, arrival)?;
        let [steering, rate, speed] = [
            message.steering_angle,
            message.steering_angle_velocity,
            message.speed,
        ]
        .map(f64::from);
        finite([steering, rate, speed])?;
        let rate = rate.abs();
        Ok(Setpoint {
            steering_rad: Some(steering),
            // Zero: as quickly as possible.
            steering_rate_rad_s: (rate > 0.0 && rate < UNLIMITED).then_some(rate),
            rear_speed_m_s: Some(speed),
            time_ns: Some(time_ns),
            ..Setpoint::default()
        })
    }

    /// Speed and yaw rate of the car, whatever the frame: Nav2 writes the one in which it plans.
    pub(crate) fn twist(
        &self,
        message: &TwistStamped,
        car: Option<Car>,
        arrival: &Arrival,
    ) -> Result<Setpoint, Refused> {
        let time_ns = self.decided_or_sent(&message.header, arrival)?;
        let (speed, yaw_rate) = (message.linear.x, message.angular.z);
        finite([speed, yaw_rate])?;
        let car = car.ok_or_else(|| {
            Refused::new(
                Code::NotReady,
                "cmd_vel needs the wheelbase, and the daemon has not given its configuration yet",
            )
        })?;
        let steering = match yaw_rate {
            0.0 => 0.0,
            _ => libm::atan(car.wheelbase() * yaw_rate / speed),
        };
        Ok(Setpoint {
            steering_rad: Some(steering),
            rear_speed_m_s: Some(speed),
            time_ns: Some(time_ns),
            ..Setpoint::default()
        })
    }

    /// Timed positions of P, with velocities from the positions.
    pub(crate) fn path(&self, message: &Path, arrival: &Arrival) -> Result<Setpoint, Refused> {
        let now = arrival.now;
        let decided = self.decided(message.header.stamp, now)?;
        self.in_map(&message.header)?;
        let poses = &message.poses;
        if !(FEWEST..=MOST).contains(&poses.len()) {
            return Err(no_path());
        }
        let points = poses.iter().map(|pose| {
            if !pose.header.frame_id.is_empty() {
                self.in_map(&pose.header)?;
            }
            let position = [pose.position.x, pose.position.y];
            finite(position)?;
            let wall = pose.header.stamp.ns();
            Ok(Timed { wall, position })
        });
        let points = points.collect::<Result<Vec<_>, Refused>>()?;
        if !points.is_sorted_by(|first, second| first.wall < second.wall) {
            return Err(no_path());
        }
        let trajectory = velocities(&points).zip(&points).map(|(velocity, point)| {
            finite(velocity)?;
            let time_ns = u64::try_from(now.monotonic_at(point.wall)).map_err(|_| no_path())?;
            Ok(TrajectoryPoint {
                time_ns,
                position_m: point.position,
                velocity_m_s: velocity,
            })
        });
        Ok(Setpoint {
            trajectory: Some(trajectory.collect::<Result<_, Refused>>()?),
            time_ns: Some(decided),
            ..Setpoint::default()
        })
    }

    /// Time of the decision, on `CLOCK_MONOTONIC`; that of the sending without a stamp, which many
    /// programs leave out.
    fn decided_or_sent(&self, header: &Header, arrival: &Arrival) -> Result<u64, Refused> {
        let sent = || Time::from_ns(arrival.sent.unwrap_or(arrival.now.wall));
        let is_stamped = header.stamp != Time::default();
        let stamp = if is_stamped { header.stamp } else { sent() };
        self.decided(stamp, arrival.now)
    }

    /// When it was decided, on `CLOCK_MONOTONIC`.
    fn decided(&self, stamp: Time, now: Now) -> Result<u64, Refused> {
        if stamp == Time::default() {
            return Err(Refused::new(
                Code::Invalid,
                "header.stamp is zero: give the time at which it was decided",
            ));
        }
        let old = || Refused::new(Code::Old, "header.stamp is older than --max-age-ms");
        let age = now.wall - stamp.ns();
        if age > self.max_age.as_nanos() as i128 {
            return Err(old());
        }
        if -age > AHEAD.as_nanos() as i128 {
            return Err(Refused::new(
                Code::Future,
                "header.stamp is in the future: are the clocks synchronised?",
            ));
        }
        u64::try_from(now.monotonic - age.max(0)).map_err(|_| old())
    }

    /// Whether positions and velocities are in the frame of the motion capture.
    fn in_map(&self, header: &Header) -> Result<(), Refused> {
        let Frames { map, odom, .. } = &self.frames;
        if [map, odom, WORLD].contains(&header.frame_id.as_str()) {
            return Ok(());
        }
        Err(Refused::new(
            Code::Invalid,
            format_args!(
                "header.frame_id is {:?}: give {map:?} or {odom:?}",
                header.frame_id
            ),
        ))
    }
}

/// A position at a time of the wall clock.
struct Timed {
    wall: i128,
    position: [f64; 2],
}

/// The velocities at the points: between two, the slope of the parabola through it and its
/// neighbours; at the ends, that of the line.
fn velocities(points: &[Timed]) -> impl Iterator<Item = [f64; 2]> {
    let slope = |from: Option<&Timed>, to: Option<&Timed>| {
        let (from, to) = (from?, to?);
        let time = (to.wall - from.wall) as f64 * 1e-9;
        let ([x, y], [to_x, to_y]) = (from.position, to.position);
        Some(([(to_x - x) / time, (to_y - y) / time], time))
    };
    (0..points.len()).map(move |index| {
        let here = points.get(index);
        let before = slope(index.checked_sub(1).and_then(|one| points.get(one)), here);
        let after = slope(here, points.get(index + 1));
        match (before, after) {
            (Some((b, time_b)), Some((a, time_a))) => {
                let total = time_b + time_a;
                let mean = |b: f64, a: f64| (b * time_a + a * time_b) / total;
                [mean(b[0], a[0]), mean(b[1], a[1])]
            }
            (Some((one, _)), None) | (None, Some((one, _))) => one,
            (None, None) => [0.0; 2],
        }
    })
}

fn finite(numbers: impl IntoIterator<Item = f64>) -> Result<(), Refused> {
    if numbers.into_iter().all(f64::is_finite) {
        return Ok(());
    }
    Err(Refused::new(Code::NotFinite, "a number is not finite"))
}

fn no_path() -> Refused {
    Refused::new(
        Code::OutOfRange,
        "a path has 2 to 100 poses with increasing stamps",
    )
}

#[cfg(test)]
#[allow(
    clippy::unwrap_used,
    clippy::indexing_slicing,
    reason = "a test may fail"
)]
mod tests;
