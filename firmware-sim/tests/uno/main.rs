//! Closed loop of the UNO image, simulated instruction by instruction, and the
//! simulated car. `cargo uno` builds the programs that these tests run.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    reason = "a test fails by panicking"
)]

mod electronics;
mod equivalence;
mod faults;
mod program;
#[path = "../closed_loop/scenarios.rs"]
mod scenarios;

use singletrack_protocol::BoardMode;
use singletrack_sim::{BoardKind, PulseRecord, ScriptedDrive, default_board_configuration};

use scenarios::{armed, seeded as config};

/// Compiled for the ATmega328P.
const KIND: BoardKind = BoardKind::Uno;

/// Drives at 0.4 m/s for half a second.
fn driving(seed: u64) -> ScriptedDrive {
    let mut drive = armed(config(seed));
    drive.drive(50, 400, 500, |_| {});
    assert_eq!(drive.host.mode(), Some(BoardMode::Driving));
    drive
}

/// The pulses since a time, in µs of the simulation.
fn pulses_since(drive: &ScriptedDrive, time_us: u64) -> Vec<PulseRecord> {
    let pulses = drive.world.board().pulses().iter();
    pulses
        .filter(|pulse| pulse.time_us >= time_us)
        .copied()
        .collect()
}

/// Whether there is no pulse, or one within the configured limits; a pulse cut by a
/// reset may be shorter.
fn is_within_limits(pulse: &PulseRecord) -> bool {
    let longest_only = |[min_us, max_us]: [u16; 2]| [if pulse.cut { 0 } else { min_us }, max_us];
    let [servo, esc] = limits().map(longest_only);
    is_within(pulse.servo_us, servo) && is_within(pulse.esc_us, esc)
}

/// The configured limits of the servo's pulses and of the ESC's.
fn limits() -> [[u16; 2]; 2] {
    let configuration = default_board_configuration();
    let (servo, esc) = (configuration.servo, configuration.esc);
    [[servo.min_us, servo.max_us], [esc.min_us, esc.max_us]]
}

fn is_within(width_us: u16, [min_us, max_us]: [u16; 2]) -> bool {
    width_us == 0 || (min_us..=max_us).contains(&width_us)
}
