//! References: the velocity is the derivative of the position, and steps begin at their
//! times.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test may fail")]

use singletrack_control::{
    Circle, FigureOfEight, Path, PathSpeed, Position, Reference, ReferenceError, Start, Velocity,
    VelocityStep, VelocitySteps, Waypoint, Waypoints, direction,
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
        Err(ReferenceError::NotPositive("radius_m", _))
    ));
    assert!(Circle::new(centre, 1.0, f64::NAN).is_err());
    assert!(VelocitySteps::new(&[]).is_err());
    let point = |time| Waypoint {
        time,
        position: centre,
    };
    assert!(matches!(
        Waypoints::new(&[point(0.0), point(1.0), point(1.0)]),
        Err(ReferenceError::TimeNotIncreasing(2, _))
    ));
    assert!(Waypoints::new(&[point(0.0)]).is_err());
}

const SPEED: PathSpeed = PathSpeed {
    speed: 0.8,
    lateral_acceleration: 0.6,
    acceleration: 0.5,
};

/// Points on a circle of radius 0.5 m, which is within a lateral acceleration of 0.6 m/s² up
/// to 0.548 m/s.
fn round(count: u32) -> Vec<Position> {
    (0..count)
        .map(|index| {
            let angle = std::f64::consts::TAU * f64::from(index) / f64::from(count);
            Position::new(0.5 * angle.cos(), 0.5 * angle.sin())
        })
        .collect()
}

/// A winding path with points at unequal distances.
fn winding() -> Vec<Position> {
    [0.0, 0.3, 0.45, 0.9, 1.3, 1.4, 1.9, 2.5, 2.8, 3.4]
        .into_iter()
        .map(|x: f64| Position::new(x, 0.25 * (2.2 * x).sin()))
        .collect()
}

#[test]
fn a_path_passes_every_point_and_its_velocity_is_the_derivative() {
    for (points, is_closed) in [(winding(), false), (round(12), true)] {
        let path = Path::new(&points, is_closed, SPEED).unwrap();
        let lap = path.lap_time();
        let reference = Reference::Path(path);
        for point in &points {
            let nearest = (0..20_000)
                .map(|part| reference.at(2.0 * lap * f64::from(part) / 20_000.0))
                .map(|at| (at.position.unwrap() - point).norm())
                .fold(f64::MAX, f64::min);
            assert!(nearest < 1e-3, "{point}: {nearest}");
        }
        assert_velocity_is_the_derivative(&reference, tenths((10.0 * lap) as u32 - 1));
    }
}

#[test]
fn the_speed_along_a_path_keeps_every_limit() {
    for (points, is_closed) in [(winding(), false), (round(40), true)] {
        let path = Path::new(&points, is_closed, SPEED).unwrap();
        let lap = path.lap_time();
        let reference = Reference::Path(path);
        let h = 1e-3;
        // The run-in of the closed path is over after its first seconds.
        let from = if is_closed { 5.0 } else { 0.0 };
        let mut fastest: f64 = 0.0;
        let mut most_lateral: f64 = 0.0;
        for part in 1..4_000 {
            let time = from + lap * f64::from(part) / 4_000.0;
            let velocity = reference.at(time).velocity;
            let change =
                (reference.at(time + h).velocity - reference.at(time - h).velocity) / (2.0 * h);
            let speed = velocity.norm();
            fastest = fastest.max(speed);
            assert!(speed <= SPEED.speed * 1.001, "{speed} m/s at {time} s");
            if speed > 0.05 && time < from + lap - 2.0 * h {
                let along = change.dot(&velocity) / speed;
                let lateral = velocity.perp(&change).abs() / speed;
                most_lateral = most_lateral.max(lateral);
                assert!(
                    along.abs() <= SPEED.acceleration * 1.05,
                    "{along} m/s2 at {time} s"
                );
                assert!(
                    lateral <= SPEED.lateral_acceleration * 1.03,
                    "{lateral} m/s2 at {time} s"
                );
            }
        }
        // It is not slower than the limits ask for.
        if is_closed {
            assert!((fastest - 0.3_f64.sqrt()).abs() < 0.005, "{fastest}");
        } else {
            assert!(fastest > 0.6, "{fastest}");
        }
        assert!(
            most_lateral > 0.9 * SPEED.lateral_acceleration,
            "{most_lateral}"
        );
    }
}

#[test]
fn an_open_path_begins_and_ends_at_rest_and_a_closed_one_has_no_end() {
    let open = Path::new(&winding(), false, SPEED).unwrap();
    let lap = open.lap_time();
    let open = Reference::Path(open);
    assert_eq!(open.at(0.0).velocity, Velocity::zeros());
    assert_eq!(open.duration(), Some(lap));
    let end = open.at(lap + 1.0);
    assert_eq!(end.velocity, Velocity::zeros());
    assert!((end.position.unwrap() - winding()[9]).norm() < 1e-9);

    let closed = Path::new(&round(40), true, SPEED).unwrap();
    let lap = closed.lap_time();
    let closed = Reference::Path(closed);
    assert_eq!(closed.duration(), None);
    assert_eq!(closed.at(0.0).velocity, Velocity::zeros());
    let (one, next) = (closed.at(50.0), closed.at(50.0 + lap));
    assert!((one.position.unwrap() - next.position.unwrap()).norm() < 1e-9);
    // No jump where the lap begins again.
    for part in 0..40_000 {
        let time = 3.0 * lap * f64::from(part) / 40_000.0;
        let step = closed.at(time + 1e-4).velocity - closed.at(time).velocity;
        assert!(step.norm() < 5e-4, "{step} at {time} s");
    }
}

#[test]
fn a_closed_path_does_not_depend_on_where_it_begins_or_on_a_repeated_point() {
    let points = round(12);
    let mut repeated = points.clone();
    repeated.push(points[0]);
    let path = Path::new(&points, true, SPEED).unwrap();
    assert_eq!(Path::new(&repeated, true, SPEED).unwrap(), path);
    let mut turned = points.clone();
    turned.rotate_left(5);
    let turned = Path::new(&turned, true, SPEED).unwrap();
    assert!((turned.lap_time() - path.lap_time()).abs() < 1e-3);
    // The spline through 12 points is within 0.1 mm of the circle.
    let reference = Reference::Path(turned);
    for time in tenths(100) {
        let radius = reference.at(time).position.unwrap().coords.norm();
        assert!((radius - 0.5).abs() < 5e-4, "{radius}");
    }
}

#[test]
fn a_path_that_cannot_be_driven_is_refused_with_the_point() {
    let at = |x, y| Position::new(x, y);
    let new = |points: &[Position], is_closed| Path::new(points, is_closed, SPEED);
    assert!(matches!(
        new(&[at(0.0, 0.0)], false),
        Err(ReferenceError::TooFew(.., 2))
    ));
    assert!(matches!(
        new(&[at(0.0, 0.0), at(1.0, 0.0), at(0.0, 0.0)], true),
        Err(ReferenceError::TooFew(.., 3))
    ));
    assert!(matches!(
        new(&[at(0.0, 0.0), at(0.001, 0.0), at(1.0, 0.0)], false),
        Err(ReferenceError::TooClose(1, _))
    ));
    // There and back again.
    assert!(matches!(
        new(&[at(0.0, 0.0), at(1.0, 0.0), at(0.0, 0.001)], false),
        Err(ReferenceError::TooSharp(..))
    ));
    assert!(matches!(
        new(&[at(0.0, 0.0), at(1.0, 0.0), at(0.0, 0.0)], false),
        Err(ReferenceError::TooSharp(..))
    ));
    let many: Vec<_> = (0..513).map(|index| at(f64::from(index), 0.0)).collect();
    assert!(matches!(
        new(&many, false),
        Err(ReferenceError::TooMany(_, 400))
    ));
    assert!(new(&many[..400], false).is_ok());
    assert!(new(&[at(0.0, 0.0), at(f64::NAN, 0.0)], false).is_err());
    let still = PathSpeed {
        speed: 0.0,
        ..SPEED
    };
    assert!(Path::new(&winding(), false, still).is_err());
}

/// Closed references of every kind.
fn closed() -> [Reference; 4] {
    let centre = Position::new(0.2, -0.1);
    let bean = [
        (0.0, 0.0),
        (1.0, 0.3),
        (2.0, 0.0),
        (1.8, 1.0),
        (1.0, 0.7),
        (0.1, 0.9),
    ];
    let bean = bean.map(|(x, y)| Position::new(x, y));
    [
        Reference::Circle(Circle::new(centre, 0.8, 0.5).unwrap()),
        Reference::Circle(Circle::new(centre, 1.3, -0.4).unwrap()),
        Reference::FigureOfEight(FigureOfEight::new(centre, 1.5, 0.75, 0.4).unwrap()),
        Reference::Path(Path::new(&bean, true, SPEED).unwrap()),
    ]
}

/// Position and direction of travel at the beginning.
fn beginning(reference: &Reference) -> (Position, Velocity) {
    // A path begins at rest.
    let soon = reference.at(1e-3).velocity;
    (reference.at(0.0).position.unwrap(), soon / soon.norm())
}

proptest::proptest! {
    #![proptest_config(proptest::test_runner::Config::with_cases(200))]

    #[test]
    fn a_drive_begins_at_the_nearest_place_that_leads_where_the_car_looks(
        x in -2.5..2.5, y in -2.5..2.5, yaw in -3.2..3.2,
    ) {
        let point = Position::new(x, y);
        // Beyond 60 degrees, a right angle counts as much as half a metre does.
        let remoteness = |(place, along): (Position, Velocity)| {
            let across = 0.5 * (0.5 - along.dot(&direction(yaw))).max(0.0);
            (place - point).norm_squared() + across
        };
        for mut reference in closed() {
            let lap = reference.lap_time().unwrap();
            let of_lap = reference.clone();
            reference.begin(Start::Nearest, &point, yaw);
            let found = remoteness(beginning(&reference));
            for part in 0..4_000 {
                // The second lap of a path has no run-in.
                let time = lap * (4.0 + f64::from(part) / 4_000.0);
                let place = of_lap.at(time);
                let place = (place.position.unwrap(), place.velocity.normalize());
                assert!(found < remoteness(place) + 2e-3, "{reference:?}: {found} {place:?}");
            }
            // Whatever was before, it is the same again.
            let mut again = reference.clone();
            again.begin(Start::Nearest, &point, yaw);
            assert_eq!(again, reference);
            again.begin(Start::Beginning, &point, yaw);
            assert_eq!(again, of_lap);
        }
    }
}

#[test]
fn at_the_crossing_of_an_eight_the_heading_decides() {
    let eight = FigureOfEight::new(Position::origin(), 1.0, 0.5, 0.4).unwrap();
    for heading in [0.785_f64, 2.356] {
        for off in [-0.5, 0.0, 0.5] {
            let mut reference = Reference::FigureOfEight(eight);
            reference.begin(Start::Nearest, &Position::new(0.02, -0.03), heading + off);
            let (place, along) = beginning(&reference);
            assert!(place.coords.norm() < 0.05, "{place}");
            assert!(along.dot(&direction(heading)) > 0.99, "{along} {off}");
        }
    }
}

#[test]
fn an_open_reference_and_a_standing_circle_begin_at_their_beginning() {
    let open = Reference::Path(Path::new(&winding(), false, SPEED).unwrap());
    let standing = Reference::Circle(Circle::new(Position::origin(), 1.0, 0.0).unwrap());
    for reference in [open, standing] {
        let mut begun = reference.clone();
        begun.begin(Start::Nearest, &Position::new(0.0, 1.0), 0.0);
        assert_eq!(begun, reference);
    }
}

#[test]
fn a_path_that_begins_anywhere_begins_at_rest() {
    let mut reference = Reference::Path(Path::new(&round(12), true, SPEED).unwrap());
    reference.begin(Start::Nearest, &Position::new(-0.5, 0.01), -1.6);
    let begins = reference.at(0.0);
    assert_eq!(begins.velocity, Velocity::zeros());
    assert!((begins.position.unwrap() - Position::new(-0.5, 0.0)).norm() < 0.02);
    assert_velocity_is_the_derivative(&reference, tenths(200));
}
