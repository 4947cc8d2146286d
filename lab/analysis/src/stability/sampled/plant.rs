//! The linearised car between two ticks, under an input that is held, and its servo.

use nalgebra::{DMatrix, DVector};
use num_dual::Dual64;
use singletrack_control::{SingleTrack, SingleTrackState, VehicleParameters};

use crate::dual::DualFunctions;

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
