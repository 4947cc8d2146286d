//! The map of DART in `tools/real`, with a log in the layout of its logs.

use std::{fmt::Write as _, path::Path};

use singletrack_logs::import::Map;
use singletrack_pilot::{BoardState, Mode};

use crate::bench::{Imported, imported, since_ms};

const MAP: &str = include_str!("../../real/dart-map.toml");
const HEADER: &str = "elapsed time sensors,current,voltage,acc x (IMU),acc y (IMU),W (IMU),vel encoder,safety_value,throttle,steering,vicon time,vicon x,vicon y,vicon yaw";

/// Two seconds at 100 Hz, of which the second is driven: the board's values are new in every tenth
/// row and rise by 0.1 each time.
fn dart() -> Imported {
    let mut log = format!("{HEADER}\r\n");
    for row in 0..200_u32 {
        let sample = f64::from(row / 10) * 0.1;
        let (board_time, driving) = (30.0 + sample, f64::from(row / 100));
        let time = format!("{}.{:02}", 1_725_890_729 + row / 100, row % 100);
        let x = f64::from(row) * 0.01;
        writeln!(
            log,
            "{board_time},0.0,0.0,{sample},{},{},{sample},{driving},0.2,0.027,{time},{x},-1.0,-0.5\r",
            -sample,
            2.0 * sample
        )
        .unwrap();
    }
    imported(&log, MAP)
}

#[test]
fn every_pose_and_the_interpolated_samples_of_the_board_are_imported() {
    let dart = dart();
    assert_eq!(dart.meta.start.wall_ns, 1_725_890_729_000_000_000);
    assert_eq!(dart.poses().len(), 200);
    let last = dart.poses()[199];
    assert_eq!(
        (last.position.x, last.position.y, last.yaw),
        (1.99, -1.0, -0.5)
    );
    // New values from 0.1 to 1.9 s, 50 ms old, every 10 ms; the motor's are 40 ms old.
    let board = dart.board();
    assert_eq!(board.len(), 180);
    assert_eq!(dart.summary.without_motor_speed, 1);
    let (first, last) = (board[0], board[179]);
    assert_eq!(since_ms(first.time.0), 60.0);
    assert_eq!(since_ms(last.time.0), 1_850.0);
    for sample in board {
        // A slope of 1/s, of which the value at 0.1 s less the delay is 0.1.
        let time_s = since_ms(sample.time.0) / 1e3;
        let inertial = sample.inertial.unwrap();
        let near = |value: f64, expected: f64| (value - expected).abs() < 1e-9;
        assert!(
            near(inertial.forward_acceleration, time_s + 0.05),
            "{sample:?}"
        );
        assert!(
            near(inertial.left_acceleration, -(time_s + 0.05)),
            "{sample:?}"
        );
        assert!(near(inertial.yaw_rate, 2.0 * (time_s + 0.05)), "{sample:?}");
        assert!(near(sample.motor_speed, time_s + 0.04), "{sample:?}");
        let driven = sample.state == BoardState::Driving;
        assert_eq!(driven, time_s >= 1.0, "{sample:?}");
    }
}

#[test]
fn the_car_drives_while_the_dead_mans_switch_is_held_and_steers_as_commanded() {
    let dart = dart();
    for tick in dart.ticks() {
        let driving = since_ms(tick.scheduled_ns) >= 1_000.0;
        assert_eq!(tick.output.mode == Mode::Driving, driving);
        // At this command the wheels are straight.
        assert_eq!(tick.output.actuation.steering, 0.0);
        assert_eq!(tick.output.command, None);
    }
}

#[test]
fn the_table_of_the_steering_is_the_curve_of_the_authors() {
    let map = Map::from_toml(MAP, Path::new("dart-map.toml")).unwrap();
    let steering = &map.steering;
    let shift = 0.0030 - 0.03;
    for step in -10_000..=10_000 {
        let command = f64::from(step) / 10_000.0;
        let moved = command + shift;
        let curve = match moved > 0.0 {
            true => 0.366 * libm::tanh(1.393 * moved),
            false => 0.515 * libm::tanh(1.023 * moved),
        };
        let error = steering.angle(command) - curve;
        assert!(error.abs() < 1e-4, "{command}: {error}");
    }
}
