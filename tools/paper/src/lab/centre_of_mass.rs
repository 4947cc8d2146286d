//! Lab 2: what a wrong centre of mass does.

use singletrack_analysis::stability::{
    Belief, ClosedLoop, Law, hopf_points, smallest_point_distance,
};
use singletrack_control::VehicleParameters;

use super::{
    error::LabError,
    exercise::{Exercise, Judge, Quantity},
    rig::{CircleDrive, POINT_DISTANCE, way_off_after_turn},
    student::{Student, grid},
};

const LAB: u8 = 2;

pub(super) fn exercises(student: &Student) -> Vec<Exercise> {
    let number = |name, grid| student.number(LAB, name, grid);
    let car = VehicleParameters {
        mass_kg: number("mass", grid(1.6, 0.1, 9)),
        front_cornering_stiffness_n_rad: number("front", grid(48.0, 2.0, 11)),
        ..VehicleParameters::paper()
    };
    let VehicleParameters {
        mass_kg: mass,
        front_cornering_stiffness_n_rad: front,
        ..
    } = car;
    let speed = number("speed", grid(0.6, 0.1, 10));
    let fast = number("fast", grid(1.0, 0.25, 9));
    let deviation = number("deviation", grid(0.02, 0.005, 13));
    let other = number("other", grid(-0.1, 0.01, 8));
    let angle_deg = number("angle", grid(40.0, 10.0, 9));
    let radius = number("radius", grid(0.9, 0.05, 7));
    vec![
        Exercise {
            id: "2.1",
            points: 3,
            text: format!(
                "Your car is that of tools/vehicles/paper.toml with a mass of {mass} kg and a front \
                 cornering stiffness of {front} N/rad.\nUnder the law of the appendix, at {speed} m/s: how \
                 far behind its true place may the law assume\nthe centre of mass before the steady motion \
                 is lost? (dl > 0; the belief is --wrong centre-of-mass)"
            ),
            quantities: vec![Quantity { key: "tolerated_dl_mm", unit: "mm" }],
            hint: "Copy the vehicle's file, change the two numbers, and look for the Hopf point with \
                   `singletrack stability hopf --law velocity-point --vehicle FILE --speeds A:B:STEP`.",
            judge: Judge::Number {
                truth: Box::new(move || tolerated(car, speed)),
                tolerance: 0.02,
            },
        },
        Exercise {
            id: "2.2",
            points: 3,
            text: "The same car under the proposed law: beyond which distance p is the ideal car stable at \
                   every speed,\nwherever between its axles the law assumes the centre of mass?"
                .to_owned(),
            quantities: vec![Quantity { key: "least_p_m", unit: "m" }],
            hint: "`singletrack stability summary --vehicle FILE` says it for your car in words. Which \
                   end of the range decides?",
            judge: Judge::Number {
                truth: Box::new(move || {
                    let range = [-car.front_axle_distance_m, car.rear_axle_distance_m];
                    smallest_point_distance(car, range)?.ok_or(LabError::NotFound("least p"))
                }),
                tolerance: 0.01,
            },
        },
        Exercise {
            id: "2.3",
            points: 2,
            text: format!(
                "The same car under the proposed law with p = {POINT_DISTANCE} m at {fast} m/s, and dl = {other} \
                 m.\nHow large is the largest real part of the eigenvalues? (It is negative, or zero at most.)"
            ),
            quantities: vec![Quantity { key: "largest_real_part_per_s", unit: "1/s" }],
            hint: "`singletrack stability eigenvalues` prints all of them; the one nearest to the \
                   imaginary axis decides how fast disturbances decay.",
            judge: Judge::Number {
                truth: Box::new(move || {
                    let at = ClosedLoop::new(car, Law::FrontPoint, POINT_DISTANCE, fast, other)?;
                    let found = at.eigenvalues();
                    Ok(found.iter().fold(f64::NEG_INFINITY, |most, value| most.max(value.re)))
                }),
                tolerance: 0.02,
            },
        },
        Exercise {
            id: "2.4",
            points: 3,
            text: format!(
                "The paper's car, ideal, on a circle of {radius} m at 0.5 rad/s with feed-forward and a gain \
                 of 1 1/s.\nThe law has the front axle {deviation} m too far ahead of the point whose pose it gets \
                 (front_axle_distance_m).\nHow far is the true P from its reference, when it has settled?"
            ),
            quantities: vec![Quantity { key: "way_off_on_circle_m", unit: "m" }],
            hint: "Stable is not accurate. Which point of the car is on the reference, and where is \
                   the true P from there?",
            judge: Judge::Number {
                truth: Box::new(move || {
                    let drive = CircleDrive {
                        feed_forward: true,
                        deviation,
                        ..CircleDrive::ideal(radius, 0.5, 1.0)
                    };
                    Ok(drive.tracking()?.rms_error_m)
                }),
                tolerance: 0.02,
            },
        },
        Exercise {
            id: "2.5",
            points: 3,
            text: format!(
                "The same law on the same car, without a position loop: P is given a velocity along x, whose \
                 direction then turns\n{angle_deg} degrees to the left, in steps that the car follows. How far is P \
                 from where the velocities lead, at the end?"
            ),
            quantities: vec![Quantity { key: "way_off_after_turn_m", unit: "m" }],
            hint: "The point that the law moves is exact all the time. The true P is at a fixed distance \
                   from it, in a direction that turns with the car.",
            judge: Judge::Number {
                truth: Box::new(move || way_off_after_turn(angle_deg.to_radians(), deviation)),
                tolerance: 0.02,
            },
        },
    ]
}

/// The least positive dl at which stability ends under the law of the appendix, in mm.
fn tolerated(car: VehicleParameters, speed: f64) -> Result<f64, LabError> {
    let points = hopf_points(
        car,
        Law::VelocityPoint,
        Belief::CentreOfMass,
        POINT_DISTANCE,
        speed,
    )?;
    let least = points
        .iter()
        .map(|point| point.deviation)
        .filter(|deviation| *deviation > 0.0)
        .fold(f64::INFINITY, f64::min);
    if least.is_finite() {
        Ok(1e3 * least)
    } else {
        Err(LabError::NotFound("Hopf point"))
    }
}
