//! The model of the identification: equations 1 and 2 with axle forces that may saturate,
//! and a servo with a lag. Its inputs are the servo's target and the forward acceleration.

use singletrack_control::{Axles, SingleTrackState, SlipAngles, VehicleParameters};

use super::{
    parameter::{COUNT, Parameter, Values},
    settings::Settings,
};
use crate::dual::{Dual, DualFunctions};

/// The largest rate of a hobby servo, in rad/s. The exact value matters only in steering
/// steps larger than those of a drive.
const SERVO_RATE: f64 = 8.0;

/// The model is not defined below this speed, in m/s.
pub(super) const LEAST_SPEED: f64 = 0.2;

/// The longest integration step, in s: at 1 m/s the fastest mode is near -150/s, where the
/// error of RK4 is 0.03 %.
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

impl<D: Dual> Motion<D> {
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
    axles: Axles<D>,
    slip_angles: SlipAngles,
    parameters: [D; COUNT],
}

impl<D: Dual> Model<D> {
    /// The model of `parameters`, with mass and wheelbase of `values`.
    pub(super) fn new(values: &Values, parameters: [D; COUNT], settings: &Settings) -> Self {
        let (mass, wheelbase) = values.known();
        let get = |parameter: Parameter| parameters[parameter as usize];
        let front_axle_distance = get(Parameter::FrontAxleDistance);
        let vehicle = VehicleParameters {
            mass_kg: D::from(mass),
            yaw_inertia_kg_m2: get(Parameter::YawInertia),
            front_axle_distance_m: front_axle_distance,
            rear_axle_distance_m: -front_axle_distance + wheelbase,
            friction: get(Parameter::Friction),
            front_cornering_stiffness_n_rad: get(Parameter::FrontStiffness),
            rear_cornering_stiffness_n_rad: get(Parameter::RearStiffness),
        };
        Self {
            axles: Axles::new(vehicle, settings.tyres).with_slip_angles(settings.slip_angles),
            slip_angles: settings.slip_angles,
            parameters,
        }
    }

    pub(super) fn get(&self, parameter: Parameter) -> D {
        self.parameters[parameter as usize]
    }

    /// The steering angle at which the servo settles for `target`, in rad.
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

    /// The rate of the motion at the forward acceleration `forward` of G, in m/s².
    fn rate(&self, s: &Motion<D>, target: f64, forward: D) -> Motion<D> {
        let state = SingleTrackState {
            x: s.x,
            y: s.y,
            yaw: s.yaw,
            yaw_rate: s.yaw_rate,
            sideslip: s.sideslip,
        };
        let motion = state.lateral_motion(s.speed, s.steering);
        let forces = self.axles.forces::<DualFunctions, D>(&motion);
        let lateral = self.axles.lateral::<DualFunctions, D>(&motion, &forces);
        let rate = state.derivative::<DualFunctions>(s.speed, lateral);
        // Perpendicular to the course, positive to the left.
        let centripetal = match self.slip_angles {
            SlipAngles::Small => (forces.front + forces.rear) / self.axles.vehicle().mass_kg,
            SlipAngles::Exact => (rate.sideslip + s.yaw_rate) * s.speed,
        };
        let (sin, cos) = s.sideslip.sin_cos();
        Motion {
            x: rate.x,
            y: rate.y,
            yaw: rate.yaw,
            yaw_rate: rate.yaw_rate,
            sideslip: rate.sideslip,
            speed: (forward + centripetal * sin) / cos,
            steering: self.steering_rate(s.steering, target),
        }
    }

    /// The acceleration of G to the car's left at the forward acceleration `forward`, in m/s².
    pub(super) fn left_acceleration(&self, s: &Motion<D>, forward: D) -> D {
        // The acceleration does not depend on the servo's target.
        let rate = self.rate(s, 0.0, forward);
        let (sin, cos) = s.sideslip.sin_cos();
        rate.speed * sin + (rate.sideslip + s.yaw_rate) * s.speed * cos
    }

    /// The motion after `step` seconds, in which the forward acceleration changes linearly
    /// from `forward[0]` to `forward[1]`. None where the model is not defined.
    pub(super) fn advance(
        &self,
        mut s: Motion<D>,
        step: D,
        target: f64,
        forward: [D; 2],
    ) -> Option<Motion<D>> {
        let parts = (step.re().abs() / LONGEST_STEP).ceil().max(1.0);
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

    /// The steering angle after `step` seconds at a constant target.
    pub(super) fn steer(&self, steering: D, step: D, target: f64) -> D {
        let parts = (step.re().abs() / LONGEST_STEP).ceil().clamp(1.0, 250.0);
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
