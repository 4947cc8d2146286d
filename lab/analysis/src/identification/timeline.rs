//! A stretch of a drive as a sequence of events.
//!
//! The times of the events depend on the parameters: the servo reacts to a target after a
//! delay, and the time stamps of the IMU are late.

use singletrack_control::statistics::Line;
use singletrack_control::wrap;

use super::{
    data::{Drive, Pose, Span},
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

impl<D: Dual> StateEstimate<D> {
    /// What the gyro measures, in rad/s.
    pub(super) fn gyro(&self, model: &Model<D>) -> D {
        self.motion.yaw_rate * model.get(Parameter::GyroScale) + self.gyro_bias
    }

    /// What the accelerometer measures to the left where it measures `forward`, in m/s².
    pub(super) fn left(&self, model: &Model<D>, forward: D) -> D {
        model.left_acceleration(&self.motion, forward - self.forward_bias)
            + model.get(Parameter::LateralBias)
    }

    pub(super) fn of(states: [D; STATES], steering: D) -> Self {
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

    pub(super) fn states(&self) -> [D; STATES] {
        let m = &self.motion;
        let (gyro, forward) = (self.gyro_bias, self.forward_bias);
        [
            m.x, m.y, m.yaw, m.yaw_rate, m.sideslip, m.speed, gyro, forward,
        ]
    }
}

/// A consumer of the events of a stretch.
pub(super) trait EventHandler<D> {
    /// A stretch begins at this time, in s, with this estimate.
    fn begin(&mut self, time: f64, estimate: StateEstimate<D>);
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

impl Drive<'_> {
    /// Passes the events of the stretches to `handler`.
    ///
    /// The events are in the order of their times at the delays of `order`, those of equal times in the
    /// order of [`EventKind`]. At other delays some come up to the difference too early, and time runs
    /// back a little: so every prediction is a smooth function of the delays, also where the times of
    /// two samples are equal. None where the model is not defined.
    pub(super) fn replay<D: Dual>(
        &self,
        model: &Model<D>,
        order: &Values,
        handler: &mut impl EventHandler<D>,
    ) -> Option<()> {
        let mut spans = self.spans.iter();
        spans.try_for_each(|span| replay(self, *span, model, order, handler))
    }
}

/// Passes the events of a stretch to `handler`, as [`Drive::replay`] does.
fn replay<D: Dual>(
    drive: &Drive<'_>,
    span: Span,
    model: &Model<D>,
    order: &Values,
    handler: &mut impl EventHandler<D>,
) -> Option<()> {
    let Drive { data, servo, .. } = drive;
    let events = ordered(drive, span, order);
    let delay = model.get(Parameter::SteeringDelay);
    let inertial_delay = model.get(Parameter::InertialDelay);
    let measured = |index: usize| {
        let sample = data.inertial.get(index)?;
        Some((-inertial_delay + sample.time_s, sample.forward_m_s2))
    };
    let start = D::from(span.start_s);
    let lead = span.start_s - SERVO_LEAD;
    let first = order.get(Parameter::SteeringDelay);
    // Before, the servo is at rest.
    let before = servo.partition_point(|command| command.time_s <= lead - first);
    let before = servo.get(before.saturating_sub(1));
    let mut target = before.map_or(0.0, |command| command.angle_rad);
    let mut steering = model.rest(target);
    let mut now = D::from(lead);
    for command in *servo {
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
    let forward_at = |before: usize, time: D| match (measured(before), measured(before + 1)) {
        (Some((from, one)), Some((to, other))) if (to - from).re() > 0.0 => {
            (time - from) / (to - from) * (other - one) + one
        }
        (at, _) => D::from(at.map_or(0.0, |(_, value)| value)),
    };
    handler.begin(
        span.start_s,
        initial_estimate(&data.poses, span.start_s, steering)?,
    );
    let mut now = start;
    for kind in events {
        let time = match kind {
            EventKind::Pose(index) => D::from(data.poses[index].time_s),
            EventKind::Inertial(index) => measured(index)?.0,
            EventKind::Servo(index) => delay + servo[index].time_s,
        };
        let step = time - now;
        let forward = [forward_at(before, now), forward_at(before, time)];
        handler.advance(step, target, forward)?;
        now = time;
        match kind {
            EventKind::Servo(index) => target = servo[index].angle_rad,
            EventKind::Inertial(index) => {
                before = index;
                handler.inertial(index, D::from(data.inertial[index].forward_m_s2));
            }
            EventKind::Pose(index) => handler.pose(index),
        }
    }
    Some(())
}

/// The events of a stretch, in order.
fn ordered(drive: &Drive<'_>, span: Span, order: &Values) -> Vec<EventKind> {
    let Drive { data, servo, .. } = drive;
    let inner = Span {
        start_s: span.start_s + MARGIN,
        end_s: span.end_s - MARGIN,
    };
    let delay = order.get(Parameter::SteeringDelay);
    let poses = (0..).zip(&data.poses);
    let poses = poses.map(|(index, pose)| (pose.time_s, EventKind::Pose(index)));
    let servo = (0..).zip(*servo);
    let servo = servo.map(|(index, target)| (target.time_s + delay, EventKind::Servo(index)));
    let events = poses.chain(servo);
    let mut events: Vec<(f64, EventKind)> = events
        .filter(|(time, _)| *time > span.start_s && *time <= span.end_s)
        .collect();
    for (index, sample) in data.inertial.iter().enumerate() {
        if inner.contains(sample.time_s) {
            let time = sample.time_s - order.get(Parameter::InertialDelay);
            events.push((time, EventKind::Inertial(index)));
        }
    }
    events.sort_by(|one, other| one.0.total_cmp(&other.0).then(one.1.cmp(&other.1)));
    events.into_iter().map(|(_, kind)| kind).collect()
}

/// The motion at `time`, from a linear fit to the poses around it.
fn initial_estimate<D: Dual>(poses: &[Pose], time: f64, steering: D) -> Option<StateEstimate<D>> {
    const REACH: usize = 4;
    /// In s.
    const AROUND: f64 = 0.3;
    let at = poses.partition_point(|pose| pose.time_s < time);
    let pose = poses.get(at)?;
    let around = &poses[at.saturating_sub(REACH)..(at + REACH + 1).min(poses.len())];
    // None of another drive.
    let near = |other: &&Pose| (other.time_s - time).abs() <= AROUND;
    let around: Vec<&Pose> = around.iter().filter(near).collect();
    let line = |value: &dyn Fn(&Pose) -> f64| {
        let points = around.iter();
        Line::through(points.map(|other| [other.time_s - time, value(other)]))
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
