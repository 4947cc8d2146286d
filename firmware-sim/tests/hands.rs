//! The hands on the simulated car: poses, samples of the IMU and motor pulses agree.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    reason = "a test fails by panicking"
)]

use core::f64::consts::{FRAC_PI_2, PI};

use singletrack_sim::{HandMotion, SimulationConfig, StartPose, Truth, World};

fn world() -> World {
    let mut world = World::new(SimulationConfig::default()).unwrap();
    world.advance_to(1_000_000);
    world
}

/// Begins a motion and lets it end; gives the truth of every millisecond.
fn run(world: &mut World, motion: HandMotion) -> Vec<Truth> {
    world.car_mut().begin_by_hand(motion);
    let mut truths = Vec::new();
    while world.car().is_in_motion_by_hand() {
        assert!(truths.len() < 60_000, "the motion does not end");
        let next = world.now_us() / 1_000 + 1;
        world.advance_to(next * 1_000);
        truths.push(world.truth());
    }
    truths
}

#[test]
fn a_rolled_car_covers_its_distance_with_its_pulses() {
    for distance_m in [0.5, -0.7] {
        let mut world = world();
        let before = world.car().motor_pulses().count;
        let truths = run(
            &mut world,
            HandMotion::Roll {
                distance_m,
                speed_m_s: 0.4,
            },
        );
        let end = truths.last().unwrap();
        assert!((end.x - distance_m).abs() < 0.002, "{}", end.x);
        assert!(end.wheel_speed.abs() < 0.01, "{}", end.wheel_speed);
        let fastest = truths
            .iter()
            .map(|truth| truth.wheel_speed.abs())
            .fold(0.0, f64::max);
        assert!((fastest - 0.4).abs() < 1e-9, "{fastest}");
        // 3 mm each.
        let pulses = f64::from(world.car().motor_pulses().count.wrapping_sub(before));
        assert!((pulses - distance_m.abs() / 0.003).abs() <= 2.0, "{pulses}");
    }
}

#[test]
fn a_turn_keeps_its_point_and_its_rates_add_up() {
    let mut world = world();
    let rear = world.config().car.vehicle.rear_axle_distance_m;
    let before = world.car().motor_pulses().count;
    let truths = run(
        &mut world,
        HandMotion::Turn {
            angle_rad: 2.0 * PI,
            about_m: [-rear, 0.0],
            wander_m: 0.0,
            for_s: 10.0,
        },
    );
    for truth in &truths {
        let [x, y] = [
            truth.x - rear * truth.yaw.cos(),
            truth.y - rear * truth.yaw.sin(),
        ];
        assert!((x + rear).hypot(y) < 1e-6, "{x} {y}");
    }
    let turned: f64 = truths.iter().map(|truth| truth.yaw_rate * 1e-3).sum();
    assert!((turned - 2.0 * PI).abs() < 1e-3, "{turned}");
    // G circles about the rear axle: its acceleration is towards it, and grows with the speed.
    let fastest = truths
        .iter()
        .max_by(|a, b| a.yaw_rate.total_cmp(&b.yaw_rate))
        .unwrap();
    let centripetal = -rear * fastest.yaw_rate * fastest.yaw_rate;
    assert!((fastest.longitudinal_acceleration - centripetal).abs() < 1e-3);
    // The middle of the rear axle does not roll.
    let pulses = world.car().motor_pulses().count.wrapping_sub(before);
    assert!(pulses <= 1, "{pulses}");
}

#[test]
fn a_tilted_car_turns_about_one_axis_and_comes_back() {
    let mut world = world();
    let truths = run(
        &mut world,
        HandMotion::Tilt {
            roll_rad: 0.0,
            pitch_rad: -0.8,
            for_s: 3.0,
        },
    );
    let least = truths.iter().map(|truth| truth.pitch).fold(0.0, f64::min);
    assert!((least + 0.8).abs() < 1e-9, "{least}");
    let mut pitch = 0.0;
    for truth in &truths {
        pitch += truth.pitch_rate * 1e-3;
        assert!(
            (pitch - truth.pitch).abs() < 2e-3,
            "{pitch} {}",
            truth.pitch
        );
        assert!(truth.roll == 0.0 && truth.roll_rate == 0.0);
    }
    assert!(world.truth().pitch == 0.0);
}

#[test]
fn a_lifted_car_stays_while_its_wheels_turn_and_drives_when_it_is_put_down() {
    let mut world = world();
    // Its own pulses would come between those of the test.
    world.set_board_power(false);
    run(&mut world, HandMotion::Lift { height_m: 0.1 });
    assert!(world.car().wheels_are_up() && world.truth().held);
    let place = world.truth();
    let pulse = |world: &mut World, esc_us: u16, ms: u64| {
        for _ in 0..ms / 20 {
            world.car_mut().apply_pulses(1_500, esc_us);
            let next = world.now_us() + 20_000;
            world.advance_to(next);
        }
    };
    let before = world.car().motor_pulses().count;
    pulse(&mut world, 1_500, 1_500);
    pulse(&mut world, 1_560, 1_000);
    let spinning = world.truth();
    assert!(spinning.wheel_speed > 0.2, "{}", spinning.wheel_speed);
    assert_eq!(
        (spinning.x, spinning.y, spinning.yaw),
        (place.x, place.y, place.yaw)
    );
    assert!(spinning.speed == 0.0 && spinning.way == place.way);
    assert!(world.car().motor_pulses().count > before + 20);
    run(&mut world, HandMotion::PutDown);
    assert!(!world.truth().held && !world.car().wheels_are_up());
    pulse(&mut world, 1_560, 1_000);
    assert!(world.truth().x > place.x + 0.1, "{}", world.truth().x);
}

#[test]
fn a_carried_car_arrives_and_its_wheels_do_not_turn() {
    let mut world = world();
    let before = world.car().motor_pulses().count;
    let to = StartPose {
        x_m: 1.0,
        y_m: -0.5,
        yaw_rad: FRAC_PI_2,
    };
    let truths = run(&mut world, HandMotion::Carry { to, for_s: 3.0 });
    let end = truths.last().unwrap();
    assert!((end.x - 1.0).abs() < 1e-9 && (end.y + 0.5).abs() < 1e-9);
    assert!((end.yaw - FRAC_PI_2).abs() < 1e-9);
    assert_eq!(world.car().motor_pulses().count, before);
    assert!(truths.iter().any(|truth| truth.height > 0.1));
    assert!(!world.truth().held);
}

#[test]
fn exchanged_plugs_exchange_the_pulses() {
    let mut config = SimulationConfig::default();
    config.car.swapped_wires = true;
    let mut world = World::new(config).unwrap();
    for index in 0..200 {
        let servo_us = if index < 120 { 1_500 } else { 1_600 };
        world.car_mut().apply_pulses(servo_us, 1_500);
        let next = world.now_us() + 20_000;
        world.advance_to(next);
    }
    let truth = world.truth();
    assert!(
        truth.wheel_speed > 0.3 && truth.steering.abs() < 1e-9,
        "{truth:?}"
    );
}
