//! The forms of the vehicle model against each other.

use proptest::prelude::*;
use singletrack_control::{
    Axles, GRAVITY, LateralMotion, Libm, RelaxedSingleTrack, SingleTrack, SingleTrackDerivative,
    SingleTrackState, SlipAngles, Tyres, VehicleParameters,
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
        let forces = axles.forces::<Libm, f64>(&motion);
        let rate = axles.lateral::<Libm, f64>(&motion, &forces);
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
        let forward = LateralMotion { yaw_rate, sideslip: -sideslip, speed, steering: -steering };
        let reverse = LateralMotion { yaw_rate, sideslip, speed: -speed, steering };
        for slip_angles in [SlipAngles::Small, SlipAngles::Exact] {
            let axles = Axles::new(VehicleParameters::paper(), Tyres::Saturating);
            let axles = axles.with_slip_angles(slip_angles);
            prop_assert_eq!(
                axles.forces::<Libm, f64>(&reverse),
                axles.forces::<Libm, f64>(&forward)
            );
        }
    }

    #[test]
    fn exact_slip_angles_are_those_between_wheels_and_velocities(
        yaw_rate in -3.0..3.0,
        sideslip in -0.4..0.4_f64,
        speed in 0.2..8.0,
        steering in -0.5..0.5_f64,
    ) {
        let vehicle = VehicleParameters::paper();
        let axles = Axles::new(vehicle, Tyres::Linear).with_slip_angles(SlipAngles::Exact);
        let motion = LateralMotion { yaw_rate, sideslip, speed, steering };
        let rate = axles.lateral::<Libm, f64>(&motion, &axles.forces::<Libm, f64>(&motion));
        let expected = by_velocities(&vehicle, &motion);
        assert_near(rate.yaw_rate, expected[0], 1e-9);
        assert_near(rate.sideslip, expected[1], 1e-6);
    }

    #[test]
    fn exact_slip_angles_are_the_small_ones_to_second_order(
        yaw_rate in -1e-3..1e-3,
        sideslip in -1e-3..1e-3,
        speed in 0.2..8.0,
        steering in -1e-3..1e-3,
    ) {
        let motion = LateralMotion { yaw_rate, sideslip, speed, steering };
        let [small, exact] = [SlipAngles::Small, SlipAngles::Exact].map(|slip_angles| {
            let axles = Axles::new(VehicleParameters::paper(), Tyres::Saturating);
            let axles = axles.with_slip_angles(slip_angles);
            axles.lateral::<Libm, f64>(&motion, &axles.forces::<Libm, f64>(&motion))
        });
        assert_near(exact.yaw_rate, small.yaw_rate, 1e-4);
        assert_near(exact.sideslip, small.sideslip, 1e-4);
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

/// Yaw acceleration and sideslip rate of a car with linear tyres whose rear wheels keep their
/// speed, from the velocities and forces as vectors in the car's frame.
fn by_velocities(vehicle: &VehicleParameters, motion: &LateralMotion) -> [f64; 2] {
    let LateralMotion {
        yaw_rate: r,
        sideslip,
        speed,
        steering,
    } = *motion;
    let [along, across] = [speed * sideslip.cos(), speed * sideslip.sin()];
    let force = |at: f64, angle: f64, stiffness: f64| {
        let course = (across + r * at).atan2(along);
        let size = stiffness * (angle - course);
        // Across the wheels.
        size * angle.cos()
    };
    let (l_f, l_r) = (vehicle.front_axle_distance_m, vehicle.rear_axle_distance_m);
    let front = force(l_f, steering, vehicle.front_cornering_stiffness_n_rad);
    let rear = force(-l_r, 0.0, vehicle.rear_cornering_stiffness_n_rad);
    let across_rate = (front + rear) / vehicle.mass_kg - along * r;
    let h = 1e-6;
    let after = (across + h * across_rate).atan2(along);
    let before = (across - h * across_rate).atan2(along);
    [
        (l_f * front - l_r * rear) / vehicle.yaw_inertia_kg_m2,
        (after - before) / (2.0 * h),
    ]
}

/// With C = 1.3 the curve has its peak where B α = tan(π / 2.6).
#[test]
fn the_magic_formula_has_stiffness_peak_and_slide_of_its_parameters() {
    let vehicle = VehicleParameters::paper();
    let axles = Axles::new(vehicle, Tyres::MagicFormula);
    let load = vehicle.mass_kg * GRAVITY * vehicle.rear_axle_distance_m / vehicle.wheelbase_m();
    let limit = vehicle.friction * load;
    let force = |slip: f64| {
        let motion = LateralMotion {
            yaw_rate: 0.0,
            sideslip: 0.0,
            speed: 1.0,
            steering: slip,
        };
        axles.forces::<Libm, f64>(&motion).front
    };
    let stiffness = vehicle.front_cornering_stiffness_n_rad;
    assert_near(force(1e-6) / 1e-6, stiffness, 1e-6);
    let peak = (core::f64::consts::PI / 2.6).tan() * 1.3 * limit / stiffness;
    assert_near(force(peak), limit, 1e-12);
    assert!(force(0.9 * peak) < limit && force(1.1 * peak) < limit);
    assert_near(
        force(1e6) / limit,
        (0.65 * core::f64::consts::PI).sin(),
        1e-6,
    );
    assert_near(force(-peak), -limit, 1e-12);
}
