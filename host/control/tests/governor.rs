//! The reference governor.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test may fail")]

use proptest::prelude::*;
use singletrack_control::{
    Circle, FigureOfEight, FrontPointLaw, Governor, GovernorConfig, Limits, Path, PathSpeed,
    Position, Reference, SlowedBy, VehicleParameters, Velocity, Waypoint, Waypoints, direction,
};

const PERIOD: f64 = 0.01;

fn governor_config() -> GovernorConfig {
    GovernorConfig {
        law: FrontPointLaw::new(0.1368, 0.35, 0.26).unwrap(),
        limits: Limits::paper().with_tyres(&VehicleParameters::paper()),
        behind: 0.5,
        room: None,
    }
}

fn governor() -> Governor {
    Governor::new(governor_config())
}

fn circle(radius: f64, speed: f64) -> Reference {
    Reference::Circle(Circle::new(Position::origin(), radius, speed / radius).unwrap())
}

fn eight(half_length: f64, half_width: f64, rate: f64) -> Reference {
    let eight = FigureOfEight::new(Position::origin(), half_length, half_width, rate);
    Reference::FigureOfEight(eight.unwrap())
}

/// A corner of 90 degrees, taken at once.
fn corner(speed: f64) -> Reference {
    let points = [(0.0, 0.0, 0.0), (1.0, 2.0, 0.0), (2.0, 2.0, 2.0)];
    let waypoints = points.map(|(part, x, y)| Waypoint {
        time: part * 2.0 / speed,
        position: Position::new(x, y),
    });
    Reference::Waypoints(Waypoints::new(&waypoints).unwrap())
}

/// A drive with P on the governed reference: at each tick s, the rate and why.
fn follow(reference: &Reference, seconds: f64) -> Vec<(f64, f64, Option<SlowedBy>)> {
    follow_with(governor(), reference, seconds)
}

fn follow_with(
    mut governor: Governor,
    reference: &Reference,
    seconds: f64,
) -> Vec<(f64, f64, Option<SlowedBy>)> {
    (0..(seconds / PERIOD) as u32)
        .map(|tick| {
            let time = f64::from(tick) * PERIOD;
            let point = governor.at(reference, PERIOD).position.unwrap();
            let path = governor.advance(time, reference, &point);
            (path, governor.rate(), governor.slowed_by())
        })
        .collect()
}

/// s never goes back, and never faster than time; its rate changes slowly.
fn check_bounds(ticks: &[(f64, f64, Option<SlowedBy>)]) -> Result<(), TestCaseError> {
    for pair in ticks.windows(2) {
        let [(before, rate_before, _), (after, rate, by)] = pair else {
            continue;
        };
        prop_assert!(after >= before && after - before <= PERIOD + 1e-9);
        prop_assert!((0.0..=1.0).contains(rate));
        prop_assert!((rate - rate_before).abs() <= PERIOD + 1e-9);
        prop_assert!(by.is_some() || *rate == 1.0);
    }
    Ok(())
}

proptest! {
    #[test]
    fn any_reference_is_passed_on_monotonously_and_smoothly(
        radius in 0.2..3.0_f64,
        speed in 0.1..4.0_f64,
        half in 0.3..4.0_f64,
        rate in 0.1..2.0_f64,
    ) {
        check_bounds(&follow(&circle(radius, speed), 6.0))?;
        check_bounds(&follow(&eight(half, 0.5 * half, rate), 6.0))?;
        check_bounds(&follow(&corner(speed), 6.0))?;
    }

    #[test]
    fn a_circle_that_the_car_can_follow_is_not_changed(
        radius in 1.0..4.0_f64,
        share in 0.05..0.9_f64,
        noise in -0.2..0.2_f64,
    ) {
        // With the rear axle's radius; the limits of speed and tyres.
        let rear = (radius * radius - 0.61 * 0.61_f64).sqrt();
        let fastest = (2.0 / rear).sqrt() * radius;
        let reference = circle(radius, share * fastest.min(1.4));
        let mut governor = governor();
        let mut time = 0.0;
        for tick in 0..800_u32 {
            // Ticks do not come evenly either.
            time += PERIOD * (1.0 + 0.01 * f64::from(tick % 3));
            let here = reference.at(time).position.unwrap();
            let point = here + Velocity::new(noise, -noise);
            prop_assert_eq!(governor.path_at(time).to_bits(), time.to_bits());
            let path = governor.advance(time, &reference, &point);
            prop_assert_eq!(path.to_bits(), time.to_bits());
            prop_assert_eq!(governor.slowed_by(), None);
            for ahead in [0.0, 0.018, 0.3] {
                prop_assert_eq!(governor.at(&reference, ahead), reference.at(time + ahead));
            }
        }
    }
}

#[test]
fn each_limit_slows_a_reference_down_with_its_word() {
    for (max_speed, reference, expected, least, most) in [
        // 3.0 m/s² of the car's; as fast as the limit of 2 m/s² allows.
        (2.5, circle(1.0, 1.95), SlowedBy::Tyres, 0.7, 0.9),
        // Faster than the car, nearly straight: 0.2 of its 1.5 m/s are left to catch up.
        (1.5, circle(30.0, 3.0), SlowedBy::Speed, 0.43, 0.435),
        // As fast on a larger circle.
        (1.5, circle(0.45, 0.45), SlowedBy::Steering, 0.55, 0.75),
    ] {
        let mut config = governor_config();
        config.limits.max_speed = max_speed;
        let ticks = follow_with(Governor::new(config), &reference, 20.0);
        let (path, _, by) = *ticks.last().unwrap();
        let (before, ..) = ticks[1_000];
        let rate = (path - before) / (PERIOD * (ticks.len() - 1_001) as f64);
        assert_eq!(by, Some(expected));
        assert!((least..most).contains(&rate), "{expected:?}: {rate}");
    }
    let quick = GovernorConfig {
        limits: Limits {
            max_steering_rate: 0.5,
            ..Limits::paper()
        },
        law: FrontPointLaw::new(0.1368, 0.1, 0.26).unwrap(),
        behind: 0.5,
        room: None,
    };
    let reference = eight(1.5, 0.75, 0.7);
    let mut governor = Governor::new(quick);
    let mut seen = false;
    for tick in 0..1_000 {
        let time = f64::from(tick) * PERIOD;
        let point = reference.at(governor.path_at(time)).position.unwrap();
        governor.advance(time, &reference, &point);
        seen |= governor.slowed_by() == Some(SlowedBy::SteeringRate);
    }
    assert!(seen);
}

#[test]
fn the_reference_waits_for_p_that_is_far_behind_and_not_for_one_ahead() {
    let reference = circle(2.0, 0.5);
    let mut governor = governor();
    let start = reference.at(0.0).position.unwrap();
    let mut path = 0.0;
    for tick in 0..1_000 {
        path = governor.advance(f64::from(tick) * PERIOD, &reference, &start);
    }
    // Between half a metre, where it slows down, and a metre, where it would wait.
    let away = (reference.at(path).position.unwrap() - start).norm();
    assert!((0.5..1.01).contains(&away), "{away}");
    assert_eq!(governor.slowed_by(), Some(SlowedBy::Behind));
    governor.reset();
    for tick in 0..100 {
        let time = f64::from(tick) * PERIOD;
        let ahead = reference.at(time + 2.0).position.unwrap();
        assert_eq!(governor.advance(time, &reference, &ahead), time);
    }
}

#[test]
fn it_slows_down_before_the_bend() {
    let reference = corner(1.2);
    let bend = 2.0 / 1.2;
    let ticks = follow(&reference, 4.0);
    let (_, rate, _) = *ticks.iter().find(|tick| tick.0 >= bend).unwrap();
    assert!(rate < 0.85, "{rate}");
}

#[test]
fn a_path_with_its_own_speeds_is_not_changed_and_ends_when_it_did() {
    let points: Vec<_> = (0..20)
        .map(|index| {
            let x = 0.3 * f64::from(index);
            Position::new(x, 0.3 * (0.8 * x).sin())
        })
        .collect();
    let speed = PathSpeed {
        speed: 0.8,
        lateral_acceleration: 1.0,
        acceleration: 0.5,
    };
    let reference = Reference::Path(Path::new(&points, false, speed).unwrap());
    let seconds = reference.duration().unwrap();
    for (tick, (path, ..)) in follow(&reference, seconds).iter().enumerate() {
        assert_eq!(*path, tick as f64 * PERIOD);
    }
}

/// A car without slip whose P is put on points, one after the other.
struct Rolls {
    point: Position,
    wheels: Velocity,
    body: Velocity,
}

/// What a step of [`Rolls`] takes, as shares of the limits.
#[derive(Clone, Copy, Debug, Default)]
struct Taken {
    steering: f64,
    steering_rate: f64,
    lateral: f64,
    speed: f64,
}

impl Rolls {
    fn to(&mut self, point: Position, limits: &Limits) -> Taken {
        const P: f64 = 0.35;
        let angle = |body: &Velocity, wheels: &Velocity| body.perp(wheels).atan2(body.dot(wheels));
        let before = angle(&self.body, &self.wheels);
        // The front axle rolls along the wheels until it is at its distance again.
        let way = point - self.point;
        let across = self.wheels.perp(&way);
        let axle = self.wheels.dot(&way) + P - (P * P - across * across).sqrt();
        let turned = axle * before.sin() / limits.wheelbase;
        self.wheels = (P * self.wheels + way - axle * self.wheels).normalize();
        self.body = direction(self.body.y.atan2(self.body.x) + turned);
        self.point = point;
        let steering = angle(&self.body, &self.wheels);
        let lateral = axle * before.cos() * turned / (PERIOD * PERIOD);
        Taken {
            steering: steering.abs() / limits.max_steering,
            steering_rate: (steering - before).abs() / PERIOD / limits.max_steering_rate,
            lateral: lateral.abs() / limits.max_lateral_acceleration,
            speed: way.norm() / PERIOD / limits.max_speed,
        }
    }
}

/// The rate changes at the ticks alone, and this car cuts corners between them.
const SLACK: f64 = 1.1;

fn check_taken(most: &Taken) -> Result<(), TestCaseError> {
    for share in [most.steering, most.steering_rate, most.lateral, most.speed] {
        prop_assert!(share <= SLACK, "{:?}", most);
    }
    Ok(())
}

/// Follows a reference exactly: what that takes at most, and where P is in the end.
fn roll(reference: &Reference, seconds: f64) -> (Taken, Vec<Position>) {
    let limits = Limits::paper();
    let mut governor = governor();
    let start = reference.at(0.0);
    let heading = start.velocity.normalize();
    let mut car = Rolls {
        point: start.position.unwrap(),
        wheels: heading,
        body: heading,
    };
    let mut most = Taken::default();
    let mut way = Vec::new();
    for tick in 0..(seconds / PERIOD) as u32 {
        governor.advance(f64::from(tick) * PERIOD, reference, &car.point);
        let governed = governor.at(reference, 0.0);
        assert!(governed.velocity.norm() <= SLACK * limits.max_speed);
        let taken = car.to(governed.position.unwrap(), &limits);
        most = Taken {
            steering: most.steering.max(taken.steering),
            steering_rate: most.steering_rate.max(taken.steering_rate),
            lateral: most.lateral.max(taken.lateral),
            speed: most.speed.max(taken.speed),
        };
        way.push(car.point);
    }
    (most, way)
}

proptest! {
    #[test]
    fn the_governed_reference_of_a_small_circle_can_be_steered_and_goes_round_the_same_centre(
        radius in 0.2..1.0_f64,
        speed in 0.3..2.0_f64,
        to_the_left in any::<bool>(),
    ) {
        let speed = if to_the_left { speed } else { -speed };
        let (most, way) = roll(&circle(radius, speed), 30.0);
        check_taken(&most)?;
        let smallest = governor_config().least_radius();
        for point in &way[2_000..] {
            let away = (point.coords.norm() - radius).abs();
            prop_assert!(away <= (smallest - radius).max(0.0) + 0.01, "{away}");
        }
    }

    #[test]
    fn any_governed_eight_or_corner_can_be_steered(
        half in 0.3..2.0_f64,
        rate in 0.1..2.0_f64,
        speed in 0.3..2.0_f64,
    ) {
        for reference in [eight(half, 0.5 * half, rate), corner(speed)] {
            let (most, _) = roll(&reference, 15.0);
            check_taken(&most)?;
        }
    }
}

#[test]
fn behind_a_corner_the_governed_reference_comes_back_to_its_path() {
    let reference = corner(1.0);
    let mut governor = governor();
    let (mut beside, mut farthest) = (0, 0.0_f64);
    let mut path = 0.0;
    for tick in 0..600 {
        let time = f64::from(tick) * PERIOD;
        let point = governor.at(&reference, 0.0).position.unwrap();
        path = governor.advance(time, &reference, &point);
        let governed = governor.at(&reference, 0.0).position.unwrap();
        let [first, second] = [governed.y.abs(), (governed.x - 2.0).abs()];
        let away = if path < 2.0 { first } else { second };
        farthest = farthest.max(away);
        beside += u32::from(away > 0.0);
        if path > 3.9 {
            assert_eq!(Some(governed), reference.at(path).position, "{path}");
            break;
        }
    }
    assert!(path > 3.9, "{path}");
    assert!(beside > 20 && farthest < 0.15, "{beside}, {farthest}");
}

#[test]
fn a_reference_that_goes_back_on_itself_is_turned_round_for() {
    let waypoints = [(0.0, 0.0), (4.0, 2.0), (8.0, 0.0)].map(|(time, x)| Waypoint {
        time,
        position: Position::new(x, 0.0),
    });
    let reference = Reference::Waypoints(Waypoints::new(&waypoints).unwrap());
    let (most, way) = roll(&reference, 20.0);
    check_taken(&most).unwrap();
    let end = way.last().unwrap();
    assert!(end.x < 0.3 && end.y.abs() < 0.1, "{end}");
}
