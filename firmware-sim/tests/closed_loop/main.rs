//! Closed loop of the real board code and the simulated car.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    reason = "a test fails by panicking"
)]

mod scenarios;

use singletrack_protocol::BoardMode;
use singletrack_sim::{BoardParameters, ScriptedDrive, SimulationConfig};

/// Compiled for this machine.
const KIND: singletrack_sim::BoardKind = singletrack_sim::BoardKind::Native;

/// The image's clock starts at zero, and wraps after 72 minutes.
#[test]
fn a_wrap_of_the_clock_while_driving_has_no_effect() {
    let mut bench = ScriptedDrive::armed(SimulationConfig {
        board: BoardParameters {
            clock_offset_us: u32::MAX - 4_000_000,
            ..BoardParameters::default()
        },
        ..SimulationConfig::default()
    })
    .unwrap();
    let before_us = bench.host.telemetry_time_us();
    bench.drive(500, 300, 0, |_| {});
    assert!(bench.host.telemetry_time_us() < before_us);
    assert_eq!(bench.host.mode(), Some(BoardMode::Driving));
}

/// Cars that are faster or slower than configured start with every pulse distance, and
/// without much more speed than commanded.
#[test]
fn other_cars_start_with_every_pulse_distance() {
    for pulse_distance_um in [3_000, 6_000, 12_000, 25_000, 30_000] {
        for (gain, neutral_us, coasting_m_s2, slope_deg) in [
            (1.0, 1_500, 0.7, 0.0),
            (1.05, 1_490, 0.5, 2.0),
            (1.05, 1_490, 1.0, 0.0),
            (0.95, 1_510, 0.3, 0.0),
            (0.95, 1_510, 1.0, 0.0),
        ] {
            for speed_mm_s in [300, 400] {
                let mut config = scenarios::seeded(5);
                config.car.motor.gain_m_s_per_us *= gain;
                config.car.motor.neutral_us = neutral_us;
                config.car.motor.coasting_m_s2 = coasting_m_s2;
                config.car.motor.slope_deg = slope_deg;
                config.car.motor_sensor.pulse_distance_um = pulse_distance_um.into();
                let (fastest, settled) = scenarios::start(config, pulse_distance_um, speed_mm_s);
                let speed = f64::from(speed_mm_s) / 1_000.0;
                let what = format!("{pulse_distance_um} um, {gain}, {neutral_us} us");
                assert!(fastest < 1.3 * speed, "{what}: {fastest} of {speed}");
                assert!(
                    (settled / speed - 1.0).abs() < 0.1,
                    "{what}: {settled} of {speed}"
                );
            }
        }
    }
}

#[test]
fn a_start_with_a_dead_sensor_goes_as_far_as_documented() {
    for (pulse_distance_um, way_m) in [(3_000, 0.06), (12_000, 0.12), (25_000, 0.18)] {
        let mut config = SimulationConfig::default();
        // No pulse within a kilometre.
        config.car.motor_sensor.pulse_distance_um = 1e9;
        let mut bench = ScriptedDrive::new(config).unwrap();
        bench.configuration.speed.pulse_distance_um = pulse_distance_um;
        bench.run_ms(200);
        bench.prepare();
        let start_m = bench.world.truth().x;
        for tick in 1..=200 {
            bench.drive(1, (20 * tick).min(400), 0, |_| {});
        }
        assert_eq!(bench.host.mode(), Some(BoardMode::Failsafe));
        let way = bench.world.truth().x - start_m;
        assert!(
            (way - way_m).abs() < 0.01,
            "{pulse_distance_um} um: {way} m"
        );
    }
}

#[test]
fn more_edges_than_the_interrupt_accepts_are_refused_as_by_the_image() {
    let mut config = SimulationConfig::default();
    // A pulse every 10 um: 20 a millisecond at 0.2 m/s.
    config.car.motor_sensor.pulse_distance_um = 10.0;
    let mut bench = ScriptedDrive::new(config).unwrap();
    bench.configuration.speed.pulse_distance_um = 100;
    bench.configuration.speed.max_forward_mm_s = 1_200;
    bench.run_ms(200);
    bench.prepare();
    let mut fastest = 0;
    bench.drive(100, 1_500, 0, |bench| {
        fastest = fastest.max(bench.host.telemetry.unwrap().motor_speed_mm_s);
    });
    bench.run_ms(300);
    assert!(bench.host.status.unwrap().edges_refused > 10);
    // 16 pulses of 0.1 mm in a millisecond.
    assert!((1_500..=1_700).contains(&fastest), "{fastest}");
}
