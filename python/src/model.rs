//! Vehicle models, for arrays of states, and the laws.

use numpy::{
    PyArray2, PyReadonlyArray1, PyReadonlyArray2,
    ndarray::{Array2, ArrayView1},
};
use pyo3::prelude::*;
use singletrack_control::{
    Axles, FrontPointLaw, LateralMotion, Libm, Motion, Position, RelaxedSingleTrack, SingleTrack,
    SingleTrackDerivative, SingleTrackState, Tyres, VehicleParameters, Velocity, VelocityPointLaw,
};

use crate::setup::{choice, refuse};

/// The parameters of a car: Python's `Vehicle` has fields of the same names.
macro_rules! vehicle {
    ($($name:ident),+ $(,)?) => {
        /// Python's `Vehicle`.
        #[derive(FromPyObject)]
        pub(crate) struct Vehicle {
            $($name: f64,)+
        }

        impl Vehicle {
            /// The checked parameters.
            pub(crate) fn parameters(&self) -> PyResult<VehicleParameters> {
                let vehicle = VehicleParameters { $($name: self.$name,)+ };
                vehicle.validate().map_err(refuse)?;
                Ok(vehicle)
            }
        }

        /// The names and values of the paper's car.
        #[pyfunction]
        pub(crate) fn paper_vehicle() -> Vec<(&'static str, f64)> {
            let paper = VehicleParameters::paper();
            vec![$((stringify!($name), paper.$name),)+]
        }
    };
}

vehicle!(
    mass_kg,
    yaw_inertia_kg_m2,
    front_axle_distance_m,
    rear_axle_distance_m,
    friction,
    front_cornering_stiffness_n_rad,
    rear_cornering_stiffness_n_rad,
);

/// One of the vehicle models.
#[derive(Clone, Copy)]
enum Model {
    Linear(SingleTrack),
    Saturating(Axles),
    Relaxed(RelaxedSingleTrack),
}

impl Model {
    fn new(kind: &str, vehicle: &Vehicle) -> PyResult<Self> {
        let car = vehicle.parameters()?;
        choice(
            "model",
            kind,
            &[
                ("linear", Self::Linear(SingleTrack::new(car))),
                (
                    "saturating",
                    Self::Saturating(Axles::new(car, Tyres::Saturating)),
                ),
                ("relaxed", Self::Relaxed(RelaxedSingleTrack::new(car))),
            ],
        )
    }

    fn derivative(
        &self,
        state: &SingleTrackState,
        speed: f64,
        steering: f64,
    ) -> SingleTrackDerivative {
        match self {
            Self::Linear(model) => model.derivative(state, speed, steering),
            Self::Relaxed(model) => model.derivative(state, speed, steering),
            Self::Saturating(axles) => {
                let motion = LateralMotion {
                    yaw_rate: state.yaw_rate,
                    sideslip: state.sideslip,
                    speed,
                    steering,
                };
                let forces = axles.forces::<Libm, f64>(&motion);
                state.derivative::<Libm>(speed, axles.lateral::<Libm, f64>(&motion, &forces))
            }
        }
    }

    /// A step of the classic Runge-Kutta method.
    fn step(&self, s: &SingleTrackState, speed: f64, steering: f64, h: f64) -> SingleTrackState {
        let at = |d: &SingleTrackDerivative, h: f64| SingleTrackState {
            x: s.x + h * d.x,
            y: s.y + h * d.y,
            yaw: s.yaw + h * d.yaw,
            yaw_rate: s.yaw_rate + h * d.yaw_rate,
            sideslip: s.sideslip + h * d.sideslip,
        };
        let k1 = self.derivative(s, speed, steering);
        let k2 = self.derivative(&at(&k1, h / 2.0), speed, steering);
        let k3 = self.derivative(&at(&k2, h / 2.0), speed, steering);
        let k4 = self.derivative(&at(&k3, h), speed, steering);
        let mean = |f: fn(&SingleTrackDerivative) -> f64| {
            (f(&k1) + 2.0 * f(&k2) + 2.0 * f(&k3) + f(&k4)) / 6.0
        };
        at(
            &SingleTrackDerivative {
                x: mean(|d| d.x),
                y: mean(|d| d.y),
                yaw: mean(|d| d.yaw),
                yaw_rate: mean(|d| d.yaw_rate),
                sideslip: mean(|d| d.sideslip),
            },
            h,
        )
    }
}

fn state(row: ArrayView1<'_, f64>) -> PyResult<SingleTrackState> {
    match row.to_vec()[..] {
        [x, y, yaw, yaw_rate, sideslip] => Ok(SingleTrackState {
            x,
            y,
            yaw,
            yaw_rate,
            sideslip,
        }),
        _ => Err(refuse(
            "a state has five columns: x, y, yaw, yaw_rate, sideslip",
        )),
    }
}

const fn columns(state: &SingleTrackState) -> [f64; 5] {
    [state.x, state.y, state.yaw, state.yaw_rate, state.sideslip]
}

fn write(rows: &mut Array2<f64>, index: usize, values: [f64; 5]) {
    for (cell, value) in rows.row_mut(index).iter_mut().zip(values) {
        *cell = value;
    }
}

/// The derivative of each state.
#[pyfunction]
pub(crate) fn model_derivative<'py>(
    py: Python<'py>,
    kind: &str,
    vehicle: Vehicle,
    states: PyReadonlyArray2<'py, f64>,
    speed: PyReadonlyArray1<'py, f64>,
    steering: PyReadonlyArray1<'py, f64>,
) -> PyResult<Bound<'py, PyArray2<f64>>> {
    let model = Model::new(kind, &vehicle)?;
    let states = states.as_array();
    let mut derivatives = Array2::zeros((states.nrows(), 5));
    let inputs = speed
        .as_array()
        .to_vec()
        .into_iter()
        .zip(steering.as_array().to_vec());
    for ((index, row), (speed, steering)) in states.outer_iter().enumerate().zip(inputs) {
        let d = model.derivative(&state(row)?, speed, steering);
        let slope = [d.x, d.y, d.yaw, d.yaw_rate, d.sideslip];
        write(&mut derivatives, index, slope);
    }
    Ok(PyArray2::from_owned_array(py, derivatives))
}

/// The states of a car from a start, one more than there are inputs. Each input holds for
/// `period` s, which is integrated in steps of at most 1 ms.
#[pyfunction]
pub(crate) fn model_simulate<'py>(
    py: Python<'py>,
    kind: &str,
    vehicle: Vehicle,
    start: PyReadonlyArray1<'py, f64>,
    speed: PyReadonlyArray1<'py, f64>,
    steering: PyReadonlyArray1<'py, f64>,
    period: f64,
) -> PyResult<Bound<'py, PyArray2<f64>>> {
    if !(period > 0.0 && period <= 10.0) {
        return Err(refuse(format!(
            "the period is {period} s: it must be above zero and at most 10"
        )));
    }
    let model = Model::new(kind, &vehicle)?;
    let mut now = state(start.as_array())?;
    let speed = speed.as_array().to_vec();
    let steering = steering.as_array().to_vec();
    let states = py.detach(|| {
        let steps = (period / 1e-3).ceil().max(1.0);
        let mut states = Array2::zeros((speed.len() + 1, 5));
        write(&mut states, 0, columns(&now));
        for (index, (speed, steering)) in speed.iter().zip(steering).enumerate() {
            for _ in 0..steps as u32 {
                now = model.step(&now, *speed, steering, period / steps);
            }
            write(&mut states, index + 1, columns(&now));
        }
        states
    });
    Ok(PyArray2::from_owned_array(py, states))
}

/// Speed and steering rate of the proposed law.
#[pyfunction]
#[expect(clippy::too_many_arguments, reason = "keywords of Python")]
pub(crate) fn front_point(
    yaw: f64,
    yaw_rate: f64,
    sideslip: f64,
    steering: f64,
    velocity: [f64; 2],
    point_distance: f64,
    front_axle_distance: f64,
    wheelbase: f64,
) -> PyResult<(f64, f64)> {
    let law = FrontPointLaw::new(front_axle_distance, point_distance, wheelbase).map_err(refuse)?;
    let motion = Motion {
        yaw,
        yaw_rate,
        sideslip,
    };
    let command = law
        .command(&motion, steering, &Velocity::from(velocity))
        .map_err(refuse)?;
    Ok((command.speed, command.steering_rate))
}

/// Speed and steering angle of the law of the appendix.
#[pyfunction]
pub(crate) fn velocity_point(
    yaw: f64,
    yaw_rate: f64,
    sideslip: f64,
    velocity: [f64; 2],
    point_distance: f64,
    vehicle: Vehicle,
) -> PyResult<(f64, f64)> {
    let law = VelocityPointLaw::new(vehicle.parameters()?, point_distance).map_err(refuse)?;
    let motion = Motion {
        yaw,
        yaw_rate,
        sideslip,
    };
    let command = law
        .command(&motion, &Velocity::from(velocity))
        .map_err(refuse)?;
    Ok((command.speed, command.steering))
}

/// P for a state of the car.
#[pyfunction]
pub(crate) fn point_p(
    x: f64,
    y: f64,
    yaw: f64,
    steering: f64,
    front_axle_distance: f64,
    point_distance: f64,
) -> (f64, f64) {
    let centre = Position::new(x, y);
    let point = singletrack_control::front_point(
        centre,
        yaw,
        steering,
        front_axle_distance,
        point_distance,
    );
    (point.x, point.y)
}
