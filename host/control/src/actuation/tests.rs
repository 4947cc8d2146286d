//! The limits, the reserve of the steering, and the ways to turn round.

use super::*;

const PERIOD: f64 = 0.01;

fn limited(limits: Limits) -> LimitedLaw {
    LimitedLaw::new(FrontPointLaw::new(0.1368, 0.35, 0.26).unwrap(), limits)
}

fn standing(yaw: f64) -> Motion {
    Motion {
        yaw,
        yaw_rate: 0.0,
        sideslip: 0.0,
    }
}

#[test]
fn a_gyro_bias_does_not_wind_up_the_steering_of_a_standing_car() {
    let mut law = limited(Limits::paper());
    let biased = Motion {
        yaw_rate: 0.05,
        ..standing(0.0)
    };
    for _ in 0..10_000 {
        law.step(&biased, 0.0, &Velocity::zeros(), PERIOD).unwrap();
    }
    assert_eq!(law.actuation().steering, 0.0);
}

#[test]
fn steering_stops_at_its_limit_and_leaves_it_at_once() {
    let mut law = limited(Limits::paper());
    for _ in 0..1000 {
        law.step(&standing(0.0), 0.5, &Velocity::new(0.05, 0.5), PERIOD)
            .unwrap();
    }
    assert_eq!(law.actuation().steering, Limits::paper().max_steering);
    let after = law
        .step(&standing(0.0), 0.5, &Velocity::new(0.5, -0.2), PERIOD)
        .unwrap();
    assert!(after.steering < Limits::paper().max_steering);
}

#[test]
fn p_is_given_what_is_wanted_where_nothing_limits_it_and_less_elsewhere() {
    let bend = Motion {
        yaw: 0.4,
        yaw_rate: 0.5,
        sideslip: 0.05,
    };
    let lead = Lead {
        wheels: 0.1,
        steering: 0.04,
        speed: 0.05,
    };
    for lead in [None, Some(lead)] {
        let ahead = Ahead {
            overtaken: None,
            lead,
        };
        let mut law = limited(Limits::paper());
        law.actuation.speed = 0.5;
        law.actuation.steering = 0.1;
        let wanted = 0.52 * direction(0.6);
        let gentle = law.law.command(&bend, 0.1, &wanted).unwrap();
        // The speed before is the same, so that the acceleration limits nothing.
        law.actuation.speed = gentle.speed + lead.map_or(0.0, |lead| lead.speed);
        law.step_ahead(&bend, 0.5, &wanted, &ahead, PERIOD).unwrap();
        assert!((law.point_velocity() - wanted).norm() < 1e-12, "{lead:?}");
        // A car that has to speed up, and one whose speed is held.
        let fast = 1.2 * direction(0.6);
        law.step_ahead(&bend, 0.5, &fast, &ahead, PERIOD).unwrap();
        let given = law.point_velocity();
        assert!(given.dot(&direction(0.6)) < 0.7, "{lead:?}: {given}");
        law.cap_speed(0.1);
        let held = law.point_velocity();
        assert!(held.norm() < given.norm(), "{lead:?}: {held}");
    }
    // The steering angle ends.
    let mut law = limited(Limits::paper());
    let sharp = Velocity::new(0.05, 0.5);
    for _ in 0..100 {
        law.step(&bend, 0.5, &sharp, PERIOD).unwrap();
    }
    assert!((law.point_velocity() - sharp).norm() > 0.1);
}

#[test]
fn speed_changes_no_faster_than_allowed() {
    let mut law = limited(Limits::paper());
    let mut last = 0.0;
    for step in 0..400 {
        let wanted = Velocity::new(if step < 200 { 5.0 } else { 0.0 }, 0.0);
        let speed = law
            .step(&standing(0.0), last, &wanted, PERIOD)
            .unwrap()
            .speed;
        assert!((speed - last).abs() <= 2.0 * PERIOD + 1e-12);
        assert!((0.0..=1.5).contains(&speed));
        last = speed;
    }
    assert_eq!(last, 0.0);
}

#[test]
fn a_velocity_behind_the_car_is_reached_going_forward() {
    for degrees in [91.0, 135.0, 179.0, 180.0, -180.0, -135.0, -91.0_f64] {
        let mut law = limited(Limits::paper());
        let mut yaw = 0.0;
        let wanted = 0.5 * direction(degrees.to_radians());
        let mut reached = None;
        for step in 0..3000 {
            let now = law.step(&standing(yaw), 0.3, &wanted, PERIOD).unwrap();
            assert!(now.speed >= 0.0, "{degrees}: reversed");
            // The car rolls without slip.
            yaw += now.speed * libm::tan(now.steering) / 0.26 * PERIOD;
            if angle_between(&direction(yaw), &wanted).abs() < 0.1 {
                reached.get_or_insert(step);
            }
        }
        assert!(reached.is_some(), "{degrees}: never turned");
    }
}

#[test]
fn noise_straight_behind_does_not_switch_the_side_of_a_turn() {
    let mut law = limited(Limits::paper());
    let mut yaw: f64 = 0.0;
    let mut sides = 0;
    let mut last = 0.0_f64;
    for step in 0..200 {
        let noise = if step % 2 == 0 { 0.02 } else { -0.02 };
        let wanted = -0.5 * direction(noise);
        let now = law.step(&standing(yaw), 0.3, &wanted, PERIOD).unwrap();
        if now.steering_rate * last < 0.0 {
            sides += 1;
        }
        if now.steering_rate != 0.0 {
            last = now.steering_rate;
        }
        yaw += now.speed * libm::tan(now.steering) / 0.26 * PERIOD;
    }
    assert_eq!(sides, 0);
}

#[test]
fn the_car_reverses_only_if_that_is_enabled() {
    let behind = Velocity::new(-0.5, 0.0);
    let mut forward_only = limited(Limits::paper());
    let mut either = limited(Limits {
        max_reverse_speed: 0.3,
        ..Limits::paper()
    });
    for _ in 0..100 {
        assert!(
            forward_only
                .step(&standing(0.0), 0.0, &behind, PERIOD)
                .unwrap()
                .speed
                >= 0.0
        );
        either.step(&standing(0.0), 0.0, &behind, PERIOD).unwrap();
    }
    assert_eq!(either.actuation().speed, -0.3);
}

#[test]
fn demanded_steering_and_speed_are_reached_within_every_limit() {
    let limits = Limits {
        max_reverse_speed: 0.3,
        ..Limits::paper()
    };
    let mut law = limited(limits);
    let demands = [
        (
            SteeringDemand::Angle(0.1),
            SpeedDemand::Speed(0.5),
            0.1,
            0.5,
        ),
        (
            SteeringDemand::Angle(1.5),
            SpeedDemand::Speed(50.0),
            0.45,
            1.037,
        ),
        (
            SteeringDemand::Angle(0.0),
            SpeedDemand::Speed(50.0),
            0.0,
            1.5,
        ),
        (
            SteeringDemand::AngleWithin {
                angle: 0.3,
                rate: 0.05,
            },
            SpeedDemand::RearSpeed(0.4),
            // 3 s of 10 ms at this rate.
            0.15,
            0.4,
        ),
        (
            SteeringDemand::Rate(-9.0),
            SpeedDemand::Acceleration(-99.0),
            -0.45,
            -0.3,
        ),
        (
            SteeringDemand::Rate(0.0),
            SpeedDemand::Acceleration(0.0),
            -0.45,
            -0.3,
        ),
    ];
    for (steering, speed, reached_steering, reached_speed) in demands {
        for _ in 0..300 {
            let before = law.actuation();
            let now = law.follow(steering, speed, PERIOD).unwrap();
            assert!((now.speed - before.speed).abs() <= 2.0 * PERIOD + 1e-12);
            assert!((now.steering - before.steering).abs() <= 5.0 * PERIOD + 1e-12);
            let lateral = now.speed * now.speed * libm::tan(now.steering).abs() / 0.26;
            assert!(lateral <= 2.0 + 1e-9, "{lateral}");
        }
        let now = law.actuation();
        assert!((now.steering - reached_steering).abs() < 1e-3, "{now:?}");
        assert!((now.speed - reached_speed).abs() < 1e-3, "{now:?}");
    }
    let before = law.actuation();
    for (steering, speed) in [
        (SteeringDemand::Angle(f64::NAN), SpeedDemand::Speed(0.1)),
        (SteeringDemand::Rate(0.1), SpeedDemand::Speed(f64::NAN)),
        (SteeringDemand::Rate(f64::INFINITY), SpeedDemand::Speed(0.1)),
        (
            SteeringDemand::Angle(0.1),
            SpeedDemand::Acceleration(f64::NAN),
        ),
    ] {
        assert_eq!(
            law.follow(steering, speed, PERIOD),
            Err(Singularity::NotFinite)
        );
    }
    assert_eq!(law.actuation(), before);
}

#[test]
fn the_lateral_acceleration_limits_the_speed_in_a_bend() {
    let limits = Limits {
        max_speed: 5.0,
        ..Limits::paper()
    };
    let mut law = limited(limits);
    let mut largest: f64 = 0.0;
    for step in 0..2_000 {
        // The wanted velocity turns to the left of the heading.
        let wanted = 3.0 * direction(f64::from(step) * 5e-4);
        let now = law.step(&standing(0.0), 0.5, &wanted, PERIOD).unwrap();
        let lateral = now.speed * now.speed * libm::tan(now.steering.abs()) / 0.26;
        largest = largest.max(lateral);
    }
    assert!(largest <= 2.0 + 1e-9, "{largest}");
    assert!(law.actuation().steering > 0.3);
    assert_eq!(limits.speed_in_bend(0.0), f64::INFINITY);
    let at_limit = limits.speed_in_bend(-0.45);
    assert!((at_limit - (2.0 * 0.26 / libm::tan(0.45)).sqrt()).abs() < 1e-12);
}

#[test]
fn a_quick_steering_keeps_the_lateral_acceleration_within_its_limit() {
    let mut law = limited(Limits::paper());
    for _ in 0..200 {
        law.step(&standing(0.0), 1.5, &Velocity::new(1.5, 0.0), PERIOD)
            .unwrap();
    }
    assert_eq!(law.actuation().speed, 1.5);
    for _ in 0..100 {
        let wanted = 1.5 * direction(core::f64::consts::FRAC_PI_4);
        let now = law.step(&standing(0.0), 1.5, &wanted, PERIOD).unwrap();
        let lateral = now.speed * now.speed * libm::tan(now.steering.abs()) / 0.26;
        assert!(lateral <= 2.0 + 1e-9, "{lateral}");
    }
    assert!(law.actuation().steering > 0.4);
}

#[test]
fn with_saturating_tyres_the_limit_is_that_of_the_car_in_its_bend() {
    let vehicle = VehicleParameters::paper();
    let model = crate::RelaxedSingleTrack::new(vehicle);
    for (acceleration, steering) in [(1.0, 0.15), (2.0, 0.2), (2.3, 0.25)] {
        let limits = Limits {
            max_lateral_acceleration: acceleration,
            ..Limits::paper()
        };
        let speed = limits.with_tyres(&vehicle).speed_in_bend(steering);
        assert!(speed > limits.speed_in_bend(steering), "it understeers");
        let mut state = crate::SingleTrackState::default();
        for _ in 0..20_000 {
            let slope = model.derivative(&state, speed, steering);
            state.yaw_rate += 1e-4 * slope.yaw_rate;
            state.sideslip += 1e-4 * slope.sideslip;
        }
        let lateral = speed * state.yaw_rate;
        // The model is linear in the steering angle, the limit is not.
        assert!(lateral <= acceleration, "{lateral}");
        assert!(lateral > 0.93 * acceleration, "{lateral}");
        let widest = limits.with_tyres(&vehicle).steering_at(speed);
        assert!((widest - steering).abs() < 1e-9);
    }
}

#[test]
fn a_car_that_has_overtaken_its_reference_brakes_and_does_not_turn_round() {
    let overtaken = |velocity| Ahead {
        overtaken: Some(velocity),
        lead: None,
    };
    let behind = Velocity::new(-0.4, 0.05);
    let mut law = limited(Limits::paper());
    for _ in 0..100 {
        law.step(&standing(0.0), 0.5, &Velocity::new(0.5, 0.0), PERIOD)
            .unwrap();
    }
    let comes = overtaken(Velocity::new(0.3, 0.0));
    for step in 0..100 {
        let now = law
            .step_ahead(&standing(0.0), 0.5, &behind, &comes, PERIOD)
            .unwrap();
        assert!(!law.is_turning_round());
        assert!(
            now.speed <= 0.5 - 0.02 * f64::from(step.min(24)),
            "{step}: {now:?}"
        );
    }
    assert_eq!(law.actuation().speed, 0.0);
    // A reference that itself moves backward is followed.
    let leaves = overtaken(Velocity::new(-0.3, 0.0));
    law.step_ahead(&standing(0.0), 0.0, &behind, &leaves, PERIOD)
        .unwrap();
    assert!(law.is_turning_round());
}

#[test]
fn the_lead_commands_more_than_the_wheels_are_to_turn_and_no_reverse() {
    let mut law = limited(Limits::paper());
    let lead = Lead {
        wheels: 0.1,
        steering: 0.045,
        speed: 0.05,
    };
    let ahead = |lead| Ahead {
        overtaken: None,
        lead: Some(lead),
    };
    let wanted = 0.5 * direction(0.1);
    for _ in 0..200 {
        law.step_ahead(&standing(0.0), 0.5, &wanted, &ahead(lead), PERIOD)
            .unwrap();
    }
    // Along the wheels nothing but the yaw has to be made up for.
    let rate = 0.5 * libm::sin(0.1) / 0.35 / libm::cos(0.1);
    let now = law.actuation();
    assert!(
        (now.steering - (0.1 + 0.045 * rate)).abs() < 1e-9,
        "{now:?}"
    );
    assert!((now.speed - (0.5 / libm::cos(0.1) + 0.05)).abs() < 1e-9);
    let brakes = Lead {
        speed: -9.0,
        ..lead
    };
    for _ in 0..200 {
        let now = law
            .step_ahead(&standing(0.0), 0.5, &wanted, &ahead(brakes), PERIOD)
            .unwrap();
        assert!(now.speed >= 0.0);
    }
    let broken = Lead {
        wheels: f64::NAN,
        ..lead
    };
    let before = law.clone();
    assert!(
        law.step_ahead(&standing(0.0), 0.5, &wanted, &ahead(broken), PERIOD)
            .is_err()
    );
    assert_eq!(law.actuation(), before.actuation());
}

#[test]
fn a_velocity_that_is_not_finite_changes_nothing() {
    let mut law = limited(Limits::paper());
    law.step(&standing(0.0), 0.0, &Velocity::new(0.5, 0.1), PERIOD)
        .unwrap();
    let before = law.clone();
    for wanted in [
        Velocity::new(f64::NAN, 0.0),
        Velocity::new(0.0, f64::INFINITY),
    ] {
        assert!(law.step(&standing(0.0), 0.0, &wanted, PERIOD).is_err());
        assert_eq!(law, before);
    }
}
