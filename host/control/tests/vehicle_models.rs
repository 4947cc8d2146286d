//! The forms of the vehicle model against each other.

use proptest::prelude::*;
use singletrack_control::{
    Axles, LateralMotion, Libm, RelaxedSingleTrack, SingleTrack, SingleTrackDerivative,
    SingleTrackState, Tyres, VehicleParameters,
};

fn assert_near(value: f64, expected: f64, tolerance: f64) {
    assert!(
        (value - expected).abs() <= tolerance * (1.0 + expected.abs()),
        "{value} {expected}"
    );
}

/// Equations 1 and 2 as printed, with the operations in that order.
fn as_printed(state: &SingleTrackState, v: f64, delta: f64) -> SingleTrackDerivative {
    let VehicleParameters {
        mass_kg: m,
        yaw_inertia_kg_m2: i_z,
        front_axle_distance_m: l_f,
        rear_axle_distance_m: l_r,
        front_cornering_stiffness_n_rad: c_f,
        rear_cornering_stiffness_n_rad: c_r,
        ..
    } = VehicleParameters::paper();
    let SingleTrackState {
        yaw,
        yaw_rate: r,
        sideslip: beta,
        ..
    } = *state;
    SingleTrackDerivative {
        x: v * libm::cos(yaw + beta),
        y: v * libm::sin(yaw + beta),
        yaw: r,
        yaw_rate: (c_r * l_r - c_f * l_f) / i_z * beta
            - (c_f * l_f * l_f + c_r * l_r * l_r) / (i_z * v) * r
            + c_f * l_f / i_z * delta,
        sideslip: -(c_f + c_r) / (m * v) * beta
            + ((c_r * l_r - c_f * l_f) / (m * v * v) - 1.0) * r
            + c_f / (m * v) * delta,
    }
}

proptest! {
    /// The generic model does not change the bits of drives and simulations.
    #[test]
    fn the_model_of_f64_has_the_bits_of_the_equations_as_printed(
        yaw in -10.0..10.0,
        yaw_rate in -3.0..3.0,
        sideslip in -0.4..0.4,
        speed in 0.01..8.0,
        steering in -0.5..0.5,
    ) {
        let state = SingleTrackState { x: 0.3, y: -0.2, yaw, yaw_rate, sideslip };
        let rate = SingleTrack::new(VehicleParameters::paper()).derivative(&state, speed, steering);
        prop_assert_eq!(rate, as_printed(&state, speed, steering));
    }

    #[test]
    fn newtons_equations_with_linear_tyres_are_equation_1(
        yaw_rate in -3.0..3.0,
        sideslip in -0.4..0.4_f64,
        speed in 0.1..8.0,
        steering in -0.5..0.5_f64,
    ) {
        let vehicle = VehicleParameters::paper();
        let motion = LateralMotion { yaw_rate, sideslip, speed, steering };
        let axles = Axles::new(vehicle, Tyres::Linear);
        let rate = axles.lateral(&motion, &axles.forces::<Libm, f64>(&motion));
        let expected = SingleTrack::new(vehicle).lateral(&motion);
        assert_near(rate.yaw_rate, expected.yaw_rate, 1e-11);
        assert_near(rate.sideslip, expected.sideslip, 1e-11);
    }

    #[test]
    fn saturating_forces_are_linear_for_small_slip_and_stay_below_the_friction_of_their_axle(
        yaw_rate in -3.0..3.0,
        sideslip in -0.4..0.4_f64,
        speed in 0.1..8.0,
        steering in -0.5..0.5_f64,
    ) {
        let vehicle = VehicleParameters::paper();
        let [linear, saturating] =
            [Tyres::Linear, Tyres::Saturating].map(|tyres| Axles::new(vehicle, tyres));
        let motion = LateralMotion { yaw_rate, sideslip, speed, steering };
        let forces = saturating.forces::<Libm, f64>(&motion);
        let limit = vehicle.friction * vehicle.mass_kg * singletrack_control::GRAVITY;
        prop_assert!(forces.front.abs() <= limit * vehicle.rear_axle_distance_m / 0.26 * 1.000_001);
        prop_assert!(forces.rear.abs() <= limit * vehicle.front_axle_distance_m / 0.26 * 1.000_001);

        let small = LateralMotion {
            yaw_rate: 1e-5 * yaw_rate,
            sideslip: 1e-5 * sideslip,
            speed,
            steering: 1e-5 * steering,
        };
        let forces = saturating.forces::<Libm, f64>(&small);
        let expected = linear.forces::<Libm, f64>(&small);
        assert_near(forces.front, expected.front, 1e-5);
        assert_near(forces.rear, expected.rear, 1e-5);
    }

    #[test]
    fn reversing_has_the_forces_of_going_forward_with_the_angles_reversed(
        yaw_rate in -3.0..3.0,
        sideslip in -0.4..0.4_f64,
        speed in 0.1..8.0,
        steering in -0.5..0.5_f64,
    ) {
        let axles = Axles::new(VehicleParameters::paper(), Tyres::Saturating);
        let forward = LateralMotion { yaw_rate, sideslip: -sideslip, speed, steering: -steering };
        let reverse = LateralMotion { yaw_rate, sideslip, speed: -speed, steering };
        prop_assert_eq!(
            axles.forces::<Libm, f64>(&reverse),
            axles.forces::<Libm, f64>(&forward)
        );
    }

    #[test]
    fn the_relaxed_model_at_speed_is_the_papers_for_small_slip(
        yaw_rate in -1e-3..1e-3,
        sideslip in -1e-3..1e-3,
        speed in 0.2..8.0,
        steering in -1e-3..1e-3,
    ) {
        let vehicle = VehicleParameters::paper();
        let state = SingleTrackState { x: 0.3, y: -0.2, yaw: 0.7, yaw_rate, sideslip };
        let rate = RelaxedSingleTrack::new(vehicle).derivative(&state, speed, steering);
        let expected = SingleTrack::new(vehicle).derivative(&state, speed, steering);
        prop_assert_eq!((rate.x, rate.y, rate.yaw), (expected.x, expected.y, expected.yaw));
        assert_near(rate.yaw_rate, expected.yaw_rate, 2e-3);
        assert_near(rate.sideslip, expected.sideslip, 2e-3);
    }
}
