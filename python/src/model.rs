//! Vehicle models, for arrays of states, and the laws.

use core::array::from_fn;

use numpy::{
    PyArray2, PyReadonlyArray1, PyReadonlyArray2,
    ndarray::{Array2, ArrayView1},
};
use pyo3::prelude::*;
use pythonize::{depythonize, pythonize};
use singletrack_control::{
    self as control, Axles, FrontPointLaw, LateralMotion, Libm, Motion, Position,
    RelaxedSingleTrack, SingleTrack, SingleTrackState, Tyres, VehicleParameters, Velocity,
    VelocityPointLaw,
};

use crate::{choice, refuse};

/// The checked parameters of a car: the fields of Python's `Vehicle`.
pub(crate) fn parameters(vehicle: &Bound<'_, PyAny>) -> PyResult<VehicleParameters> {
    let vehicle: VehicleParameters = depythonize(&vehicle.getattr("__dict__")?)?;
    vehicle.validate().map_err(refuse)?;
    Ok(vehicle)
}

/// The names and values of the paper's car.
#[pyfunction]
pub(crate) fn paper_vehicle(py: Python<'_>) -> PyResult<Bound<'_, PyAny>> {
    Ok(pythonize(py, &VehicleParameters::paper())?)
}

/// x, y, yaw, yaw rate and sideslip, or their derivatives.
type Columns = [f64; 5];

/// One of the vehicle models.
#[derive(Clone, Copy)]
enum Model {
    Linear(SingleTrack),
    Saturating(Axles),
    Relaxed(RelaxedSingleTrack),
}

impl Model {
    fn new(kind: &str, vehicle: &Bound<'_, PyAny>) -> PyResult<Self> {
        let car = parameters(vehicle)?;
        let saturating = Axles::new(car, Tyres::Saturating);
        let models = [
            ("linear", Self::Linear(SingleTrack::new(car))),
            ("saturating", Self::Saturating(saturating)),
            ("relaxed", Self::Relaxed(RelaxedSingleTrack::new(car))),
        ];
        choice("model", kind, &models)
    }

    fn derivative(
        &self,
        [x, y, yaw, yaw_rate, sideslip]: Columns,
        speed: f64,
        steering: f64,
    ) -> Columns {
        let state = SingleTrackState {
            x,
            y,
            yaw,
            yaw_rate,
            sideslip,
        };
        let slope = match self {
            Self::Linear(model) => model.derivative(&state, speed, steering),
            Self::Relaxed(model) => model.derivative(&state, speed, steering),
            Self::Saturating(axles) => {
                let motion = LateralMotion {
                    yaw_rate,
                    sideslip,
                    speed,
                    steering,
                };
                let forces = axles.forces::<Libm, f64>(&motion);
                state.derivative::<Libm>(speed, axles.lateral::<Libm, f64>(&motion, &forces))
            }
        };
        [slope.x, slope.y, slope.yaw, slope.yaw_rate, slope.sideslip]
    }

    /// A step of the classic Runge-Kutta method.
    fn step(&self, state: Columns, speed: f64, steering: f64, h: f64) -> Columns {
        let at = |slope: Columns, h: f64| -> Columns { from_fn(|i| state[i] + h * slope[i]) };
        let slope = |state: Columns| self.derivative(state, speed, steering);
        let k1 = slope(state);
        let k2 = slope(at(k1, h / 2.0));
        let k3 = slope(at(k2, h / 2.0));
        let k4 = slope(at(k3, h));
        let mean = from_fn(|i| (k1[i] + 2.0 * k2[i] + 2.0 * k3[i] + k4[i]) / 6.0);
        at(mean, h)
    }
}

fn columns(row: ArrayView1<'_, f64>) -> PyResult<Columns> {
    let wrong = "a state has five columns: x, y, yaw, yaw_rate, sideslip";
    row.to_vec().try_into().map_err(|_| refuse(wrong))
}

/// The derivative of each state.
#[pyfunction]
pub(crate) fn model_derivative<'py>(
    py: Python<'py>,
    kind: &str,
    vehicle: &Bound<'py, PyAny>,
    states: PyReadonlyArray2<'py, f64>,
    speed: PyReadonlyArray1<'py, f64>,
    steering: PyReadonlyArray1<'py, f64>,
) -> PyResult<Bound<'py, PyArray2<f64>>> {
    let model = Model::new(kind, vehicle)?;
    let (states, speed, steering) = (states.as_array(), speed.as_array(), steering.as_array());
    let inputs = speed.iter().zip(&steering);
    let slopes: PyResult<Vec<Columns>> = states
        .outer_iter()
        .zip(inputs)
        .map(|(row, (speed, steering))| Ok(model.derivative(columns(row)?, *speed, *steering)))
        .collect();
    Ok(PyArray2::from_owned_array(py, Array2::from(slopes?)))
}

/// The states of a car from a start, one more than there are inputs. Each input holds for
/// `period` s, which is integrated in steps of at most 1 ms.
#[pyfunction]
pub(crate) fn model_simulate<'py>(
    py: Python<'py>,
    kind: &str,
    vehicle: &Bound<'py, PyAny>,
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
    let model = Model::new(kind, vehicle)?;
    let mut now = columns(start.as_array())?;
    let (speed, steering) = (speed.as_array().to_vec(), steering.as_array().to_vec());
    let states = py.detach(|| {
        let steps = (period / 1e-3).ceil().max(1.0);
        let mut states = vec![now];
        for (speed, steering) in speed.into_iter().zip(steering) {
            for _ in 0..steps as u32 {
                now = model.step(now, speed, steering, period / steps);
            }
            states.push(now);
        }
        states
    });
    Ok(PyArray2::from_owned_array(py, Array2::from(states)))
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
    vehicle: &Bound<'_, PyAny>,
) -> PyResult<(f64, f64)> {
    let law = VelocityPointLaw::new(parameters(vehicle)?, point_distance).map_err(refuse)?;
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
    let (front, centre) = (front_axle_distance, Position::new(x, y));
    let point = control::front_point(centre, yaw, steering, front, point_distance);
    (point.x, point.y)
}
