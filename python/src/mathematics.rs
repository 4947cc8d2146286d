//! Models, laws and stability, for arrays of states.

use numpy::{
    PyArray1, PyArray2, PyReadonlyArray1, PyReadonlyArray2,
    ndarray::{Array2, ArrayView1},
};
use pyo3::{exceptions::PyValueError, prelude::*, types::PyDict};
use singletrack_analysis::stability::{
    self, Belief, ClosedLoop, Criticality, Law, MarginLimits, SampledLoop,
};
use singletrack_control::{
    FrontPointLaw, LateralMotion, Libm, Motion, RelaxedSingleTrack, SingleTrack,
    SingleTrackDerivative, SingleTrackState, Tyres, VehicleParameters, Velocity, VelocityPointLaw,
};

/// `[mass, yaw inertia, l_f, l_r, friction, C_f, C_r]`.
type Vehicle = [f64; 7];

/// Real and imaginary parts.
type RealAndImaginary<'py> = (Bound<'py, PyArray1<f64>>, Bound<'py, PyArray1<f64>>);

fn refuse(error: impl ToString) -> PyErr {
    PyValueError::new_err(error.to_string())
}

fn vehicle(values: Vehicle) -> PyResult<VehicleParameters> {
    let [
        mass_kg,
        yaw_inertia_kg_m2,
        front_axle_distance_m,
        rear_axle_distance_m,
        friction,
        front_cornering_stiffness_n_rad,
        rear_cornering_stiffness_n_rad,
    ] = values;
    let vehicle = VehicleParameters {
        mass_kg,
        yaw_inertia_kg_m2,
        front_axle_distance_m,
        rear_axle_distance_m,
        friction,
        front_cornering_stiffness_n_rad,
        rear_cornering_stiffness_n_rad,
    };
    vehicle.validate().map_err(refuse)?;
    Ok(vehicle)
}

/// The parameters of the paper's car.
#[pyfunction]
pub(crate) fn paper_vehicle() -> Vehicle {
    let paper = VehicleParameters::paper();
    [
        paper.mass_kg,
        paper.yaw_inertia_kg_m2,
        paper.front_axle_distance_m,
        paper.rear_axle_distance_m,
        paper.friction,
        paper.front_cornering_stiffness_n_rad,
        paper.rear_cornering_stiffness_n_rad,
    ]
}

/// One of the vehicle models.
enum Model {
    Linear(SingleTrack),
    Saturating(singletrack_control::Axles),
    Relaxed(RelaxedSingleTrack),
}

impl Model {
    fn new(kind: &str, vehicle: VehicleParameters) -> PyResult<Self> {
        Ok(match kind {
            "linear" => Self::Linear(SingleTrack::new(vehicle)),
            "saturating" => {
                Self::Saturating(singletrack_control::Axles::new(vehicle, Tyres::Saturating))
            }
            "relaxed" => Self::Relaxed(RelaxedSingleTrack::new(vehicle)),
            other => {
                return Err(refuse(format!(
                    "model is {other:?}: use \"linear\", \"saturating\" or \"relaxed\""
                )));
            }
        })
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
                state.derivative::<Libm>(speed, axles.lateral(&motion, &forces))
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
    parameters: Vehicle,
    states: PyReadonlyArray2<'py, f64>,
    speed: PyReadonlyArray1<'py, f64>,
    steering: PyReadonlyArray1<'py, f64>,
) -> PyResult<Bound<'py, PyArray2<f64>>> {
    let model = Model::new(kind, vehicle(parameters)?)?;
    let states = states.as_array();
    let mut derivatives = Array2::zeros((states.nrows(), 5));
    let inputs = speed
        .as_array()
        .to_vec()
        .into_iter()
        .zip(steering.as_array().to_vec());
    for ((index, row), (speed, steering)) in states.outer_iter().enumerate().zip(inputs) {
        let d = model.derivative(&state(row)?, speed, steering);
        write(
            &mut derivatives,
            index,
            [d.x, d.y, d.yaw, d.yaw_rate, d.sideslip],
        );
    }
    Ok(PyArray2::from_owned_array(py, derivatives))
}

/// The states of a car from a start, one more than there are inputs. Each input holds for
/// `period` s, which is integrated in steps of at most 1 ms.
#[pyfunction]
pub(crate) fn model_simulate<'py>(
    py: Python<'py>,
    kind: &str,
    parameters: Vehicle,
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
    let model = Model::new(kind, vehicle(parameters)?)?;
    let mut now = state(start.as_array())?;
    let speed = speed.as_array().to_vec();
    let steering = steering.as_array().to_vec();
    let states = py.detach(|| {
        let steps = (period / 1e-3).ceil().max(1.0);
        let mut states = Array2::zeros((speed.len() + 1, 5));
        write(
            &mut states,
            0,
            [now.x, now.y, now.yaw, now.yaw_rate, now.sideslip],
        );
        for (index, (speed, steering)) in speed.iter().zip(steering).enumerate() {
            for _ in 0..steps as u32 {
                now = model.step(&now, *speed, steering, period / steps);
            }
            write(
                &mut states,
                index + 1,
                [now.x, now.y, now.yaw, now.yaw_rate, now.sideslip],
            );
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
    parameters: Vehicle,
) -> PyResult<(f64, f64)> {
    let law = VelocityPointLaw::new(vehicle(parameters)?, point_distance).map_err(refuse)?;
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
    let centre = singletrack_control::Position::new(x, y);
    let point = singletrack_control::front_point(
        centre,
        yaw,
        steering,
        front_axle_distance,
        point_distance,
    );
    (point.x, point.y)
}

fn law_of(name: &str) -> PyResult<Law> {
    match name {
        "front-point" => Ok(Law::FrontPoint),
        "velocity-point" => Ok(Law::VelocityPoint),
        other => Err(refuse(format!(
            "law is {other:?}: use \"front-point\" or \"velocity-point\""
        ))),
    }
}

fn belief_of(name: &str) -> PyResult<Belief> {
    match name {
        "centre-of-mass" => Ok(Belief::CentreOfMass),
        "front-axle" => Ok(Belief::FrontAxle),
        other => Err(refuse(format!(
            "belief is {other:?}: use \"centre-of-mass\" or \"front-axle\""
        ))),
    }
}

fn closed_loop(
    parameters: Vehicle,
    law: &str,
    belief: &str,
    point_distance: f64,
    speed: f64,
    deviation: f64,
) -> PyResult<ClosedLoop> {
    let vehicle = vehicle(parameters)?;
    let closed = ClosedLoop::new(vehicle, law_of(law)?, point_distance, speed, deviation);
    Ok(closed.map_err(refuse)?.believing(belief_of(belief)?))
}

/// Real and imaginary parts of the eigenvalues of the steady motion.
#[pyfunction]
pub(crate) fn eigenvalues<'py>(
    py: Python<'py>,
    parameters: Vehicle,
    law: &str,
    belief: &str,
    point_distance: f64,
    speed: f64,
    deviation: f64,
) -> PyResult<RealAndImaginary<'py>> {
    let closed = closed_loop(parameters, law, belief, point_distance, speed, deviation)?;
    let values = closed.eigenvalues();
    Ok((
        PyArray1::from_iter(py, values.iter().map(|value| value.re)),
        PyArray1::from_iter(py, values.iter().map(|value| value.im)),
    ))
}

/// Whether the steady motion is stable.
#[pyfunction]
pub(crate) fn is_stable(
    parameters: Vehicle,
    law: &str,
    belief: &str,
    point_distance: f64,
    speed: f64,
    deviation: f64,
) -> PyResult<bool> {
    let closed = closed_loop(parameters, law, belief, point_distance, speed, deviation)?;
    Ok(closed.is_stable())
}

/// The speed up to which the proposed law is stable.
#[pyfunction]
pub(crate) fn critical_speed(
    parameters: Vehicle,
    point_distance: f64,
    deviations: [f64; 2],
) -> PyResult<Option<f64>> {
    stability::critical_speed(vehicle(parameters)?, point_distance, deviations).map_err(refuse)
}

/// The smallest p that is stable at every speed.
#[pyfunction]
pub(crate) fn smallest_point_distance(
    parameters: Vehicle,
    deviations: [f64; 2],
) -> PyResult<Option<f64>> {
    stability::smallest_point_distance(vehicle(parameters)?, deviations).map_err(refuse)
}

/// The Hopf points over the deviation of the centre of mass.
#[pyfunction]
pub(crate) fn hopf_points<'py>(
    py: Python<'py>,
    parameters: Vehicle,
    law: &str,
    belief: &str,
    point_distance: f64,
    speed: f64,
) -> PyResult<Vec<Bound<'py, PyDict>>> {
    let points = stability::hopf_points(
        vehicle(parameters)?,
        law_of(law)?,
        belief_of(belief)?,
        point_distance,
        speed,
    )
    .map_err(refuse)?;
    points
        .into_iter()
        .map(|point| {
            let row = PyDict::new(py);
            row.set_item("speed", point.speed)?;
            row.set_item("deviation", point.deviation)?;
            row.set_item("angular_frequency", point.angular_frequency)?;
            row.set_item("crossing", point.crossing)?;
            row.set_item("ends_stability", point.ends_stability())?;
            let criticality = match point.criticality() {
                Criticality::Supercritical => "supercritical",
                Criticality::Subcritical => "subcritical",
                Criticality::Degenerate => "degenerate",
            };
            row.set_item("criticality", criticality)?;
            Ok(row)
        })
        .collect()
}

/// Spectral radius per tick of the sampled loop, and its delay margin in s.
#[pyfunction]
#[expect(clippy::too_many_arguments, reason = "keywords of Python")]
pub(crate) fn sampled(
    parameters: Vehicle,
    law: &str,
    belief: &str,
    point_distance: f64,
    speed: f64,
    deviation: f64,
    period: f64,
    delay: f64,
    position_gain: f64,
    longest_delay: f64,
) -> PyResult<(f64, Option<f64>)> {
    let closed = closed_loop(parameters, law, belief, point_distance, speed, deviation)?;
    let sampled = SampledLoop::new(closed, period, delay)
        .and_then(|sampled| sampled.with_position_gain(position_gain))
        .map_err(refuse)?;
    let limits = MarginLimits {
        delay: longest_delay,
        ..MarginLimits::default()
    };
    Ok((sampled.spectral_radius(1), sampled.delay_margin(limits)))
}
