//! The pilot's own compensation: its predictor, and the lead of its steering.

use nalgebra::{DMatrix, DVector};
use singletrack_control::VehicleParameters;

use super::{
    Servo,
    plant::{Delay, POSITION, SIDESLIP, YAW, YAW_RATE},
};
use crate::stability::characteristic::symbols;

/// The longest step of the pilot's prediction, in s.
const LONGEST_STEP: f64 = 0.005;

/// The compensation of the actuators as the pilot has it (`compensation.actuation`), about
/// straight motion.
///
/// It follows the wheels by a model of the servo. The state is predicted over the dead time as
/// modelled, by the answer of first order that linear tyres give yaw rate and sideslip. The command is
/// the angle that turns the lagging wheels with the law's rate.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Compensation {
    /// The servo as modelled: its dead time counts from the tick (`[actuators]`).
    pub servo: Servo,
    /// The car as modelled.
    pub vehicle: VehicleParameters,
}

/// Wheels, yaw rate and sideslip of the pilot's model, each as a linear combination of the state
/// of the loop.
#[derive(Clone)]
pub(super) struct Modelled {
    pub(super) wheels: DVector<f64>,
    pub(super) yaw_rate: DVector<f64>,
    pub(super) sideslip: DVector<f64>,
}

/// The answer of first order to the steering: what yaw rate and sideslip tend to, for each rad,
/// and their time constants in s.
struct Response {
    yaw_rate: f64,
    yaw_time: f64,
    sideslip: f64,
    slip_time: f64,
}

impl Response {
    /// The response of the control crate's `Predictor`, for small angles.
    fn of(vehicle: &VehicleParameters, speed: f64) -> Self {
        let [m, inertia, l_f, l_r, c_f, c_r] = symbols(vehicle);
        let (wheelbase, square) = (vehicle.wheelbase_m(), speed * speed);
        let understeer = m / wheelbase * (l_r / c_f - l_f / c_r);
        let length = (wheelbase + understeer * square).max(0.5 * wheelbase);
        Self {
            yaw_rate: speed / length,
            yaw_time: speed * inertia / (c_f * l_f * l_f + c_r * l_r * l_r),
            sideslip: (l_r - m * l_f / (wheelbase * c_r) * square) / length,
            slip_time: speed * m / (c_f + c_r),
        }
    }
}

impl Compensation {
    /// The model `duration` after a tick. `target` gives the command of a number of ticks before
    /// that tick; `each` is told of the model after each step, and of its length.
    pub(super) fn run(
        &self,
        speed: f64,
        period: f64,
        duration: f64,
        mut state: Modelled,
        target: impl Fn(usize) -> DVector<f64>,
        mut each: impl FnMut(&Modelled, f64),
    ) -> Modelled {
        let response = Response::of(&self.vehicle, speed);
        let dead = Delay::new(self.servo.dead_time, period);
        let (mut done, mut age) = (0.0, dead.ticks + 1);
        let mut next = dead.late;
        while done < duration - 1e-12 {
            while next <= done + 1e-12 {
                age -= 1;
                next += period;
            }
            let dt = duration.min(done + LONGEST_STEP).min(next) - done;
            let follows = |value: &DVector<f64>, end: &DVector<f64>, lag: f64| {
                let kept = if lag > 0.0 { libm::exp(-dt / lag) } else { 0.0 };
                end + (value - end) * kept
            };
            let wheels = follows(&state.wheels, &target(age), self.servo.lag);
            let yaw_rate = &wheels * response.yaw_rate;
            let sideslip = &wheels * response.sideslip;
            state = Modelled {
                yaw_rate: follows(&state.yaw_rate, &yaw_rate, response.yaw_time),
                sideslip: follows(&state.sideslip, &sideslip, response.slip_time),
                wheels,
            };
            each(&state, dt);
            done += dt;
        }
        state
    }

    /// What the law is given, from what was measured: position, yaw, yaw rate, sideslip and
    /// steering when the command begins to act. The columns are combinations of the loop's state.
    pub(super) fn predicted(
        &self,
        speed: f64,
        period: f64,
        measured: DMatrix<f64>,
        now: Modelled,
        target: impl Fn(usize) -> DVector<f64>,
    ) -> DMatrix<f64> {
        let mut seen = measured;
        let mut last = now.clone();
        let each = |state: &Modelled, dt: f64| {
            let yaw_rate = seen.row(YAW_RATE).transpose();
            let sideslip = seen.row(SIDESLIP).transpose();
            let later_rate = &yaw_rate + &state.yaw_rate - &last.yaw_rate;
            let later_slip = &sideslip + &state.sideslip - &last.sideslip;
            let turn = (yaw_rate + &later_rate) * (0.5 * dt);
            let course = seen.row(YAW).transpose() + (&turn + sideslip + &later_slip) * 0.5;
            let mut add = |row: usize, by: &DVector<f64>| {
                let mut row = seen.row_mut(row);
                row += by.transpose();
            };
            add(POSITION, &(course * (speed * dt)));
            add(YAW, &turn);
            seen.set_row(YAW_RATE, &later_rate.transpose());
            seen.set_row(SIDESLIP, &later_slip.transpose());
            last = state.clone();
        };
        let end = self.run(speed, period, self.servo.dead_time, now, target, each);
        seen.set_row(super::plant::STEERING, &end.wheels.transpose());
        seen
    }

    /// The change of the command for each rad/s of the wheels, in s.
    pub(super) fn lead(&self, period: f64) -> f64 {
        period / (1.0 - libm::exp(-period / self.servo.lag))
    }
}
