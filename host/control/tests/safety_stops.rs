//! The distances of walls before which the safety filter lets a car go on, forward and in reverse.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test may fail")]

use std::f64::consts::TAU;

use singletrack_control::{
    ConvexArea, Filtered, FrontPointLaw, LimitedLaw, Limits, Position, ROOM_DIRECTIONS,
    SafetyFilter, SafetyInput, Side, SpeedDemand, SteeringDemand, StopBox, Time, Velocity,
    direction,
};

use crate::safety_filter::{BRAKING, Car, L_R, PERIOD, WHEELBASE, config, limits, rectangle};

/// The least distance of a wall with which the filter agrees to go on with this speed (m/s) and steering
/// (rad), m. The wall is across the x axis, and all others are far away. The car is at the origin with this
/// yaw (rad), has been driven so for long, and `blind` m since the last pose.
fn wall(speed: f64, steering: f64, yaw: f64, blind: f64) -> f64 {
    let reversing = Limits {
        max_reverse_speed: 1.5,
        max_steering_rate: 100.0,
        ..limits()
    };
    let law = FrontPointLaw::new(WHEELBASE - L_R, 0.35, WHEELBASE).unwrap();
    let mut law = LimitedLaw::new(law, reversing);
    let demand = (SteeringDemand::Angle(steering), SpeedDemand::Speed(speed));
    for _ in 0..200 {
        law.follow(demand.0, demand.1, PERIOD).unwrap();
    }
    let given = law.actuation();
    assert!((given.speed - speed).abs() < 1e-9 && (given.steering - steering).abs() < 1e-9);
    let mut car = Car::standing(Position::origin(), yaw);
    car.speed = speed;
    car.state.sideslip = (L_R * steering.tan() / WHEELBASE).atan();
    let agrees = |x: f64| {
        let far = 100.0;
        let corners = [(-far, -far), (x, -far), (x, far), (-far, far)];
        let area = ConvexArea::new(&corners.map(|(x, y)| Position::new(x, y))).unwrap();
        let mut filter = SafetyFilter::new(config(area)).unwrap();
        for _ in 0..30 {
            filter.observe(speed.abs(), steering, BRAKING, PERIOD);
        }
        let mut estimate = car.estimate(Time(0), Velocity::zeros());
        estimate.yaw_rate = estimate.speed * steering.tan() / WHEELBASE;
        let input = SafetyInput {
            estimate: &estimate,
            law: &law,
            wheels: steering,
            wave: 0.0,
            blind,
            braking: BRAKING,
            period: PERIOD,
            neighbours: &[],
        };
        filter.demand(&input, |_, _| Ok(given)) == Filtered::Unchanged
    };
    let (mut least, mut most) = (0.0, 50.0);
    assert!(!agrees(least) && agrees(most));
    for _ in 0..50 {
        let middle = 0.5 * (least + most);
        *(if agrees(middle) {
            &mut most
        } else {
            &mut least
        }) = middle;
    }
    most
}

/// The way of a stop from a speed (m/s), m: reaction, period, the time by which a demand is scaled earlier,
/// and braking.
fn stop_way(speed: f64) -> f64 {
    speed * (0.15 + PERIOD + 0.1) + 0.5 * speed * speed / BRAKING
}

#[test]
fn a_stop_needs_its_way_and_what_was_driven_blind_forward_and_in_reverse() {
    for speed in [0.4, 1.0] {
        for blind in [0.0, 0.05, 0.3] {
            for (speed, yaw) in [(speed, 0.0), (-speed, TAU / 2.0)] {
                let expected =
                    config(rectangle(1.0, 1.0)).position_error + blind + stop_way(f64::abs(speed));
                let found = wall(speed, 0.0, yaw, blind);
                assert!(
                    (found - expected).abs() < 1e-6,
                    "{speed} {blind}: {found}, not {expected}"
                );
            }
        }
    }
}

#[test]
fn a_stop_in_reverse_goes_along_the_bend_of_a_car_that_goes_backward() {
    let speed = -0.6;
    for (steering, yaw) in [
        (0.25, 0.0),
        (0.25, 1.0),
        (-0.25, -1.0),
        (0.25, -1.0),
        (-0.25, 1.0),
    ] {
        // The tail goes towards the wall.
        let heading = TAU / 2.0 + yaw;
        // What rolls backward along this bend, in steps of a millimetre.
        let mut state = (0.0, heading);
        let mut farthest: f64 = 0.0;
        let sideslip = (L_R * f64::tan(steering) / WHEELBASE).atan();
        for _ in 0..(1000.0 * stop_way(0.6)) as u32 {
            state.1 -= 0.001 * f64::tan(steering) / WHEELBASE;
            state.0 -= 0.001 * f64::cos(state.1 + sideslip);
            farthest = farthest.max(state.0);
        }
        let found = wall(speed, steering, heading, 0.0);
        let beyond = found - farthest;
        // The errors that the filter allows for: 0.1 1/m of curvature over 0.36 m, and 0.02 rad.
        assert!(
            (0.0..0.06).contains(&beyond),
            "{steering} {yaw}: {found}, {farthest}"
        );
    }
}

#[test]
fn a_side_that_keeps_the_car_from_another_body_counts_as_one_of_its_area() {
    let law = FrontPointLaw::new(WHEELBASE - L_R, 0.35, WHEELBASE).unwrap();
    let mut law = LimitedLaw::new(law, limits());
    for _ in 0..200 {
        let (steering, speed) = (SteeringDemand::Angle(0.0), SpeedDemand::Speed(0.8));
        law.follow(steering, speed, PERIOD).unwrap();
    }
    let mut car = Car::standing(Position::origin(), 0.2);
    car.speed = 0.8;
    let estimate = car.estimate(Time(0), Velocity::zeros());
    let wanted = 0.8 * direction(0.2);
    let answers = |area_at: f64, sides: &[Side]| {
        let far = 50.0;
        let corners = [(-far, -far), (area_at, -far), (area_at, far), (-far, far)];
        let area = ConvexArea::new(&corners.map(|(x, y)| Position::new(x, y))).unwrap();
        let mut filter = SafetyFilter::new(config(area)).unwrap();
        for _ in 0..30 {
            filter.observe(0.8, 0.0, BRAKING, PERIOD);
        }
        let input = SafetyInput {
            estimate: &estimate,
            law: &law,
            wheels: 0.0,
            wave: 0.0,
            blind: 0.0,
            braking: BRAKING,
            period: PERIOD,
            neighbours: sides,
        };
        let step = filter.step(&input, &wanted, |law, velocity| {
            law.step(&estimate.motion(), estimate.speed, velocity, PERIOD)
        });
        let given = law.actuation();
        (step, filter.demand(&input, |_, _| Ok(given)))
    };
    let mut kinds = [0; 4];
    for tenths in 2..25 {
        let x = 0.1 * f64::from(tenths);
        let side = Side {
            outward: Velocity::new(1.0, 0.0),
            offset: x,
        };
        let (step, demand) = answers(x, &[]);
        let (beside, demanded) = answers(50.0, &[side]);
        assert_eq!(demanded, demand, "{x}");
        let (kind, change) = match (step, beside) {
            (Filtered::Unchanged, Filtered::Unchanged) => (0, 0.0),
            (Filtered::Limited(one), Filtered::Limited(other)) => (1, (one - other).norm()),
            (Filtered::Scaled(one), Filtered::Scaled(other)) => (2, (one - other).norm()),
            (Filtered::Stop, Filtered::Stop) => (3, 0.0),
            _ => panic!("{x}: {step:?}, {beside:?}"),
        };
        assert!(change < 1e-9, "{x}: {step:?}, {beside:?}");
        kinds[kind] += 1;
    }
    assert!(kinds[0] > 0 && kinds[1] > 0 && kinds[3] > 0, "{kinds:?}");
}

/// Whether the filter lets a car at the origin, with this speed (m/s), go on beside a side so far away (m). Its
/// wheels stand anywhere between straight ahead and the steering (rad) that is sent.
fn goes_on(speed: f64, steering: f64, blind: f64, outward: Velocity, offset: f64) -> bool {
    let law = FrontPointLaw::new(WHEELBASE - L_R, 0.35, WHEELBASE).unwrap();
    let mut law = LimitedLaw::new(law, limits());
    for _ in 0..200 {
        law.follow(
            SteeringDemand::Angle(steering),
            SpeedDemand::Speed(speed),
            PERIOD,
        )
        .unwrap();
    }
    let mut filter = SafetyFilter::new(config(rectangle(50.0, 50.0))).unwrap();
    filter.observe(speed, 0.0, BRAKING, PERIOD);
    let mut car = Car::standing(Position::origin(), 0.0);
    car.speed = speed;
    let input = SafetyInput {
        estimate: &car.estimate(Time(0), Velocity::zeros()),
        law: &law,
        wheels: steering,
        wave: 0.0,
        blind,
        braking: BRAKING,
        period: PERIOD,
        neighbours: &[Side { outward, offset }],
    };
    let given = law.actuation();
    let full_stop = |_: &mut LimitedLaw, share: f64| {
        // What is tried last is not scaled early.
        if share == 0.0 {
            Ok(given)
        } else {
            Ok(singletrack_control::Actuation {
                speed: 50.0,
                ..given
            })
        }
    };
    filter.demand(&input, full_stop) == Filtered::Scaled(0.0)
}

#[test]
fn the_room_of_a_certificate_is_what_the_filter_asks_for() {
    for (speed, steering, blind) in [(0.4, 0.2, 0.0), (1.2, 0.3, 0.1), (1.4, -0.25, 0.15)] {
        let filter = SafetyFilter::new(config(rectangle(50.0, 50.0))).unwrap();
        let ends = [f64::min(0.0, steering), f64::max(0.0, steering)];
        let room = filter.room(&StopBox {
            speed,
            blind,
            braking: BRAKING,
            period: PERIOD,
            rear_axle_distance: L_R,
            before: ends,
            sent: [steering; 2],
        });
        assert!(
            room[0] > 0.25 * speed && room[ROOM_DIRECTIONS / 2] < 0.02,
            "{room:?}"
        );
        for (index, room) in room.into_iter().enumerate() {
            let outward = direction(TAU * index as f64 / ROOM_DIRECTIONS as f64);
            let at = |offset| goes_on(speed, steering, blind, outward, offset);
            assert!(
                at(room + 1e-9) && !at(room - 1e-9),
                "{speed} {steering} {index}: {room}"
            );
        }
    }
}
