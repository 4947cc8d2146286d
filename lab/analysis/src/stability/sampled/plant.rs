//! The linearised car between two ticks, under an input that is held, and its servo; and the pilot's own
//! compensation: its predictor, and the lead of its steering.

use nalgebra::{DMatrix, DVector};
use num_dual::Dual64;
use singletrack_control::{SingleTrack, SingleTrackState, VehicleParameters};

use crate::{dual::DualFunctions, stability::characteristic::symbols};

pub(super) const POSITION: usize = 0;
pub(super) const YAW: usize = 1;
pub(super) const YAW_RATE: usize = 2;
pub(super) const SIDESLIP: usize = 3;
pub(super) const STEERING: usize = 4;

/// How the input steers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Steering {
    /// The input is the steering angle.
    Angle,
    /// The input is the steering rate.
    Rate,
    /// The input is an angle that the wheels follow with a lag of first order, in s.
    Servo(f64),
}

/// The linearised car: lateral position, yaw, yaw rate and sideslip, and also steering
/// unless it is the input.
pub(super) struct Plant {
    dynamics: DMatrix<f64>,
    input: DVector<f64>,
}

impl Plant {
    /// `vehicle` in straight motion at `speed` (m/s).
    pub(super) fn new(vehicle: &VehicleParameters, speed: f64, steering: Steering) -> Self {
        let [columns @ .., by_steering] =
            [0, 1, 2, 3, 4].map(|variable| slope(vehicle, speed, variable));
        let car = DMatrix::from_iterator(4, 4, columns.iter().flatten().copied());
        let by_steering = DVector::from_row_slice(&by_steering);
        let (own, input) = match steering {
            Steering::Angle => {
                let (dynamics, input) = (car, by_steering);
                return Self { dynamics, input };
            }
            Steering::Rate => (0.0, 1.0),
            Steering::Servo(lag) => (-1.0 / lag, 1.0 / lag),
        };
        let mut dynamics = car.resize(5, 5, 0.0);
        dynamics
            .view_mut((0, STEERING), (4, 1))
            .copy_from(&by_steering);
        dynamics[(STEERING, STEERING)] = own;
        Self {
            dynamics,
            input: DVector::from_vec(vec![0.0, 0.0, 0.0, 0.0, input]),
        }
    }

    /// Number of states.
    pub(super) fn states(&self) -> usize {
        self.dynamics.nrows()
    }

    /// The state after `time` without input.
    pub(super) fn transition(&self, time: f64) -> DMatrix<f64> {
        (&self.dynamics * time).exp()
    }

    /// The contributions of a unit of input over the first `late` s of `period`, and over the
    /// rest, to the state at its end.
    pub(super) fn split_input(&self, period: f64, late: f64) -> [DVector<f64>; 2] {
        let rest = period - late;
        [self.transition(rest) * self.held(late), self.held(rest)]
    }

    /// The contribution of a unit of input over `time` to the state: the integral of the
    /// transition, from the exponential of a bordered matrix.
    pub(super) fn held(&self, time: f64) -> DVector<f64> {
        let states = self.states();
        let mut bordered = self.dynamics.clone().resize(states + 1, states + 1, 0.0);
        bordered
            .view_mut((0, states), (states, 1))
            .copy_from(&self.input);
        let integral = (bordered * time).exp();
        integral.column(states).rows(0, states).into_owned()
    }
}

/// The exact derivative of the car's motion by one of y, yaw, yaw rate, sideslip and
/// steering at the steady motion: equations 1 and 2 without the position along the path.
fn slope(vehicle: &VehicleParameters, speed: f64, variable: usize) -> [f64; 4] {
    let mut variables = [Dual64::from(0.0); 5];
    variables[variable].eps = 1.0;
    let [y, yaw, yaw_rate, sideslip, steering] = variables;
    let state = SingleTrackState {
        x: Dual64::from(0.0),
        y,
        yaw,
        yaw_rate,
        sideslip,
    };
    let speed = Dual64::from(speed);
    let lateral = SingleTrack::new(*vehicle).lateral(&state.lateral_motion(speed, steering));
    let rate = state.derivative::<DualFunctions>(speed, lateral);
    [rate.y, rate.yaw, rate.yaw_rate, rate.sideslip].map(|rate| rate.eps)
}

/// How old, at the tick, the values are that the law takes for the present ones, in s.
///
/// A sample of the yaw rate waits for the board's telemetry, passes the serial line, and waits for the
/// tick; the pilot's estimator goes on from there by the steering that was sent, and what it gives acts
/// as a younger one. Yaw and the velocity of G are predicted to the tick; their angle is the sideslip.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Ages {
    /// Age of the yaw rate, in s.
    pub yaw_rate: f64,
    /// Age of the sideslip, in s.
    pub sideslip: f64,
}

/// A delay in whole ticks and the rest, in s.
#[derive(Clone, Copy)]
pub(super) struct Delay {
    pub(super) ticks: usize,
    pub(super) late: f64,
}

impl Delay {
    pub(super) fn new(delay: f64, period: f64) -> Self {
        let ticks = (delay / period + 1e-9) as usize;
        Self {
            ticks,
            late: (delay - ticks as f64 * period).max(0.0),
        }
    }
}

/// A steering servo: a dead time, then a lag of first order.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Servo {
    /// Time constant of the lag, in s.
    pub lag: f64,
    /// From a command at the servo until the wheels begin to move, in s.
    pub dead_time: f64,
}

/// A controller that evaluates the law at the predicted state: the one at which its command
/// will act, `delay + lag` after the tick.
///
/// It knows the commands that are under way and runs them through its models of the servo and
/// of the car.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Prediction {
    /// The lag of the servo as modelled, in s.
    pub lag: f64,
    /// From a tick until its command moves the wheels, as modelled, in s: the delay of the
    /// loop and the dead time of the servo.
    pub delay: f64,
    /// The car as modelled.
    pub vehicle: VehicleParameters,
}

impl Prediction {
    /// How far it looks ahead, in s.
    pub fn horizon(&self) -> f64 {
        self.delay + self.lag
    }
}

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
        seen.set_row(STEERING, &end.wheels.transpose());
        seen
    }

    /// The change of the command for each rad/s of the wheels, in s.
    pub(super) fn lead(&self, period: f64) -> f64 {
        period / (1.0 - libm::exp(-period / self.servo.lag))
    }
}
