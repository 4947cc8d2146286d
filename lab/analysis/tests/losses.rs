//! The sampled loop when poses are lost: every pattern, and random bursts.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test may fail")]

use proptest::prelude::*;
use singletrack_analysis::stability::{
    Ages, ClosedLoop, Law, MarginLimits, OneLength, RandomLosses, SampledLoop, Servo, Timing,
};
use singletrack_control::VehicleParameters;

fn sampled(law: Law, speed: f64) -> SampledLoop {
    let closed_loop = ClosedLoop::new(VehicleParameters::paper(), law, 0.35, speed, 0.0).unwrap();
    SampledLoop::new(closed_loop, Timing::new(0.01, 0.01)).unwrap()
}

/// The certified intervals and the witnesses of an analysis in another language.
#[test]
fn irregular_poses_need_shorter_intervals_than_regular_ones() {
    for (speed, proved, unstable, constant) in [(3.0, 29, 32, 49), (5.0, 12, 15, 33)] {
        let sampled = sampled(Law::FrontPoint, speed);
        let limits = sampled.irregular_limits(60);
        assert_eq!(limits.proved, proved);
        let pattern = limits.unstable.unwrap();
        assert_eq!(pattern.long, unstable);
        assert!(pattern.growth > 1.0, "{pattern:?}");
        assert!(sampled.unstable_pattern(proved).is_none());
        let regular = sampled.longest_constant_interval(MarginLimits::default());
        assert!((regular.unwrap() - 0.01 * f64::from(constant)).abs() < 1e-9);
    }
}

#[test]
fn a_function_falls_over_every_interval_on_the_simulated_car_and_under_the_appendix() {
    let timing = Timing {
        servo: Some(Servo {
            lag: 0.04,
            dead_time: 0.002,
        }),
        servo_frame: 2,
        predicted_pose: 2,
        ages: Ages {
            yaw_rate: 0.005,
            sideslip: 0.0,
        },
        ..Timing::new(0.01, 0.007)
    };
    let closed_loop =
        ClosedLoop::new(VehicleParameters::paper(), Law::FrontPoint, 0.35, 3.0, 0.0).unwrap();
    let simulated = SampledLoop::new(closed_loop, timing).unwrap();
    assert!(simulated.irregular(10).common_function().is_some());
    assert!(simulated.unstable_pattern(24).is_some());
    let appendix = sampled(Law::VelocityPoint, 3.0);
    assert!(appendix.irregular(10).common_function().is_some());
}

#[test]
fn bursts_are_survived_in_the_mean_square_up_to_a_share() {
    let sampled = sampled(Law::FrontPoint, 3.0);
    let survives = |share, mean_ticks| {
        let switched = sampled.with_random_losses(RandomLosses { share, mean_ticks });
        switched.mean_square_function().is_some()
    };
    assert!(survives(0.41, 30.0) && !survives(0.5, 30.0));
    assert!(survives(0.9, 10.0));
}

prop_compose! {
    fn cars()(
        mass in 1.0..5.0_f64,
        front in 0.08..0.25_f64,
        rear in 0.08..0.25_f64,
        inertia in 0.3..2.0_f64,
        stiffness in 15.0..80.0_f64,
        share in 0.3..3.0_f64,
    ) -> VehicleParameters {
        VehicleParameters {
            mass_kg: mass,
            yaw_inertia_kg_m2: inertia * mass * front * rear,
            front_axle_distance_m: front,
            rear_axle_distance_m: rear,
            friction: 0.5,
            front_cornering_stiffness_n_rad: stiffness * mass,
            rear_cornering_stiffness_n_rad: stiffness * share * mass,
        }
    }
}

/// Whether the motion is stable for 101 deviations over the meaningful range.
fn is_stable(vehicle: VehicleParameters, p: f64, speed: f64) -> bool {
    let [from, to] = ClosedLoop::meaningful_deviations(&vehicle);
    (0..=100).all(|step| {
        let deviation = from + (to - from) * f64::from(step) / 100.0;
        ClosedLoop::new(vehicle, Law::FrontPoint, p, speed, deviation)
            .unwrap()
            .is_stable()
    })
}

proptest! {
    #[test]
    fn the_closed_form_has_the_distances_of_hurwitz_criterion(car in cars(), speed in 0.5..20.0_f64) {
        let ranges = OneLength::of(car, speed).unwrap().distances;
        let mut places: Vec<(f64, bool)> = Vec::new();
        for [from, to] in &ranges {
            places.push((from * (1.0 + 1e-6) + 1e-6, true));
            if *from > 1e-6 {
                places.push((from * (1.0 - 1e-6), false));
            }
            if to.is_finite() {
                places.push((to * (1.0 - 1e-6), true));
                places.push((to * (1.0 + 1e-6), false));
            } else {
                places.push((10.0 * from + 10.0, true));
            }
        }
        for (p, expected) in places {
            prop_assert_eq!(is_stable(car, p, speed), expected, "p = {} m of {:?}", p, ranges);
        }
    }

    /// With a short period, whose hold adds half of it to the delay.
    #[test]
    fn an_actuator_within_its_bound_leaves_the_motion_stable(
        car in cars(),
        speed in 0.5..6.0_f64,
        distance in 1.0..3.0_f64,
        share in 0.05..0.95_f64,
    ) {
        let p = distance * car.wheelbase_m();
        let closed_loop = ClosedLoop::new(car, Law::FrontPoint, p, speed, 0.0).unwrap();
        let Some(bound) = closed_loop.actuation_bound() else {
            prop_assert!(!closed_loop.is_stable());
            return Ok(());
        };
        let period = bound / 12.0;
        let all = 0.99 * bound - 0.5 * period;
        let servo = Servo { lag: share * all, dead_time: 0.0 };
        let timing = Timing { servo: Some(servo), ..Timing::new(period, (1.0 - share) * all) };
        let sampled = SampledLoop::new(closed_loop, timing).unwrap();
        prop_assert!(sampled.is_stable(), "{} s", bound);
    }
}
