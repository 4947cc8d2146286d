//! The laws invert the kinematics.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test may fail")]

use proptest::prelude::*;
use singletrack_control::{
    Circle, FrontPointLaw, LawError, LimitedLaw, Limits, Motion, Position, ProportionalLoop,
    Reference, RelaxedSingleTrack, SingleTrack, SingleTrackState, Singularity, VehicleParameters,
    Velocity, VelocityPointLaw, direction,
};

const L_F: f64 = 0.1368;
const P: f64 = 0.35;

fn wheelbase() -> f64 {
    VehicleParameters::paper().wheelbase_m()
}

/// Equation 4: the velocity of P.
fn point_velocity(
    motion: &Motion,
    steering: f64,
    speed: f64,
    steering_rate: f64,
    l_f: f64,
    p: f64,
) -> Velocity {
    let left = |angle: f64| direction(angle + std::f64::consts::FRAC_PI_2);
    speed * direction(motion.yaw + motion.sideslip)
        + l_f * motion.yaw_rate * left(motion.yaw)
        + p * (motion.yaw_rate + steering_rate) * left(motion.yaw + steering)
}

prop_compose! {
    fn motions()(
        yaw in -7.0..7.0,
        yaw_rate in -4.0..4.0,
        sideslip in -0.6..0.6,
    ) -> Motion {
        Motion { yaw, yaw_rate, sideslip }
    }
}

proptest! {
    #[test]
    fn the_proposed_law_gives_p_the_wanted_velocity(
        motion in motions(),
        steering in -0.6..0.6,
        vx in -2.0..2.0,
        vy in -2.0..2.0,
    ) {
        let wanted = Velocity::new(vx, vy);
        let law = FrontPointLaw::new(L_F, P, wheelbase()).unwrap();
        let command = law.command(&motion, steering, &wanted).unwrap();
        let velocity =
            point_velocity(&motion, steering, command.speed, command.steering_rate, L_F, P);
        prop_assert!((velocity - wanted).norm() < 1e-12, "{velocity} against {wanted}");
    }

    #[test]
    fn with_a_wrong_centre_of_mass_the_deviation_is_that_of_equation_9(
        motion in motions(),
        steering in -0.6..0.6,
        assumed in 0.0..0.26,
    ) {
        let wanted = Velocity::new(0.4, -0.3);
        let law = FrontPointLaw::new(assumed, P, wheelbase()).unwrap();
        let command = law.command(&motion, steering, &wanted).unwrap();
        let velocity =
            point_velocity(&motion, steering, command.speed, command.steering_rate, L_F, P);
        let dl = assumed - L_F;
        let deviation =
            dl * motion.yaw_rate * Velocity::new(motion.yaw.sin(), -motion.yaw.cos());
        prop_assert!((velocity - wanted - deviation).norm() < 1e-12);
    }

    #[test]
    fn the_appendix_law_gives_its_point_the_wanted_velocity(
        motion in motions(),
        pace in 0.1..2.0,
        angle in -1.2..1.2,
    ) {
        let vehicle = VehicleParameters::paper();
        let law = VelocityPointLaw::new(vehicle, P).unwrap();
        let wanted = pace * direction(motion.yaw + motion.sideslip + angle);
        let command = law.command(&motion, &wanted).unwrap();
        let slope = SingleTrack::new(vehicle).derivative(
            &SingleTrackState {
                x: 0.0,
                y: 0.0,
                yaw: motion.yaw,
                yaw_rate: motion.yaw_rate,
                sideslip: motion.sideslip,
            },
            command.speed,
            command.steering,
        );
        let course = motion.yaw + motion.sideslip;
        let velocity = command.speed * direction(course)
            + P * (slope.yaw + slope.sideslip)
                * direction(course + std::f64::consts::FRAC_PI_2);
        prop_assert!((velocity - wanted).norm() < 1e-9, "{velocity} against {wanted}");
    }
}

#[test]
fn wheels_across_the_velocity_are_singular() {
    let law = FrontPointLaw::new(L_F, P, wheelbase()).unwrap();
    let motion = Motion {
        yaw: 0.0,
        yaw_rate: 0.0,
        sideslip: 0.0,
    };
    for steering in [1.48, 1.57, 1.66, -1.57] {
        assert!(matches!(
            law.command(&motion, steering, &Velocity::new(0.5, 0.0)),
            Err(Singularity::WheelsAcrossVelocity(_))
        ));
    }
    // The corner of the paper's typical range.
    let corner = Motion {
        sideslip: 40.0_f64.to_radians(),
        ..motion
    };
    assert!(
        law.command(&corner, -50.0_f64.to_radians(), &Velocity::new(0.5, 0.0))
            .is_err()
    );
}

#[test]
fn inputs_that_are_not_finite_are_refused() {
    let law = FrontPointLaw::new(L_F, P, wheelbase()).unwrap();
    let good = Motion {
        yaw: 0.1,
        yaw_rate: 0.2,
        sideslip: 0.1,
    };
    for bad in [f64::NAN, f64::INFINITY] {
        for motion in [
            Motion { yaw: bad, ..good },
            Motion {
                yaw_rate: bad,
                ..good
            },
            Motion {
                sideslip: bad,
                ..good
            },
        ] {
            assert!(law.command(&motion, 0.1, &Velocity::new(0.5, 0.0)).is_err());
        }
        assert!(law.command(&good, bad, &Velocity::new(0.5, 0.0)).is_err());
        assert!(law.command(&good, 0.1, &Velocity::new(0.5, bad)).is_err());
    }
}

#[test]
fn the_appendix_law_is_singular_at_standstill() {
    let law = VelocityPointLaw::new(VehicleParameters::paper(), P).unwrap();
    let motion = Motion {
        yaw: 0.0,
        yaw_rate: 0.0,
        sideslip: 0.0,
    };
    let error = law.command(&motion, &Velocity::new(0.0, 0.5)).unwrap_err();
    assert!(matches!(error, Singularity::Standstill(_)));
    assert!(error.to_string().contains("standstill") || error.to_string().contains("moves"));
}

#[test]
fn both_ends_of_the_valid_range_are_accepted_and_values_beyond_are_refused() {
    for accepted in [0.0, 0.26, L_F + 0.1232] {
        FrontPointLaw::new(accepted, P, wheelbase()).unwrap();
    }
    for refused in [-1e-6, 0.2601, f64::NAN] {
        assert!(matches!(
            FrontPointLaw::new(refused, P, wheelbase()),
            Err(LawError::FrontAxleDistance(..))
        ));
    }
    for refused in [0.0, -0.1, f64::NAN, f64::INFINITY] {
        assert!(matches!(
            FrontPointLaw::new(L_F, refused, wheelbase()),
            Err(LawError::PointDistance(_))
        ));
    }
}

const PERIOD: f64 = 0.01;

/// The largest distance of P from its reference during the last lap, in m: a circle at
/// `angular_velocity` (rad/s), driven for `seconds`.
fn final_error(yaw_deg: f64, start: Position, angular_velocity: f64, seconds: f64) -> f64 {
    let vehicle = VehicleParameters::paper();
    let model = RelaxedSingleTrack::new(vehicle);
    let law =
        FrontPointLaw::new(vehicle.front_axle_distance_m, 0.35, vehicle.wheelbase_m()).unwrap();
    let mut limited = LimitedLaw::new(law, Limits::paper());
    let reference =
        Reference::Circle(Circle::new(Position::origin(), 1.0, angular_velocity).unwrap());
    let tracking = ProportionalLoop {
        gain: Velocity::new(1.0, 1.0),
        feed_forward: true,
    };
    let mut state = SingleTrackState {
        x: start.x,
        y: start.y,
        yaw: yaw_deg.to_radians(),
        ..SingleTrackState::default()
    };
    let turn = std::f64::consts::TAU / angular_velocity.abs();
    let mut worst: f64 = 0.0;
    for tick in 0..(seconds / PERIOD) as u32 {
        let time = f64::from(tick) * PERIOD;
        let actuation = limited.actuation();
        let point = law.point(
            Position::new(state.x, state.y),
            state.yaw,
            actuation.steering,
        );
        let at = reference.at(time);
        let motion = Motion {
            yaw: state.yaw,
            yaw_rate: state.yaw_rate,
            sideslip: state.sideslip,
        };
        let wanted = tracking.velocity(&at, &point);
        let actuation = limited
            .step(&motion, actuation.speed, &wanted, PERIOD)
            .unwrap();
        assert!(actuation.speed >= 0.0, "the car reversed");
        for _ in 0..10 {
            let slope = model.derivative(&state, actuation.speed, actuation.steering);
            let h = PERIOD / 10.0;
            state.x += h * slope.x;
            state.y += h * slope.y;
            state.yaw += h * slope.yaw;
            state.yaw_rate += h * slope.yaw_rate;
            state.sideslip += h * slope.sideslip;
        }
        if time > seconds - turn {
            worst = worst.max((point - at.position.unwrap()).norm());
        }
    }
    worst
}

#[test]
fn the_car_reaches_its_circle_from_every_heading_place_and_direction_of_travel() {
    for angular_velocity in [0.5, -0.5, 0.3] {
        for yaw_deg in (0..360).step_by(30) {
            for start in [(1.5, -0.5), (0.0, 0.0), (-1.0, 1.0), (1.0, 0.0)] {
                let start = Position::new(start.0, start.1);
                let error = final_error(f64::from(yaw_deg), start, angular_velocity, 120.0);
                assert!(
                    error < 0.05,
                    "yaw {yaw_deg}, start {start}, {angular_velocity} rad/s: {error} m off"
                );
            }
        }
    }
}
