//! The car without board or host, and the hands on it: poses, samples of the IMU and motor pulses
//! agree.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    reason = "a test fails by panicking"
)]

use core::f64::consts::{FRAC_PI_2, PI};

use libm::{cos, sin};
use singletrack_control::{SingleTrack, SingleTrackState, VehicleParameters};
use singletrack_sim::{Car, CarParameters, HandMotion, SimulationConfig, StartPose, Truth, World};

/// Drives a car with constant pulses for whole servo frames.
fn drive(car: &mut Car, from_us: u64, frames: u64, servo_us: u16, esc_us: u16) -> u64 {
    let mut now = from_us;
    for _ in 0..frames {
        car.apply_pulses(servo_us, esc_us);
        now += 20_000;
        car.advance_to(now);
    }
    now
}

fn armed() -> (Car, u64) {
    let mut car = Car::new(CarParameters::default());
    let now = drive(&mut car, 0, 60, 1_500, 1_500);
    assert!(car.esc_is_armed());
    (car, now)
}

#[test]
fn a_car_at_rest_stays_at_rest() {
    let (mut car, now) = armed();
    drive(&mut car, now, 3_000, 1_300, 1_500);
    let truth = car.truth();
    assert_eq!((truth.x, truth.y, truth.yaw), (0.0, 0.0, 0.0));
    assert_eq!((truth.speed, truth.yaw_rate), (0.0, 0.0));
    assert_eq!(car.motor_pulses().count, 0);
}

#[test]
fn the_esc_does_not_drive_before_a_second_of_neutral() {
    let mut car = Car::new(CarParameters::default());
    drive(&mut car, 0, 100, 1_500, 1_600);
    assert_eq!(car.truth().wheel_speed, 0.0);
    assert!(!car.esc_is_armed());
}

#[test]
fn straight_ahead_is_straight_in_any_direction() {
    for yaw_rad in [0.0, 1.0, -2.5] {
        let mut car = Car::new(CarParameters {
            start: StartPose {
                x_m: 1.0,
                y_m: -2.0,
                yaw_rad,
            },
            ..CarParameters::default()
        });
        let now = drive(&mut car, 0, 60, 1_500, 1_500);
        drive(&mut car, now, 200, 1_500, 1_570);
        let truth = car.truth();
        let (dx, dy) = (truth.x - 1.0, truth.y + 2.0);
        let along = dx * cos(yaw_rad) + dy * sin(yaw_rad);
        let across = -dx * sin(yaw_rad) + dy * cos(yaw_rad);
        assert!(along > 1.0 && across.abs() < 1e-9, "{along} {across}");
        assert_eq!((truth.yaw, truth.sideslip), (yaw_rad, 0.0));
    }
}

#[test]
fn pulses_measure_the_distance_rolled() {
    let (mut car, now) = armed();
    drive(&mut car, now, 250, 1_500, 1_570);
    let truth = car.truth();
    let distance = f64::from(car.motor_pulses().count) * 0.003;
    assert!(
        (distance - truth.x).abs() <= 0.003,
        "{distance} {}",
        truth.x
    );
}

#[test]
fn the_wheels_follow_the_servo_at_its_rate_and_within_its_stops() {
    let (mut car, now) = armed();
    car.apply_pulses(1_100, 1_500);
    let mut before = car.truth().steering;
    for ms in 1..=400 {
        car.advance_to(now + ms * 1_000);
        let steering = car.truth().steering;
        assert!((steering - before) * 1e3 <= 8.0 + 1e-9);
        before = steering;
    }
    assert!((before - 0.5).abs() < 1e-3, "{before}");
    drive(&mut car, now + 400_000, 50, 2_200, 1_500);
    assert!((car.truth().steering + 0.55).abs() < 1e-3);
}

#[test]
fn a_delay_lets_later_pulses_act_later_and_leaves_the_earlier_ones() {
    let (mut car, now) = armed();
    car.apply_pulses(1_100, 1_500);
    car.delay_pulses(100_000);
    car.apply_pulses(1_900, 1_500);
    car.advance_to(now + 90_000);
    assert!(car.truth().steering > 0.2, "{}", car.truth().steering);
    car.advance_to(now + 300_000);
    assert!(car.truth().steering < -0.2, "{}", car.truth().steering);
}

#[test]
fn a_rolling_car_stops_without_reversing() {
    for esc_us in [1_500, 1_350, 0] {
        let (mut car, now) = armed();
        let now = drive(&mut car, now, 100, 1_400, 1_600);
        let mut before = car.truth().wheel_speed;
        assert!(before > 0.4);
        for ms in 1..=3_000 {
            if ms % 20 == 1 && esc_us != 0 {
                car.apply_pulses(1_400, esc_us);
            }
            car.advance_to(now + ms * 1_000);
            let speed = car.truth().wheel_speed;
            // After the dead time it only slows down.
            assert!(speed >= 0.0 && (ms < 150 || speed <= before));
            before = speed;
        }
        assert_eq!(before, 0.0, "{esc_us} us");
    }
}

#[test]
fn reverse_needs_the_brake_first_and_then_neutral() {
    let (mut car, now) = armed();
    let now = drive(&mut car, now, 100, 1_500, 1_570);
    let now = drive(&mut car, now, 100, 1_500, 1_440);
    assert_eq!(car.truth().wheel_speed, 0.0);
    let now = drive(&mut car, now, 10, 1_500, 1_500);
    drive(&mut car, now, 100, 1_500, 1_440);
    assert!(car.truth().wheel_speed < -0.1);
}

/// The paper's circle: 1 m at 0.5 rad/s ends on v = 0.397455 m/s with a
/// steering of 0.328643 rad and a sideslip of 0.153467 rad.
#[test]
fn the_steady_circle_matches_the_paper_to_first_order() {
    let (speed, steering) = (0.397_455, 0.328_643);
    // A motor that holds exactly this speed of G.
    let mut parameters = CarParameters::default();
    parameters.servo.gain_us_per_rad = -1_000.0;
    let (mut car, mut now) = {
        let mut car = Car::new(parameters);
        let now = drive(&mut car, 0, 60, 1_500, 1_500);
        (car, now)
    };
    let servo_us = (1_500.0 - steering * 1_000.0_f64).round() as u16;
    let mut esc_us = 1_570;
    for _ in 0..600 {
        now = drive(&mut car, now, 1, servo_us, esc_us);
        // Integer pulses, dithered around the speed.
        esc_us = if car.truth().speed < speed {
            1_572
        } else {
            1_566
        };
    }
    let truth = car.truth();
    assert!((truth.speed - speed).abs() < 0.01, "{}", truth.speed);

    // The paper's equations at the car's own speed and steering.
    let model = SingleTrack::new(VehicleParameters::paper());
    let mut linear = SingleTrackState::default();
    for _ in 0..200_000 {
        let d = model.derivative(&linear, truth.speed, truth.steering);
        linear.yaw_rate += 1e-4 * d.yaw_rate;
        linear.sideslip += 1e-4 * d.sideslip;
    }
    assert!((linear.sideslip - 0.153_467).abs() < 0.003, "{linear:?}");
    // tan(steering) exceeds steering by 3.7 %, and the tyres saturate slightly.
    assert!((truth.sideslip - linear.sideslip).abs() < 0.01, "{truth:?}");
    assert!(
        (truth.yaw_rate - linear.yaw_rate).abs() < 0.04 * linear.yaw_rate.abs(),
        "{truth:?} {linear:?}"
    );
    let radius = truth.speed / truth.yaw_rate;
    assert!((truth.lateral_acceleration - truth.speed * truth.speed / radius).abs() < 0.03);
}

#[test]
fn the_step_size_has_no_effect() {
    // The same drive in steps of 1 ms and of odd sizes, so that the actuators' inputs
    // change within different steps.
    let run = |pieces: &[u64]| {
        let (mut car, start) = armed();
        let mut now = start;
        for frame in 0..100 {
            car.apply_pulses(1_350, 1_580);
            let end = start + (frame + 1) * 20_000;
            let mut piece = pieces.iter().cycle();
            while now < end {
                now = (now + piece.next().unwrap()).min(end);
                car.advance_to(now);
            }
        }
        car.truth()
    };
    let (a, b) = (run(&[1_000]), run(&[333, 17, 650, 999]));
    assert!((a.x - b.x).abs() < 1e-4 && (a.y - b.y).abs() < 1e-4);
    assert!((a.yaw - b.yaw).abs() < 1e-4);
}

fn world() -> World {
    let mut world = World::new(SimulationConfig::default()).unwrap();
    world.advance_to(1_000_000);
    world
}

/// Begins a motion and lets it end; gives the truth of every millisecond.
fn run(world: &mut World, motion: HandMotion) -> Vec<Truth> {
    world.car.begin_by_hand(motion);
    let mut truths = Vec::new();
    while world.car.is_in_motion_by_hand() {
        assert!(truths.len() < 60_000, "the motion does not end");
        let next = world.now_us / 1_000 + 1;
        world.advance_to(next * 1_000);
        truths.push(world.truth());
    }
    truths
}

#[test]
fn a_rolled_car_covers_its_distance_with_its_pulses() {
    for distance_m in [0.5, -0.7] {
        let mut world = world();
        let before = world.car.motor_pulses().count;
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
        let pulses = f64::from(world.car.motor_pulses().count.wrapping_sub(before));
        assert!((pulses - distance_m.abs() / 0.003).abs() <= 2.0, "{pulses}");
    }
}

#[test]
fn a_turn_keeps_its_point_and_its_rates_add_up() {
    let mut world = world();
    let rear = world.config.car.vehicle.rear_axle_distance_m;
    let before = world.car.motor_pulses().count;
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
    let pulses = world.car.motor_pulses().count.wrapping_sub(before);
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
    assert!(world.car.wheels_are_up() && world.truth().held);
    let place = world.truth();
    let pulse = |world: &mut World, esc_us: u16, ms: u64| {
        for _ in 0..ms / 20 {
            world.car.apply_pulses(1_500, esc_us);
            let next = world.now_us + 20_000;
            world.advance_to(next);
        }
    };
    let before = world.car.motor_pulses().count;
    pulse(&mut world, 1_500, 1_500);
    pulse(&mut world, 1_560, 1_000);
    let spinning = world.truth();
    assert!(spinning.wheel_speed > 0.2, "{}", spinning.wheel_speed);
    assert_eq!(
        (spinning.x, spinning.y, spinning.yaw),
        (place.x, place.y, place.yaw)
    );
    assert!(spinning.speed == 0.0 && spinning.way == place.way);
    assert!(world.car.motor_pulses().count > before + 20);
    run(&mut world, HandMotion::PutDown);
    assert!(!world.truth().held && !world.car.wheels_are_up());
    pulse(&mut world, 1_560, 1_000);
    assert!(world.truth().x > place.x + 0.1, "{}", world.truth().x);
}

#[test]
fn a_carried_car_arrives_and_its_wheels_do_not_turn() {
    let mut world = world();
    let before = world.car.motor_pulses().count;
    let to = StartPose {
        x_m: 1.0,
        y_m: -0.5,
        yaw_rad: FRAC_PI_2,
    };
    let truths = run(&mut world, HandMotion::Carry { to, for_s: 3.0 });
    let end = truths.last().unwrap();
    assert!((end.x - 1.0).abs() < 1e-9 && (end.y + 0.5).abs() < 1e-9);
    assert!((end.yaw - FRAC_PI_2).abs() < 1e-9);
    assert_eq!(world.car.motor_pulses().count, before);
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
        world.car.apply_pulses(servo_us, 1_500);
        let next = world.now_us + 20_000;
        world.advance_to(next);
    }
    let truth = world.truth();
    assert!(
        truth.wheel_speed > 0.3 && truth.steering.abs() < 1e-9,
        "{truth:?}"
    );
}
