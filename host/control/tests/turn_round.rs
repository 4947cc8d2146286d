//! From any start, the car reaches its reference without reversing.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test may fail")]

use singletrack_control::{
    Circle, FrontPointLaw, LimitedLaw, Limits, Motion, Position, ProportionalLoop, Reference,
    RelaxedSingleTrack, SingleTrackState, VehicleParameters, Velocity,
};

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
