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
