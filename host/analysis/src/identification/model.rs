//! The car as the identification believes it: equation 1 with tyres that slide,
//! driven by the servo's target and the acceleration forward.

use num_dual::DualNum;
use singletrack_control::GRAVITY;

use super::parameter::{COUNT, Parameter, Values};

/// Which force curve the tyres have.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Tyres {
    /// Linear for small slip, at most μ times the axle's load.
    #[default]
    Saturating,
    /// The paper's: linear throughout.
    Linear,
}

/// Numbers to compute with: plain, or with their derivatives.
pub(super) trait Number: DualNum<Primitive = f64> + Copy {}
impl<D: DualNum<Primitive = f64> + Copy> Number for D {}

/// The largest rate of a hobby servo, in rad/s. What it is exactly shows only in
/// steps of the steering that no drive has.
const SERVO_RATE: f64 = 8.0;

/// Slower than this the model is not defined, in m/s.
pub(super) const LEAST_SPEED: f64 = 0.2;

/// Longest step, in s: at 1 m/s the fastest mode is near -150/s, of which RK4 makes
/// an error of 0.03 % there.
const LONGEST_STEP: f64 = 0.004;

/// The motion of the car.
#[derive(Clone, Copy, Debug)]
pub(super) struct Motion<D> {
    /// Position of G, in m.
    pub(super) x: D,
    pub(super) y: D,
    /// Yaw, in rad, not wrapped.
    pub(super) yaw: D,
    /// Yaw rate, in rad/s.
    pub(super) yaw_rate: D,
    /// Sideslip at G, in rad.
    pub(super) sideslip: D,
    /// Speed of G along its course, in m/s.
    pub(super) speed: D,
    /// Steering angle, in rad.
    pub(super) steering: D,
}

impl<D: Number> Motion<D> {
    fn plus(&self, rate: &Self, step: D) -> Self {
        Self {
            x: self.x + rate.x * step,
            y: self.y + rate.y * step,
            yaw: self.yaw + rate.yaw * step,
            yaw_rate: self.yaw_rate + rate.yaw_rate * step,
            sideslip: self.sideslip + rate.sideslip * step,
            speed: self.speed + rate.speed * step,
            steering: self.steering + rate.steering * step,
        }
    }
}

/// The model with its parameters.
#[derive(Clone, Copy, Debug)]
pub(super) struct Model<D> {
    mass: f64,
    parameters: [D; COUNT],
    rear_axle_distance: D,
    /// Largest force of the axles, in N.
    limits: [D; 2],
    tyres: Tyres,
}

impl<D: Number> Model<D> {
    /// The model of `parameters`, with mass and wheelbase of `values`.
    pub(super) fn new(values: &Values, parameters: [D; COUNT], tyres: Tyres) -> Self {
        let (mass, wheelbase) = values.known();
        let front = parameters[Parameter::FrontAxleDistance as usize];
        let rear = -front + wheelbase;
        let weight = mass * GRAVITY / wheelbase;
        let friction = parameters[Parameter::Friction as usize];
        Self {
            mass,
            parameters,
            rear_axle_distance: rear,
            limits: [friction * rear * weight, friction * front * weight],
            tyres,
        }
    }

    pub(super) fn get(&self, parameter: Parameter) -> D {
        self.parameters[parameter as usize]
    }

    /// Where the servo rests when it is told `target`, in rad.
    pub(super) fn rest(&self, target: f64) -> D {
        self.get(Parameter::SteeringGain) * target + self.get(Parameter::SteeringTrim)
    }

    fn steering_rate(&self, steering: D, target: f64) -> D {
        let rate = (self.rest(target) - steering) / self.get(Parameter::ServoLag);
        if rate.re() > SERVO_RATE {
            D::from(SERVO_RATE)
        } else if rate.re() < -SERVO_RATE {
            D::from(-SERVO_RATE)
        } else {
            rate
        }
    }

    fn force(&self, linear: D, limit: D) -> D {
        match self.tyres {
            Tyres::Saturating => limit * tanh(linear / limit),
            Tyres::Linear => linear,
        }
    }

    /// The rate of the motion, with the acceleration of G forward, in m/s².
    fn rate(&self, s: &Motion<D>, target: f64, forward: D) -> Motion<D> {
        let front_axle = self.get(Parameter::FrontAxleDistance);
        let turning = s.yaw_rate / s.speed;
        let front = self.force(
            self.get(Parameter::FrontStiffness) * (s.steering - s.sideslip - front_axle * turning),
            self.limits[0],
        );
        let rear = self.force(
            self.get(Parameter::RearStiffness) * (self.rear_axle_distance * turning - s.sideslip),
            self.limits[1],
        );
        // Towards the inside of the bend, at right angles to the course.
        let centripetal = (front + rear) / self.mass;
        let course = s.yaw + s.sideslip;
        let (sin, cos) = s.sideslip.sin_cos();
        Motion {
            x: s.speed * course.cos(),
            y: s.speed * course.sin(),
            yaw: s.yaw_rate,
            yaw_rate: (front_axle * front - self.rear_axle_distance * rear)
                / self.get(Parameter::YawInertia),
            sideslip: centripetal / s.speed - s.yaw_rate,
            speed: (forward + centripetal * sin) / cos,
            steering: self.steering_rate(s.steering, target),
        }
    }

    /// The acceleration of G to the car's left, in m/s², with the one forward.
    pub(super) fn left_acceleration(&self, s: &Motion<D>, forward: D) -> D {
        // Its direction does not depend on the servo's target.
        let rate = self.rate(s, 0.0, forward);
        let (sin, cos) = s.sideslip.sin_cos();
        rate.speed * sin + (rate.sideslip + s.yaw_rate) * s.speed * cos
    }

    /// The motion after `step` seconds, the acceleration forward going evenly
    /// from `forward[0]` to `forward[1]`. None where the model ends.
    pub(super) fn advance(
        &self,
        mut s: Motion<D>,
        step: D,
        target: f64,
        forward: [D; 2],
    ) -> Option<Motion<D>> {
        let parts = (step.re() / LONGEST_STEP).ceil().max(1.0);
        let h = step / parts;
        let slope = (forward[1] - forward[0]) / parts;
        let mut from = forward[0];
        for _ in 0..parts as u32 {
            let middle = from + slope * 0.5;
            let to = from + slope;
            let k1 = self.rate(&s, target, from);
            let k2 = self.rate(&s.plus(&k1, h * 0.5), target, middle);
            let k3 = self.rate(&s.plus(&k2, h * 0.5), target, middle);
            let k4 = self.rate(&s.plus(&k3, h), target, to);
            s = s
                .plus(&k1, h / 6.0)
                .plus(&k2, h / 3.0)
                .plus(&k3, h / 3.0)
                .plus(&k4, h / 6.0);
            from = to;
            if !(s.speed.re() > LEAST_SPEED && s.sideslip.re().abs() < 1.0) {
                return None;
            }
        }
        Some(s)
    }

    /// The steering angle after `step` seconds on the way to a target.
    pub(super) fn steer(&self, steering: D, step: D, target: f64) -> D {
        let parts = (step.re() / LONGEST_STEP).ceil().clamp(1.0, 250.0);
        let h = step / parts;
        let mut s = steering;
        for _ in 0..parts as u32 {
            let k1 = self.steering_rate(s, target);
            let k2 = self.steering_rate(s + k1 * h * 0.5, target);
            let k3 = self.steering_rate(s + k2 * h * 0.5, target);
            let k4 = self.steering_rate(s + k3 * h, target);
            s += (k1 + (k2 + k3) * 2.0 + k4) * h / 6.0;
        }
        s
    }
}

/// Half as dear as the quotient of the hyperbolic sine and cosine.
fn tanh<D: Number>(x: D) -> D {
    // Beyond it is one to the last bit, and its exponential too large.
    if x.re().abs() > 20.0 {
        return D::from(x.re().signum());
    }
    let square = (x * 2.0).exp();
    (square - 1.0) / (square + 1.0)
}
