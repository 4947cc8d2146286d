//! A stretch of a drive as a sequence of events.
//!
//! The times of the events depend on the parameters: the servo reacts to a target after a
//! delay, and the time stamps of the IMU are late.

use singletrack_control::statistics::Line;
use singletrack_control::wrap;

use super::{
    data::{DriveData, Pose, ServoTarget, Span},
    model::{Model, Motion},
    parameter::{Parameter, Values},
};
use crate::dual::Dual;

/// An estimate of the motion of the car and of the biases of its sensors.
#[derive(Clone, Copy, Debug)]
pub(super) struct StateEstimate<D> {
    pub(super) motion: Motion<D>,
    /// Bias of the gyro, in rad/s.
    pub(super) gyro_bias: D,
    /// Bias of the forward acceleration, in m/s².
    pub(super) forward_bias: D,
}

/// Number of states: x, y, yaw, yaw rate, sideslip, speed, bias of the gyro, bias of the
/// forward acceleration. The steering angle is no state: it follows from the servo's targets.
pub(super) const STATES: usize = 8;

impl<D: Copy> StateEstimate<D> {
    pub(super) const fn of(states: [D; STATES], steering: D) -> Self {
        let [x, y, yaw, yaw_rate, sideslip, speed, biases @ ..] = states;
        let [gyro_bias, forward_bias] = biases;
        Self {
            motion: Motion {
                x,
                y,
                yaw,
                yaw_rate,
                sideslip,
                speed,
                steering,
            },
            gyro_bias,
            forward_bias,
        }
    }

    pub(super) const fn states(&self) -> [D; STATES] {
        let m = &self.motion;
        let (gyro, forward) = (self.gyro_bias, self.forward_bias);
        [
            m.x, m.y, m.yaw, m.yaw_rate, m.sideslip, m.speed, gyro, forward,
        ]
    }
}

/// A consumer of the events of a stretch.
pub(super) trait EventHandler<D> {
    /// The stretch begins with this estimate.
    fn begin(&mut self, estimate: StateEstimate<D>);
    /// `step` seconds pass, in which the measured forward acceleration changes linearly from
    /// `forward[0]` to `forward[1]`. None where the model is not defined.
    fn advance(&mut self, step: D, target: f64, forward: [D; 2]) -> Option<()>;
    /// The inertial sample with this index is measured, with the forward acceleration
    /// `forward`.
    fn inertial(&mut self, index: usize, forward: D);
    /// The pose with this index is measured.
    fn pose(&mut self, index: usize);
}

/// An event, with the index of its sample.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum EventKind {
    Pose(usize),
    Inertial(usize),
    Servo(usize),
}

/// The servo is simulated for this long before a stretch, in which it settles, in s.
const SERVO_LEAD: f64 = 0.6;

/// Inertial samples closer to the ends of a stretch are left out, so that their number does
/// not depend on their delay, in s.
const MARGIN: f64 = 0.02;

/// Passes the events of a stretch to `handler`. `servo` are the targets that begin a pulse.
///
/// The events are in the order of their times at the delays of `order`, those of equal times in the
/// order of [`EventKind`]. At other delays some come up to the difference too early, and time runs
/// back a little: so every prediction is a smooth function of the delays, also where the times of
/// two samples are equal. None where the model is not defined.
pub(super) fn replay<D: Dual>(
    data: &DriveData,
    servo: &[ServoTarget],
    span: Span,
    model: &Model<D>,
    order: &Values,
    handler: &mut impl EventHandler<D>,
) -> Option<()> {
    let events = ordered(data, servo, span, order);
    let delay = model.get(Parameter::SteeringDelay);
    let inertial_delay = model.get(Parameter::InertialDelay);
    let measured = |index: usize| {
        let sample = data.inertial.get(index)?;
        Some((-inertial_delay + sample.time_s, sample.forward_m_s2))
    };
    let start = D::from(span.start_s);
    let lead = span.start_s - SERVO_LEAD;
    let first = order.get(Parameter::SteeringDelay);
    let (mut steering, mut target) = steering_before(servo, lead - first, model);
    let mut now = D::from(lead);
    for command in servo {
        let at = command.time_s + first;
        if at > lead && at <= span.start_s {
            let time = delay + command.time_s;
            steering = model.steer(steering, time - now, target);
            target = command.angle_rad;
            now = time;
        }
    }
    steering = model.steer(steering, start - now, target);

    // Index of the last inertial sample.
    let after = data.inertial.partition_point(|sample| {
        sample.time_s - order.get(Parameter::InertialDelay) <= span.start_s
    });
    let mut before = after.saturating_sub(1);
    let forward_at = |before: usize, time: D| {
        let none = D::from(0.0);
        match (measured(before), measured(before + 1)) {
            (Some((from, one)), Some((to, other))) if (to - from).re() > 0.0 => {
                (time - from) / (to - from) * (other - one) + one
            }
            (Some((_, value)), _) => D::from(value),
            _ => none,
        }
    };
    handler.begin(initial_estimate(data, span.start_s, steering)?);
    let mut now = start;
    for kind in events {
        let time = match kind {
            EventKind::Pose(index) => D::from(data.poses.get(index)?.time_s),
            EventKind::Inertial(index) => measured(index)?.0,
            EventKind::Servo(index) => delay + servo.get(index)?.time_s,
        };
        let step = time - now;
        let forward = [forward_at(before, now), forward_at(before, time)];
        handler.advance(step, target, forward)?;
        now = time;
        match kind {
            EventKind::Servo(index) => target = servo.get(index)?.angle_rad,
            EventKind::Inertial(index) => {
                before = index;
                handler.inertial(index, D::from(measured(index)?.1));
            }
            EventKind::Pose(index) => handler.pose(index),
        }
    }
    Some(())
}

/// The events of a stretch, in order.
fn ordered(data: &DriveData, servo: &[ServoTarget], span: Span, order: &Values) -> Vec<EventKind> {
    let mut events: Vec<(f64, EventKind)> = Vec::new();
    let inner = Span {
        start_s: span.start_s + MARGIN,
        end_s: span.end_s - MARGIN,
    };
    for (index, pose) in data.poses.iter().enumerate() {
        if span.contains(pose.time_s) && pose.time_s > span.start_s {
            events.push((pose.time_s, EventKind::Pose(index)));
        }
    }
    for (index, sample) in data.inertial.iter().enumerate() {
        if inner.contains(sample.time_s) {
            let time = sample.time_s - order.get(Parameter::InertialDelay);
            events.push((time, EventKind::Inertial(index)));
        }
    }
    for (index, command) in servo.iter().enumerate() {
        let time = command.time_s + order.get(Parameter::SteeringDelay);
        if time > span.start_s && time <= span.end_s {
            events.push((time, EventKind::Servo(index)));
        }
    }
    events.sort_by(|one, other| one.0.total_cmp(&other.0).then(one.1.cmp(&other.1)));
    events.into_iter().map(|(_, kind)| kind).collect()
}

/// Steering angle and target after the targets until `time`, with the servo at rest.
fn steering_before<D: Dual>(servo: &[ServoTarget], time: f64, model: &Model<D>) -> (D, f64) {
    let after = servo.partition_point(|command| command.time_s <= time);
    let target = servo
        .get(after.saturating_sub(1))
        .map_or(0.0, |command| command.angle_rad);
    (model.rest(target), target)
}

/// The motion at `time`, from a linear fit to the poses around it.
fn initial_estimate<D: Dual>(data: &DriveData, time: f64, steering: D) -> Option<StateEstimate<D>> {
    const REACH: usize = 4;
    /// In s.
    const AROUND: f64 = 0.3;
    let at = data.poses.partition_point(|pose| pose.time_s < time);
    let from = at.saturating_sub(REACH);
    let pose = data.poses.get(at)?;
    let around = data
        .poses
        .get(from..(at + REACH + 1).min(data.poses.len()))?;
    // None of another drive.
    let near = |other: &&Pose| (other.time_s - time).abs() <= AROUND;
    let around: Vec<&Pose> = around.iter().filter(near).collect();
    let line = |value: &dyn Fn(&Pose) -> f64| {
        let points = around
            .iter()
            .map(|other| [other.time_s - time, value(other)]);
        Line::through(points)
    };
    let [x, y] = [line(&|other| other.x_m), line(&|other| other.y_m)];
    let turned = line(&|other| wrap(other.yaw_rad - pose.yaw_rad));
    if turned.spread <= 0.0 {
        return None;
    }
    let (vx, vy) = (x.slope, y.slope);
    let course = vy.atan2(vx);
    let yaw = pose.yaw_rad + turned.at(0.0);
    let sideslip = wrap(course - yaw).clamp(-0.5, 0.5);
    let (x, y, speed) = (x.at(0.0), y.at(0.0), vx.hypot(vy));
    let states = [x, y, yaw, turned.slope, sideslip, speed, 0.0, 0.0];
    Some(StateEstimate::of(states.map(D::from), steering))
}
