//! Closed-loop scenarios, for the native board and for the image.

use singletrack_protocol::{
    BoardMode, ImuState, RefusalReason, ResetCause, StopCause, ToBoard, UNSOLICITED,
};
use singletrack_sim::{
    BoardParameters, Hang, MotorSensorFault, SERVO_FRAME_US, ScriptedDrive, SimulationConfig,
    WireFaults,
};

use super::KIND;

pub(crate) fn seeded(seed: u64) -> SimulationConfig {
    SimulationConfig {
        seed,
        board: BoardParameters {
            kind: KIND,
            ..BoardParameters::default()
        },
        ..SimulationConfig::default()
    }
}

pub(crate) fn armed(config: SimulationConfig) -> ScriptedDrive {
    let drive = ScriptedDrive::armed(config).unwrap();
    let refusals = &drive.host.refusals;
    assert_eq!(drive.host.mode(), Some(BoardMode::Armed), "{refusals:?}");
    drive
}

/// Distance from neutral within which the motor is not driven, in µs.
const DEADBAND_US: u16 = 26;

/// Starts a car with a ramp of 2 m/s²; returns its greatest and its last speed.
pub(crate) fn start(
    config: SimulationConfig,
    pulse_distance_um: u16,
    speed_mm_s: i16,
) -> (f64, f64) {
    let mut bench = ScriptedDrive::new(config).unwrap();
    bench.configuration.speed.pulse_distance_um = pulse_distance_um;
    bench.run_ms(200);
    bench.prepare();
    let mut fastest = 0.0_f64;
    for tick in 1..=150 {
        bench.drive(1, (20 * tick).min(speed_mm_s), 0, |bench| {
            fastest = fastest.max(bench.world.truth().wheel_speed);
        });
    }
    let cause = bench.host.telemetry.map(|telemetry| telemetry.stop_cause);
    assert_eq!(bench.host.mode(), Some(BoardMode::Driving), "{cause:?}");
    (fastest, bench.world.truth().wheel_speed)
}

/// Before the second pulse the board does not know the speed.
#[test]
fn a_start_with_a_long_pulse_distance_does_not_overshoot() {
    let mut config = seeded(5);
    // A fast car of a configuration for a slow one.
    config.car.motor.gain_m_s_per_us *= 1.05;
    config.car.motor.neutral_us -= 10;
    config.car.motor_sensor.pulse_distance_um = 25_000.0;
    let (fastest, settled) = start(config, 25_000, 300);
    assert!(fastest < 0.4, "{fastest}");
    assert!((settled - 0.3).abs() < 0.03, "{settled}");
}

#[test]
fn a_step_to_0_4_m_s_settles_within_a_second() {
    for (seed, battery_v, within) in [(1, 7.9, 0.02), (2, 7.0, 0.04), (3, 8.4, 0.04)] {
        let mut config = seeded(seed);
        config.car.battery.start_v = battery_v;
        let mut bench = armed(config);
        let start = bench.world.now_us;
        let mut fastest = 0.0_f64;
        bench.drive(400, 400, 0, |bench| {
            let truth = bench.world.truth();
            let error = (truth.wheel_speed / 0.4 - 1.0).abs();
            fastest = fastest.max(truth.wheel_speed);
            let since = truth.time_us - start;
            // With a weak battery the integral takes longer.
            let limit = if since < 2_000_000 { within } else { 0.02 };
            assert!(
                since < 1_000_000 || error <= limit,
                "{battery_v} V, {since} us: {} m/s",
                truth.wheel_speed
            );
        });
        assert_eq!(bench.host.mode(), Some(BoardMode::Driving));
        assert!(fastest < 0.44, "{battery_v} V: overshoot to {fastest} m/s");
    }
}

#[test]
fn creeping_is_not_mistaken_for_a_dead_sensor() {
    let mut bench = armed(seeded(1));
    bench.drive(500, 80, 0, |_| {});
    assert_eq!(bench.host.mode(), Some(BoardMode::Driving));
    let speed = bench.world.truth().wheel_speed;
    assert!((speed - 0.08).abs() < 0.02, "{speed}");
}

#[test]
fn the_wheels_follow_the_commanded_steering_angle() {
    let mut bench = armed(seeded(1));
    for angle in [3_000, -3_000, 0] {
        bench.drive(60, 300, angle, |_| {});
        let steering = bench.world.truth().steering;
        // Half a microsecond of pulse is 0.6 mrad.
        assert!(
            (steering - f64::from(angle) * 1e-4).abs() < 0.001,
            "{angle}: {steering}"
        );
    }
}

#[test]
fn telemetry_agrees_with_ground_truth() {
    let mut bench = armed(seeded(1));
    let mut fresh = 0;
    let mut turning = 0.0;
    let (mut ticks, mut lateral) = (0, 0.0);
    bench.drive(300, 400, 3_000, |bench| {
        let telemetry = bench.host.telemetry.unwrap();
        // A single sample vibrates by 1.1 m/s².
        ticks += 1;
        if ticks > 200 {
            lateral += f64::from(telemetry.linear_acceleration_mm_s2[1]) * 1e-3 / 100.0;
        }
        fresh += u32::from(telemetry.imu == ImuState::Fresh);
        turning += f64::from(telemetry.angular_velocity_mrad_s[2]) * 1e-3 / 300.0;
    });
    // 100 Hz on either clock, 0.3 % apart.
    assert!((295..=300).contains(&fresh), "{fresh}");
    let bias = bench.world.gyro_bias_rad_s()[2];
    let truth = bench.world.truth();
    // The first half second is acceleration.
    assert!((turning - bias) / truth.yaw_rate > 0.85, "{turning}");
    let telemetry = bench.host.telemetry.unwrap();
    assert!((f64::from(telemetry.motor_speed_mm_s) * 1e-3 - truth.wheel_speed).abs() < 0.02);
    assert!(
        (lateral - truth.lateral_acceleration).abs() < 0.4,
        "{lateral}"
    );
    let status = bench.host.status.unwrap();
    assert_eq!(status.reset_cause, ResetCause::PowerOn);
    assert!((f64::from(status.battery_mv) * 1e-3 - truth.battery_v).abs() < 0.1);
    assert_eq!(bench.host.damaged, 0);
}

#[test]
fn telemetry_comes_at_100_hz_of_a_skewed_clock() {
    let mut bench = armed(seeded(1));
    let (start, records) = (bench.world.now_us, bench.host.records);
    bench.drive(1_000, 300, 0, |_| {});
    assert_eq!(bench.host.mode(), Some(BoardMode::Driving));
    let ticks = bench.host.records - records;
    let elapsed = bench.world.now_us - start;
    assert_eq!(elapsed, 10_000_000);
    assert!((1_002..=1_004).contains(&ticks), "{ticks}");
}

#[test]
fn after_the_last_command_the_neutral_pulse_leaves_within_120_ms() {
    for extra_ms in [0, 3, 7, 11, 19] {
        let mut bench = armed(seeded(1));
        bench.drive(100, 400, 1_000, |_| {});
        bench.run_ms(extra_ms);
        let command = bench.host.drive(400, 1_000);
        bench.send(&command);
        let last_us = bench.world.now_us;
        bench.run_ms(500);
        let neutral = bench
            .world
            .board
            .pulses
            .neutral_from(last_us, 1_500, DEADBAND_US)
            .unwrap();
        let after = neutral.time_us - last_us;
        assert!((60_000..=120_000).contains(&after), "{after} us");
        assert_eq!(bench.host.telemetry.unwrap().mode, BoardMode::Failsafe);
        // The steering angle is held.
        assert_eq!(neutral.servo_us, 1_420);
    }
}

#[test]
fn a_queue_released_by_a_stuck_line_does_not_drive() {
    let mut bench = armed(seeded(1));
    bench.drive(50, 400, 0, |_| {});
    bench.world.wire.faults.stuck = true;
    for _ in 0..976 {
        let command = bench.host.drive(600, 0);
        bench.send(&command);
        bench.run_ms(10);
    }
    assert_eq!(bench.world.truth().wheel_speed, 0.0);
    let released = bench.world.now_us;
    bench.world.wire.faults.stuck = false;
    bench.run_ms(3_000);
    assert_eq!(bench.world.wire.bytes_to_board(), 0);
    assert_eq!(bench.world.truth().wheel_speed, 0.0);
    assert!(
        bench
            .world
            .board
            .pulses
            .iter()
            .filter(|pulse| pulse.time_us >= released)
            .all(|pulse| pulse.esc_us == 1_500)
    );
    assert_eq!(bench.host.mode(), Some(BoardMode::Failsafe));
    let status = bench.host.status.unwrap();
    assert!(status.drives_refused >= 970, "{status:?}");
}

#[test]
fn a_dead_motor_sensor_stops_the_car() {
    let mut bench = armed(seeded(1));
    bench.drive(100, 400, 0, |_| {});
    bench.world.car.sensor_fault = MotorSensorFault::Gone;
    let mut fastest = 0.0_f64;
    bench.drive(100, 400, 0, |bench| {
        fastest = fastest.max(bench.world.truth().wheel_speed);
    });
    assert_eq!(bench.host.mode(), Some(BoardMode::Failsafe));
    assert_eq!(
        bench.host.telemetry.unwrap().stop_cause,
        StopCause::MotorSensor
    );
    assert_eq!(bench.world.truth().wheel_speed, 0.0);
    assert!(fastest < 0.8, "{fastest}");
}

#[test]
fn the_pins_are_silent_through_the_bootloader_and_the_board_greets_after_it() {
    let mut bench = armed(seeded(1));
    bench.drive(50, 400, 0, |_| {});
    bench.host.hellos.clear();
    bench.world.reset_board(ResetCause::External);
    let reset_us = bench.world.now_us;
    bench.drive(70, 400, 0, |_| {});
    assert!(!bench.world.board.is_running());
    assert_eq!(bench.world.board.pulses.last().unwrap().esc_us, 0);
    assert_eq!(bench.world.truth().wheel_speed, 0.0);
    bench.drive(250, 400, 0, |_| {});
    assert!(bench.world.board.is_running());
    assert_eq!(bench.host.hellos.first().unwrap().nonce, UNSOLICITED);
    assert!(
        bench
            .world
            .board
            .pulses
            .iter()
            .filter(|pulse| pulse.time_us >= reset_us)
            .all(|pulse| pulse.servo_us == 0 && (pulse.esc_us == 1_500 || pulse.esc_us == 0))
    );
    assert_eq!(bench.world.board.resets, 1);
}

#[test]
fn a_hung_main_loop_is_stopped_by_the_supervisor() {
    let mut bench = armed(seeded(1));
    bench.drive(50, 400, 0, |_| {});
    bench.world.board.hang(Hang::MainLoop);
    let hung_us = bench.world.now_us;
    bench.drive(100, 400, 0, |_| {});
    let neutral = bench
        .world
        .board
        .pulses
        .neutral_from(hung_us, 1_500, DEADBAND_US)
        .unwrap();
    assert!(neutral.time_us - hung_us <= 45_000);
    assert_eq!(bench.world.truth().wheel_speed, 0.0);
}

#[test]
fn half_a_percent_of_corrupted_bytes_is_tolerated_and_counted() {
    let mut bench = armed(seeded(1));
    bench.world.wire.faults = WireFaults {
        corrupt: 0.005,
        ..WireFaults::default()
    };
    bench.drive(1_000, 400, 0, |_| {});
    assert_eq!(bench.host.mode(), Some(BoardMode::Driving));
    assert!(bench.host.damaged > 50, "{}", bench.host.damaged);
    assert!(bench.host.status.unwrap().frames_damaged > 20);
}

#[test]
fn arming_is_refused_before_neutral_has_been_held() {
    let mut bench = ScriptedDrive::new(seeded(1)).unwrap();
    bench.run_ms(200);
    bench.configure();
    bench.arm();
    assert_eq!(bench.host.refusals, [RefusalReason::NotYetNeutral]);
    bench.send(&ToBoard::Disarm(singletrack_protocol::Disarm {
        request: singletrack_protocol::Sequence(99),
    }));
    bench.run_ms(20);
    assert_ne!(bench.host.mode(), Some(BoardMode::Armed));
}

#[test]
fn both_pulses_come_every_20_ms_of_board_time() {
    let mut bench = armed(seeded(1));
    bench.run_ms(1_000);
    let pulses: Vec<_> = bench.world.board.pulses.iter().copied().collect();
    for pair in pulses.windows(2) {
        let period = pair[1].board_time_us - pair[0].board_time_us;
        assert!(period.abs_diff(SERVO_FRAME_US as u32) <= 1, "{period}");
    }
}
