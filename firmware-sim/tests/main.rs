//! The simulator in virtual time, and its sockets: the same seed and inputs give the same bits, and
//! random input does not stop it.

#![allow(
    clippy::disallowed_methods,
    reason = "what a test expects is compared within a tolerance"
)]
#![allow(
    clippy::unwrap_used,
    clippy::panic,
    reason = "a test fails by panicking"
)]

mod natnet_server;
mod other_cars;
mod physics;

use std::net::SocketAddr;

use proptest::{collection::vec, prelude::*};
use singletrack_sim::{
    Car, CarParameters, LossPattern, ScriptedDrive, SimulationConfig, WireFaults, World,
    parse_duration_us,
};

fn config(seed: u64) -> SimulationConfig {
    let mut config = SimulationConfig {
        seed,
        ..SimulationConfig::default()
    };
    config.wire.faults = WireFaults {
        drop: 0.000_5,
        corrupt: 0.000_5,
        ..WireFaults::default()
    };
    config
}

/// All outputs to the host, and ground truth, as text with all digits.
fn run(seed: u64) -> String {
    let mut bench = ScriptedDrive::armed(config(seed)).unwrap();
    let mut outputs = String::new();
    bench.drive(300, 400, 2_000, |bench| {
        outputs += &format!("{:?}{:?}\n", bench.world.truth(), bench.host.telemetry);
        while let Some(frame) = bench.world.poll_camera_frame() {
            outputs += &format!("{frame:?}\n");
        }
    });
    outputs
}

#[test]
fn runs_depend_only_on_the_seed() {
    let first = run(1);
    assert!(first == run(1));
    assert!(first != run(2));
}

#[test]
fn the_steps_of_advance_to_have_no_effect() {
    let run = |step_us: u64| {
        let mut world = World::new(config(3)).unwrap();
        let (mut now, mut bytes) = (0, Vec::new());
        while now < 3_000_000 {
            now = (now + step_us).min(3_000_000);
            world.advance_to(now);
        }
        world.host_read(&mut bytes);
        let frames: Vec<_> = core::iter::from_fn(|| world.poll_camera_frame()).collect();
        (bytes, frames, format!("{:?}", world.truth()))
    };
    assert!(run(3_000_000) == run(7));
    assert!(run(1_000) == run(1_234));
}

#[test]
fn silencing_one_sensor_does_not_change_the_others() {
    let poses = |change: fn(&mut SimulationConfig)| {
        let mut config = SimulationConfig::default();
        change(&mut config);
        let mut world = World::new(config).unwrap();
        world.advance_to(1_000_000);
        core::iter::from_fn(|| world.poll_camera_frame()).collect::<Vec<_>>()
    };
    let reference = poses(|_| {});
    assert_eq!(reference.len(), 99);
    assert!(reference == poses(|config| config.car.imu.gyro_noise_rad_s = 0.0));
    assert!(reference == poses(|config| config.wire.faults.corrupt = 0.5));
    assert!(reference != poses(|config| config.cameras.position_noise_m = 0.001));
}

/// Frozen, to detect a platform, profile or dependency that changes the bits. A
/// deliberate change of the car changes this number.
#[test]
fn the_cars_bits_are_the_same_on_every_platform() {
    let mut car = Car::new(CarParameters::default());
    for frame in 0..300 {
        let driving = frame >= 60;
        car.apply_pulses(
            if driving { 1_340 + frame } else { 1_500 },
            if driving { 1_575 } else { 1_500 },
        );
        car.advance_to(u64::from(frame + 1) * 20_000);
    }
    let truth = car.truth();
    assert!(truth.wheel_speed > 0.4 && truth.y > 0.1, "{truth:?}");
    let bits = [
        truth.x,
        truth.y,
        truth.yaw,
        truth.sideslip,
        truth.wheel_speed,
    ]
    .map(f64::to_bits)
    .iter()
    .fold(0_u64, |hash, bits| {
        hash.wrapping_mul(0x0000_0100_0000_01b3).wrapping_add(*bits)
    });
    assert_eq!(bits, 0x06f6_8a36_ef76_010e, "{bits:#018x}");
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn no_bytes_on_the_serial_line_disturb_the_world(
        writes in vec((0_u64..5_000, vec(any::<u8>(), 0..100)), 0..20),
    ) {
        let mut world = World::new(SimulationConfig::default()).unwrap();
        for (later_us, bytes) in writes {
            world.advance_to(world.now_us + later_us);
            world.host_write(&bytes);
        }
        let end = world.now_us + 500_000;
        world.advance_to(end);
        prop_assert_eq!(world.now_us, end);
        prop_assert_eq!(world.truth().wheel_speed, 0.0);
        // Telemetry continues.
        let mut received = Vec::new();
        world.host_read(&mut received);
        prop_assert!(received.len() > 1_000);
    }

    #[test]
    fn no_datagram_disturbs_the_server(datagrams in vec(vec(any::<u8>(), 0..400), 0..20)) {
        let mut world = World::new(SimulationConfig::default()).unwrap();
        let from: SocketAddr = ([127, 0, 0, 1], 4000).into();
        for datagram in &datagrams {
            world.handle_datagram(from, datagram);
        }
        world.advance_to(100_000);
        let counters = world.natnet.counters;
        prop_assert_eq!(counters.requests + counters.malformed, datagrams.len() as u64);
        prop_assert_eq!(counters.unencodable, 0);
    }

    #[test]
    fn loss_patterns_round_trip_through_text(
        (duration, interval) in (1_u64..10_000_000).prop_flat_map(|d| (Just(d), d + 1..20_000_000)),
    ) {
        let pattern = LossPattern::new(duration, interval).unwrap();
        prop_assert_eq!(pattern.to_string().parse::<LossPattern>(), Ok(pattern));
    }

    #[test]
    fn no_text_makes_a_duration_panic(text in "\\PC{0,12}") {
        let _ = parse_duration_us(&text);
        let _ = text.parse::<LossPattern>();
    }
}
