//! What the image makes of its pins: kill output, silence, interference, voltages, the
//! IMU's mounting and health.

use singletrack_protocol::{
    BoardMode, Configuration, EmergencyStop, ImuAxes, ImuAxis, StopCause, ToBoard, UNNAMED,
};
use singletrack_sim::{ScriptedDrive, SimulationConfig, default_board_configuration};
use singletrack_simavr::Hang;

use super::{config, driving, pulses_since};

/// A board with this configuration that has been asked to arm.
fn asked_to_arm(simulation: SimulationConfig, configuration: Configuration) -> ScriptedDrive {
    let mut drive = ScriptedDrive::new(simulation).unwrap();
    drive.configuration = configuration;
    drive.run_ms(200);
    drive.prepare();
    drive.run_ms(20);
    assert_eq!(drive.host.refusals, []);
    drive
}

fn with_kill_relay() -> (SimulationConfig, Configuration) {
    let mut simulation = config(1);
    simulation.car.motor.kill_relay = true;
    let configuration = Configuration {
        kill_output: true,
        ..default_board_configuration()
    };
    (simulation, configuration)
}

#[test]
fn the_kill_output_is_held_from_arming_to_the_first_stop() {
    let (simulation, configuration) = with_kill_relay();
    let mut drive = asked_to_arm(simulation, configuration);
    assert_eq!(drive.host.mode(), Some(BoardMode::PoweringUp));
    assert!(drive.world.car.esc_has_power());
    drive.run_ms(2_100);
    assert_eq!(drive.host.mode(), Some(BoardMode::Armed));
    drive.drive(100, 400, 0, |_| {});
    assert!(drive.world.truth().wheel_speed > 0.3);
    // Commands end: the supply is off before the neutral pulse is over.
    drive.run_ms(100);
    assert!(!drive.world.car.esc_has_power());
    assert_eq!(drive.host.mode(), Some(BoardMode::Failsafe));
}

/// Pulls the cable of a car at 1 m/s whose ESC holds its last pulse for a second; returns the time
/// until the ESC is without supply, in ms, and the way to standstill, in m.
fn pulled_at_1_m_s(own_supply: bool, kill_output: bool) -> (Option<u64>, f64) {
    let (mut simulation, mut configuration) = with_kill_relay();
    simulation.board.own_supply = own_supply;
    simulation.car.motor.kill_relay = kill_output;
    simulation.car.motor.signal_loss_us = 1_000_000;
    configuration.kill_output = kill_output;
    let mut drive = asked_to_arm(simulation, configuration);
    drive.run_ms(2_100);
    drive.arm();
    drive.drive(200, 1_000, 0, |_| {});
    assert!((drive.world.truth().wheel_speed - 1.0).abs() < 0.05);
    let from_m = drive.world.truth().way;
    drive.world.set_cable(false);
    let mut dark_ms = None;
    for ms in 1..=3_000 {
        drive.run_ms(1);
        if !drive.world.car.esc_has_power() {
            dark_ms.get_or_insert(ms);
        }
    }
    assert_eq!(drive.world.truth().wheel_speed, 0.0);
    (dark_ms, drive.world.truth().way - from_m)
}

#[test]
fn a_pulled_cable_is_neutral_or_drops_the_kill_output_or_leaves_the_esc_alone() {
    for (own_supply, kill_output, dark_ms, [least_m, most_m]) in [
        // Neutral within 120 ms.
        (true, false, None, [0.3, 0.5]),
        // The command expires first.
        (true, true, Some(97), [0.3, 0.5]),
        // The pin floats, and its pull-down opens the relay.
        (false, true, Some(1), [0.25, 0.4]),
        // The ESC drives on for a second.
        (false, false, None, [1.1, 1.4]),
    ] {
        let (found_ms, way_m) = pulled_at_1_m_s(own_supply, kill_output);
        println!(
            "own supply {own_supply}, kill output {kill_output}: {found_ms:?} ms, {way_m:.2} m"
        );
        assert!(
            found_ms <= dark_ms && found_ms.is_some() == dark_ms.is_some(),
            "{found_ms:?}"
        );
        assert!(
            (least_m..=most_m).contains(&way_m),
            "{own_supply} {kill_output}: {way_m}"
        );
    }
}

#[test]
fn a_hung_main_loop_drops_the_kill_output_within_21_ms() {
    for hang in [Hang::MainLoop, Hang::Everything] {
        let (simulation, configuration) = with_kill_relay();
        let mut drive = asked_to_arm(simulation, configuration);
        drive.run_ms(2_100);
        drive.drive(100, 400, 0, |_| {});
        drive.world.board.hang(hang);
        let held_ms = (0..200)
            .find(|_| {
                drive.run_ms(1);
                !drive.world.car.esc_has_power()
            })
            .unwrap();
        // With interrupts disabled the watchdog's reset lets the pin float.
        let limit = if hang == Hang::MainLoop { 21 } else { 70 };
        assert!(held_ms <= limit, "{hang:?}: {held_ms} ms");
    }
}

#[test]
fn an_emergency_stop_falls_silent_on_the_pin_and_stays_so_when_the_main_loop_hangs() {
    let mut drive = driving(1);
    let request = drive.host.next_sequence();
    drive.send(&ToBoard::EmergencyStop(EmergencyStop { request }));
    drive.run_ms(30);
    let stopped_us = drive.world.now_us;
    // 200 ms from the request.
    drive.run_ms(160);
    let pulses = pulses_since(&drive, stopped_us);
    assert!(pulses.len() >= 7);
    assert!(pulses.iter().all(|pulse| pulse.esc_us == 1_500));
    drive.run_ms(60);
    let silent_us = drive.world.now_us;
    drive.run_ms(500);
    let pulses = pulses_since(&drive, silent_us);
    // The servo still holds the wheels.
    assert!(pulses.len() >= 24);
    assert!(
        pulses
            .iter()
            .all(|pulse| pulse.esc_us == 0 && pulse.servo_us != 0)
    );
    assert_eq!(drive.host.telemetry.unwrap().esc_us, 0);
    drive.world.board.hang(Hang::MainLoop);
    let hung_us = drive.world.now_us;
    drive.run_ms(60);
    let pulses = pulses_since(&drive, hung_us);
    assert!(pulses.iter().all(|pulse| pulse.esc_us == 0));
}

#[test]
fn ringing_on_the_sensors_wire_keeps_neither_pulse_guard_nor_host_from_stopping_the_car() {
    let mut simulation = config(1);
    // A pulse every 10 um: 20 a millisecond at 0.2 m/s. The speed loop takes them for
    // great speed, and does not drive faster.
    simulation.car.motor_sensor.pulse_distance_um = 10.0;
    let mut configuration = default_board_configuration();
    configuration.speed.pulse_distance_um = 100;
    configuration.speed.max_forward_mm_s = 1_200;
    let mut drive = asked_to_arm(simulation, configuration);
    let before = drive.host.records;
    drive.drive(100, 1_500, 0, |_| {});
    assert!(drive.host.records >= before + 95, "telemetry goes on");
    drive.run_ms(300);
    let status = drive.host.status.unwrap();
    assert!(status.edges_refused > 10, "{status:?}");
    assert_eq!(drive.host.mode(), Some(BoardMode::Failsafe));
    assert_eq!(drive.world.board.resets, 0);
}

#[test]
fn the_battery_is_measured_whatever_the_supply_and_an_open_input_is_recognised() {
    for (supply_v, divider_open) in [(5.0, false), (4.6, false), (5.0, true), (4.6, true)] {
        let mut simulation = config(1);
        simulation.car.battery.supply_v = supply_v;
        simulation.car.battery.divider_open = divider_open;
        let mut drive = ScriptedDrive::new(simulation).unwrap();
        drive.run_ms(1_000);
        let status = drive.host.status.unwrap();
        let battery_mv = drive.world.truth().battery_v * 1e3;
        assert!((f64::from(status.supply_mv) - supply_v * 1e3).abs() < 25.0);
        assert_eq!(status.battery_open, divider_open, "{supply_v}");
        if !divider_open {
            let error = f64::from(status.battery_mv) - battery_mv;
            assert!(error.abs() < 60.0, "{supply_v}: {error}");
        }
    }
}

#[test]
fn the_sensors_registers_and_the_car_are_reported() {
    let mut simulation = config(1);
    simulation.car.imu.calibration = [0, 3, 1];
    simulation.car.imu.self_test = 0x0B;
    simulation.car.imu.system_error = 3;
    let mut drive = asked_to_arm(simulation, default_board_configuration());
    drive.run_ms(500);
    let status = drive.host.status.unwrap();
    assert_eq!(
        (status.imu_calibration, status.imu_self_test),
        (0b0011_0100, 0x0B)
    );
    assert_eq!((status.imu_status, status.imu_error), (5, 3));
    assert_eq!(drive.host.car_id, Some(UNNAMED));
}

#[test]
fn a_turned_sensor_gives_the_cars_axes() {
    let mut simulation = config(1);
    // One sample is compared.
    simulation.car.imu = simulation.car.imu.without_vibration();
    simulation.car.imu.mounting_deg = [0.0, 0.0, 90.0];
    let configuration = Configuration {
        imu_axes: ImuAxes {
            forward: ImuAxis::MinusY,
            left: ImuAxis::PlusX,
            up: ImuAxis::PlusZ,
        },
        ..default_board_configuration()
    };
    let mut drive = asked_to_arm(simulation, configuration);
    drive.drive(350, 400, 2_000, |_| {});
    let (truth, telemetry) = (drive.world.truth(), drive.host.telemetry.unwrap());
    let lateral = f64::from(telemetry.linear_acceleration_mm_s2[1]) * 1e-3;
    let yaw_rate = f64::from(telemetry.angular_velocity_mrad_s[2]) * 1e-3;
    assert!(truth.lateral_acceleration > 0.08, "{truth:?}");
    assert!((lateral - truth.lateral_acceleration).abs() < 0.3);
    assert!((yaw_rate - truth.yaw_rate).abs() < 0.03);
    let [w, _, _, z] = telemetry.attitude_q14.map(f64::from);
    let heading = 2.0 * libm::atan2(z, w);
    let error = (heading - truth.yaw + std::f64::consts::PI).rem_euclid(std::f64::consts::TAU)
        - std::f64::consts::PI;
    assert!(error.abs() < 0.1, "{error}");
}

#[test]
fn a_car_that_drives_at_the_configured_neutral_gets_no_more_pulses() {
    let mut configuration = default_board_configuration();
    configuration.esc.neutral_us = 1_560;
    configuration.esc.deadband_us = 60;
    let mut drive = ScriptedDrive::new(config(1)).unwrap();
    drive.configuration = configuration;
    // The ESC arms at the pulse of the start.
    drive.run_ms(3_000);
    drive.configure();
    let mut way_m = 0.0;
    for _ in 0..12_000 {
        drive.run_ms(1);
        way_m += drive.world.truth().wheel_speed * 1e-3;
    }
    let telemetry = drive.host.telemetry.unwrap();
    assert_eq!(
        (telemetry.mode, telemetry.stop_cause),
        (BoardMode::EmergencyStopped, StopCause::RunsAtNeutral)
    );
    assert_eq!(telemetry.esc_us, 0);
    assert!(drive.world.truth().wheel_speed.abs() < 0.01);
    // 3 s at 0.3 m/s, and the way without pulses.
    assert!((0.5..1.1).contains(&way_m), "{way_m}");
}
