//! References: the velocity is the derivative of the position, and steps begin at their
//! times.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test may fail")]

use singletrack_control::{
    Circle, FigureOfEight, Position, Reference, ReferenceError, Velocity, VelocityStep,
    VelocitySteps, Waypoint, Waypoints,
};

fn assert_velocity_is_the_derivative(reference: &Reference, times: impl Iterator<Item = f64>) {
    let h = 1e-6;
    for time in times {
        let position = |t| reference.at(t).position.unwrap();
        let slope = (position(time + h) - position(time - h)) / (2.0 * h);
        let error = (slope - reference.at(time).velocity).norm();
        assert!(error < 1e-6, "t = {time}: off by {error}");
    }
}

fn tenths(count: u32) -> impl Iterator<Item = f64> {
    (1..count).map(|tenth| f64::from(tenth) * 0.1 + 0.013)
}

#[test]
fn a_circle_starts_on_the_x_axis_and_its_velocity_is_the_derivative() {
    let circle = Circle::new(Position::new(1.0, 2.0), 0.8, -0.5).unwrap();
    let reference = Reference::Circle(circle);
    assert_eq!(reference.at(0.0).position, Some(Position::new(1.8, 2.0)));
    assert_velocity_is_the_derivative(&reference, tenths(200));
}

#[test]
fn the_velocity_of_a_figure_of_eight_is_the_derivative() {
    let figure = FigureOfEight::new(Position::new(0.2, 0.0), 1.2, 0.5, 0.4).unwrap();
    assert_velocity_is_the_derivative(&Reference::FigureOfEight(figure), tenths(200));
}

#[test]
fn waypoints_are_passed_at_their_times_and_the_last_one_is_held() {
    let at = |time, x, y| Waypoint {
        time,
        position: Position::new(x, y),
    };
    let reference = Reference::Waypoints(
        Waypoints::new(&[at(1.0, 0.0, 0.0), at(3.0, 1.0, 0.0), at(4.0, 1.0, 2.0)]).unwrap(),
    );
    for (time, x, y) in [
        (0.0, 0.0, 0.0),
        (1.0, 0.0, 0.0),
        (2.0, 0.5, 0.0),
        (3.0, 1.0, 0.0),
        (3.5, 1.0, 1.0),
        (9.0, 1.0, 2.0),
    ] {
        assert_eq!(reference.at(time).position, Some(Position::new(x, y)));
    }
    assert_eq!(reference.at(0.5).velocity, Velocity::zeros());
    assert_eq!(reference.at(3.0).velocity, Velocity::new(0.0, 2.0));
    assert_eq!(reference.before(3.0).velocity, Velocity::new(0.5, 0.0));
    assert_eq!(reference.at(9.0).velocity, Velocity::zeros());
    assert_eq!(reference.next_switch(1.0), Some(3.0));
    assert_eq!(reference.duration(), Some(4.0));
}

#[test]
fn a_velocity_step_starts_at_the_sum_of_the_earlier_durations_despite_rounding() {
    let step = |duration, x| VelocityStep {
        duration,
        velocity: Velocity::new(x, 0.0),
    };
    // 0.1 + 0.2 is above 0.3 in floating point, and tick 30 is at 0.3.
    let steps = VelocitySteps::new(&[step(0.1, 1.0), step(0.2, 2.0), step(0.3, 3.0)]).unwrap();
    let reference = Reference::VelocitySteps(steps.clone());
    for (time, x) in [
        (0.0, 1.0),
        (0.09, 1.0),
        (0.1, 2.0),
        (0.29, 2.0),
        (0.3, 3.0),
        (0.6, 3.0),
        (7.0, 3.0),
    ] {
        assert_eq!(reference.at(time).velocity.x, x, "t = {time}");
    }
    assert_eq!(reference.before(0.3).velocity.x, 2.0);
    let integral = steps.integrate(Position::new(1.0, 1.0), 0.5);
    assert!((integral - Position::new(2.1, 1.0)).norm() < 1e-12);
}

#[test]
fn invalid_references_are_refused_with_the_key() {
    let centre = Position::origin();
    assert!(matches!(
        Circle::new(centre, 0.0, 0.5),
        Err(ReferenceError::NotPositive {
            name: "radius_m",
            ..
        })
    ));
    assert!(Circle::new(centre, 1.0, f64::NAN).is_err());
    assert!(VelocitySteps::new(&[]).is_err());
    let point = |time| Waypoint {
        time,
        position: centre,
    };
    assert!(matches!(
        Waypoints::new(&[point(0.0), point(1.0), point(1.0)]),
        Err(ReferenceError::TimeNotIncreasing { index: 2, .. })
    ));
    assert!(Waypoints::new(&[point(0.0)]).is_err());
}
