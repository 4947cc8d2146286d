//! The laws.

use pyo3::prelude::*;
use singletrack_control::{FrontPointLaw, Motion, Position, Velocity, VelocityPointLaw};

use crate::{argument::refuse, model::Vehicle};

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
