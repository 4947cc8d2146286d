//! The car without board or host.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    reason = "a test fails by panicking"
)]

use libm::{cos, sin};
use singletrack_control::{SingleTrack, SingleTrackState, VehicleParameters};
use singletrack_sim::{Car, CarParameters, StartPose};

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
