//! The geometry of the geofence, with arbitrary corners, and the pilot with one.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test may fail")]

use proptest::prelude::*;
use singletrack_control::{
    Circle, External, Position, Reference, Setpoint, SpeedDemand, SteeringDemand, Velocity,
    VelocityStep, VelocitySteps, angle_between, direction,
};
use singletrack_pilot::{
    Arming, Event, Fence, FenceError, Mode, Output, PilotConfig, PilotRequest, Reason,
};

use crate::bench::{Bench, Pose, config};

fn positions(corners: &[(f64, f64)]) -> Vec<Position> {
    corners.iter().map(|&(x, y)| Position::new(x, y)).collect()
}

/// Whether the polygon encloses the point, by the sum of the angles of its sides as seen
/// from the point: slow, and independent of the geofence's own method.
fn winds_around(corners: &[Position], point: &Position) -> bool {
    let next = corners.iter().cycle().skip(1);
    let turned: f64 = corners
        .iter()
        .zip(next)
        .map(|(from, to)| angle_between(&(from - point), &(to - point)))
        .sum();
    turned.abs() > std::f64::consts::PI
}

type Corner = (i32, i32);

/// Whether two sides have a point in common, exactly. Two segments are separate if and
/// only if their projections along or across one of them are.
fn meet(one: [Corner; 2], other: [Corner; 2]) -> bool {
    let along = |[from, to]: [Corner; 2]| (to.0 - from.0, to.1 - from.1);
    let axes = [along(one), along(other)].map(|(x, y)| [(x, y), (-y, x)]);
    let shadow = |side: [Corner; 2], (x, y): (i32, i32)| {
        let ends = side.map(|corner| corner.0 * x + corner.1 * y);
        ends[0].min(ends[1])..=ends[0].max(ends[1])
    };
    axes.as_flattened().iter().all(|&axis| {
        let (one, other) = (shadow(one, axis), shadow(other, axis));
        one.start() <= other.end() && other.start() <= one.end()
    })
}

/// Whether two sides meet, apart from the corner that neighbours share.
fn sides_meet(corners: &[Corner], first: usize, second: usize) -> bool {
    let count = corners.len();
    let side = |index: usize| [corners[index], corners[(index + 1) % count]];
    let folds =
        |one: [Corner; 2], next: [Corner; 2]| meet([one[0]; 2], next) || meet(one, [next[1]; 2]);
    if second == first + 1 {
        folds(side(first), side(second))
    } else if (first, second) == (0, count - 1) {
        folds(side(second), side(first))
    } else {
        meet(side(first), side(second))
    }
}

/// Corners in order around the origin, at random distances.
fn star() -> impl Strategy<Value = Vec<Position>> {
    (
        proptest::collection::vec(1..=8_u8, 3..=16),
        0.0..std::f64::consts::TAU,
        any::<bool>(),
    )
        .prop_map(|(radii, first, clockwise)| {
            let step = std::f64::consts::TAU / radii.len() as f64;
            let mut corners: Vec<_> = radii
                .iter()
                .enumerate()
                .map(|(index, &radius)| {
                    let angle = first + step * index as f64;
                    f64::from(radius) * Position::new(angle.cos(), angle.sin())
                })
                .collect();
            if clockwise {
                corners.reverse();
            }
            corners
        })
}

proptest! {
    #![proptest_config(ProptestConfig {
        cases: 500,
        failure_persistence: None,
        ..ProptestConfig::default()
    })]

    #[test]
    fn a_point_is_inside_if_and_only_if_the_polygon_winds_around_it(
        corners in star(),
        (x, y) in (-9.0..9.0, -9.0..9.0),
        level_with in any::<prop::sample::Index>(),
    ) {
        let fence = Fence::new(&corners, 0.0).unwrap();
        // Also a point level with a corner: a ray from it meets two sides at once.
        let level = corners[level_with.index(corners.len())].y;
        for point in [Position::new(x, y), Position::new(x, level)] {
            let clearance = fence.clearance(&point);
            if clearance.abs() > 1e-9 {
                prop_assert_eq!(clearance > 0.0, winds_around(&corners, &point), "{}", point);
                let stays = fence.contains_way(&point, &Velocity::zeros());
                prop_assert_eq!(stays, clearance > 0.0);
            }
        }
    }

    /// On a small grid, sides often touch and overlap.
    #[test]
    fn corners_are_rejected_if_and_only_if_two_sides_meet_and_the_error_names_them(
        corners in proptest::collection::vec((0..5_i32, 0..5_i32), 3..7),
    ) {
        let metres: Vec<_> = corners
            .iter()
            .map(|&(x, y)| (0.25 * f64::from(x), 0.25 * f64::from(y)))
            .collect();
        let pairs = (0..corners.len()).flat_map(|first| (0..first).map(move |second| (second, first)));
        let mut meeting = pairs.filter(|&(first, second)| sides_meet(&corners, first, second));
        match Fence::new(&positions(&metres), 0.0) {
            Ok(_) => prop_assert_eq!(meeting.next(), None),
            Err(FenceError::Crosses(first, second)) => {
                prop_assert!(meeting.any(|pair| pair == (first, second)));
            }
            Err(other) => prop_assert!(false, "{}", other),
        }
    }

    #[test]
    fn a_path_is_inside_if_and_only_if_all_its_points_are(
        corners in star(),
        (x, y) in (-4.0..4.0, -4.0..4.0),
        (dx, dy) in (-4.0..4.0, -4.0..4.0),
    ) {
        let fence = Fence::new(&corners, 0.0).unwrap();
        let (point, way) = (Position::new(x, y), Velocity::new(dx, dy));
        let least = (0..=60)
            .map(|step| fence.clearance(&(point + f64::from(step) / 60.0 * way)))
            .fold(f64::INFINITY, f64::min);
        // The samples are up to a tenth of a metre apart: closer cases are not decided.
        if least.abs() > 0.05 {
            prop_assert_eq!(fence.contains_way(&point, &way), least > 0.0);
        }
    }
}

#[test]
fn the_clearance_of_a_triangle_is_known() {
    let fence = Fence::new(&positions(&[(0.0, 0.0), (4.0, 0.0), (0.0, 3.0)]), 0.0).unwrap();
    for (x, y, clearance) in [
        // The centre of the inscribed circle.
        (1.0, 1.0, 1.0),
        (2.0, 0.5, 0.5),
        (4.0, 3.0, -2.4),
        (-1.0, 0.0, -1.0),
        (-3.0, 7.0, -5.0),
        (5.0, 0.0, -1.0),
    ] {
        let found = fence.clearance(&Position::new(x, y));
        assert!((found - clearance).abs() < 1e-12, "({x}, {y}): {found}");
    }
}

#[test]
fn collinear_sides_meet_only_if_they_overlap() {
    // A U, upright and on its side: its arms end on the same line.
    let arms = [
        (0.0, 0.0),
        (3.0, 0.0),
        (3.0, 2.0),
        (2.0, 2.0),
        (2.0, 1.0),
        (1.0, 1.0),
        (1.0, 2.0),
        (0.0, 2.0),
    ];
    for corners in [arms, arms.map(|(x, y)| (y, x))] {
        let fence = Fence::new(&positions(&corners), 0.0);
        assert!(fence.is_ok(), "{fence:?}");
    }
    // The second arm bent onto the end of the first.
    let bent = arms.map(|corner| {
        if corner == (2.0, 2.0) {
            (0.5, 2.0)
        } else {
            corner
        }
    });
    assert!(matches!(
        Fence::new(&positions(&bent), 0.0),
        Err(FenceError::Crosses(..))
    ));
}

/// The distance of a stop, in m: 0.1 s of reaction, then 1.5 m/s².
fn stopping_distance(speed: f64) -> f64 {
    0.1 * speed + speed * speed / 3.0
}

/// A drive along x at `speed` (m/s), with a side of the geofence at x = 4 m.
fn towards_the_fence(speed: f64) -> Bench {
    let mut bench = Bench::with(towards_the_fence_config(speed));
    bench.drive();
    bench
}

fn towards_the_fence_config(speed: f64) -> PilotConfig {
    let corners = [(-5.0, -5.0), (4.0, -5.0), (4.0, 5.0), (-5.0, 5.0)];
    PilotConfig {
        fence: Fence::new(&corners.map(|(x, y)| Position::new(x, y)), 0.0).unwrap(),
        reference: Reference::VelocitySteps(
            VelocitySteps::new(&[VelocityStep {
                duration: 60.0,
                velocity: Velocity::new(speed, 0.0),
            }])
            .unwrap(),
        ),
        ..config()
    }
}

#[test]
fn a_car_stops_inside_its_geofence_from_any_speed() {
    for speed in [0.4, 0.8, 1.5] {
        let mut bench = towards_the_fence(speed);
        let (output, _) = bench.run_until_idle();
        assert_eq!(output.reason, Some(Reason::OutsideFence));
        let x = bench.position.x;
        assert!((3.7..4.0).contains(&x), "{speed} m/s: {x}");
    }
}

#[test]
fn a_stop_begins_where_reaction_and_braking_reach_the_geofence() {
    for speed in [0.4, 0.8, 1.5] {
        let mut bench = towards_the_fence(speed);
        let mut ticks = 0;
        while bench.step().mode == Mode::Driving {
            ticks += 1;
            assert!(ticks < 2_000);
        }
        let needed = stopping_distance(speed);
        let left = 4.0 - bench.position.x;
        assert!(
            (left - needed).abs() < 0.03,
            "{speed} m/s: {left} for {needed}"
        );
    }
}

#[test]
fn a_car_that_loses_its_poses_stops_inside_its_geofence() {
    for speed in [0.4, 0.8, 1.5] {
        // Just before a stop would begin: the distance that the car goes while the pose is
        // held would take it outside.
        let blind_from = 4.0 - stopping_distance(speed) - 0.06;
        let mut bench = towards_the_fence(speed);
        while bench.position.x < blind_from {
            assert_eq!(bench.step().mode, Mode::Driving);
        }
        bench.pose = Pose::Missing;
        bench.run_until_idle();
        assert!(
            bench.position.x < 4.0,
            "{speed} m/s, blind from {blind_from}: {}",
            bench.position.x
        );
    }
}

/// Two laps of a circle inside a geofence of 16 sides at `room` (m) from its centre.
/// Returns the last mode and the farthest distance of the car from the centre, in m.
fn two_laps(room: f64) -> (Mode, f64) {
    let corner = room / (core::f64::consts::PI / 16.0).cos();
    let corners: Vec<_> = (0..16)
        .map(|index| {
            Position::origin()
                + corner * direction(core::f64::consts::TAU / 16.0 * f64::from(index))
        })
        .collect();
    let mut bench = Bench::with(PilotConfig {
        fence: Fence::new(&corners, 0.0).unwrap(),
        reference: Reference::Circle(Circle::new(Position::origin(), 1.0, 0.8).unwrap()),
        ..config()
    });
    bench.position = Position::new(0.75, -0.3);
    bench.yaw = 1.4;
    bench.drive();
    let mut farthest: f64 = 0.0;
    for _ in 0..1_600 {
        let mode = bench.step().mode;
        if mode != Mode::Driving {
            return (mode, farthest);
        }
        farthest = farthest.max(bench.position.coords.norm());
    }
    (Mode::Driving, farthest)
}

/// The straight continuation of a stop from a circle of 0.75 m would end 0.15 m outside.
#[test]
fn the_path_of_a_stop_follows_the_curvature() {
    let (mode, farthest) = two_laps(3.0);
    assert_eq!(mode, Mode::Driving);
    assert_eq!(two_laps(farthest + 0.02).0, Mode::Driving);
    assert_eq!(two_laps(farthest - 0.01).0, Mode::Stopping);
}

#[test]
fn a_car_outside_its_geofence_is_not_armed() {
    let mut bench = Bench::new();
    bench.position = Position::new(10.5, 0.0);
    let output = bench.run(100);
    assert_eq!(
        (output.mode, output.reason),
        (Mode::Idle, Some(Reason::OutsideFence))
    );
}

/// The car drives along a side 0.05 m to its left when its gyro shows a bend to it, which nothing
/// commands: the wheels stand other than they should.
#[test]
fn a_bend_that_was_not_commanded_counts_for_the_geofence() {
    let corners = [(-5.0, -5.0), (4.0, -5.0), (4.0, 0.05), (-5.0, 0.05)];
    let mut bench = Bench::with(PilotConfig {
        fence: Fence::new(&corners.map(|(x, y)| Position::new(x, y)), 0.0).unwrap(),
        ..towards_the_fence_config(0.8)
    });
    bench.drive();
    assert_eq!(bench.run(20).mode, Mode::Driving);
    bench.stuck = Some(1.5);
    let output = bench.run(5);
    assert_eq!(
        (output.mode, output.reason),
        (Mode::Stopping, Some(Reason::OutsideFence))
    );
}

/// A car without a safety filter that follows set-points of steering and speed, beside sides of the
/// geofence at x = -2 m and y = 2 m.
fn outside() -> Bench {
    let corners = [(-2.0, -9.0), (9.0, -9.0), (9.0, 2.0), (-2.0, 2.0)];
    let mut config = PilotConfig {
        fence: Fence::new(&corners.map(|(x, y)| Position::new(x, y)), 0.0).unwrap(),
        reference: Reference::External(External::new(0.2).unwrap()),
        ..config()
    };
    config.limits.max_reverse_speed = 0.5;
    Bench::with(config)
}

fn follow(bench: &mut Bench, steering: f64, speed: f64, request: Option<PilotRequest>) -> Output {
    let (steering, speed) = (SteeringDemand::Angle(steering), SpeedDemand::Speed(speed));
    let setpoint = Setpoint::actuation(bench.now(), steering, speed);
    bench.extra.push(Event::Setpoint(setpoint));
    bench.step_with(request)
}

/// Arms it, and follows until the drive ends.
fn until_stopping(bench: &mut Bench, speed: f64) -> Output {
    for tick in 0..1_500 {
        let request = (tick == 100).then_some(PilotRequest::Arm(Arming::Unattended));
        let output = follow(bench, 0.0, speed, request);
        if tick > 110 && output.mode != Mode::Driving {
            return output;
        }
    }
    panic!("it drives on");
}

#[test]
fn a_car_in_reverse_stops_before_the_side_behind_it() {
    let mut bench = outside();
    let output = until_stopping(&mut bench, -0.4);
    assert_eq!(output.reason, Some(Reason::OutsideFence));
    let left = 2.0 + bench.position.x;
    let needed = stopping_distance(0.4);
    assert!((left - needed).abs() < 0.03, "{left} for {needed}");
}

#[test]
fn a_bend_that_is_commanded_counts_for_the_geofence_before_the_wheels_have_turned() {
    let mut bench = outside();
    bench.position = Position::new(0.0, 1.99);
    for tick in 0..200 {
        let request = (tick == 100).then_some(PilotRequest::Arm(Arming::Unattended));
        follow(&mut bench, 0.0, 0.5, request);
    }
    assert_eq!(bench.pilot.mode(), Mode::Driving);
    let ended = (0..20).find_map(|_| {
        let output = follow(&mut bench, 0.4, 0.5, None);
        bench.steering = 0.0;
        (output.mode != Mode::Driving).then_some(output.reason)
    });
    assert_eq!(ended, Some(Some(Reason::OutsideFence)));
}

#[test]
fn an_unproved_car_stops_before_the_geofence_with_its_lower_braking() {
    // 0.25 m/s² at most, on the first metre.
    let mut config = towards_the_fence_config(0.3);
    config.supervisor.prove = true;
    let mut bench = Bench::with(config);
    bench.position = Position::new(3.4, 0.0);
    bench.run(100);
    bench.step_with(Some(PilotRequest::Arm(Arming::Unattended)));
    let mut output = bench.run(4);
    for _ in 0..600 {
        if output.mode != Mode::Driving {
            break;
        }
        output = bench.step();
    }
    assert_eq!(output.reason, Some(Reason::OutsideFence));
    let left = 4.0 - bench.position.x;
    let needed = 0.1 * 0.3 + 0.3 * 0.3 / 0.5;
    assert!((left - needed).abs() < 0.04, "{left} for {needed}");
}
