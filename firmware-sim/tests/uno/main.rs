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
#[path = "../closed_loop/scenarios.rs"]
mod scenarios;

use std::{
    io::Read,
    process::{Child, Command, Stdio},
    time::{Duration, Instant},
};

use scenarios::{armed, seeded as config};
use singletrack_protocol::BoardMode;
use singletrack_sim::{
    BoardKind, ImageSize, Installation, PulseRecord, ScriptedDrive, default_board_configuration,
};

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
    let pulses = drive.world.board.pulses.iter();
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

const TIMEOUT: Duration = Duration::from_secs(10);

/// Polls until `look` returns a value.
fn wait_for<T>(what: &str, mut look: impl FnMut() -> Option<T>) -> T {
    let start = Instant::now();
    loop {
        if let Some(found) = look() {
            return found;
        }
        assert!(start.elapsed() < TIMEOUT, "no {what} in {TIMEOUT:?}");
        std::thread::sleep(Duration::from_millis(5));
    }
}

/// The one child of a process.
fn child_of(parent: u32) -> Option<u32> {
    std::fs::read_dir("/proc")
        .unwrap()
        .flatten()
        .find_map(|entry| {
            let pid = entry.file_name().to_str()?.parse().ok()?;
            let stat = std::fs::read_to_string(entry.path().join("stat")).ok()?;
            // After the name in parentheses: state, parent.
            let (_, rest) = stat.rsplit_once(") ")?;
            (rest.split(' ').nth(1)? == parent.to_string()).then_some(pid)
        })
}

/// Ends the simulator even if the test fails.
struct Simulator(Child);

impl Drop for Simulator {
    fn drop(&mut self) {
        // It may have ended already.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

#[test]
fn the_program_reports_a_dead_image_process_and_ends() {
    let folder = tempfile::tempdir().unwrap();
    let link = folder.path().join("board");
    let program = Command::new(env!("CARGO_BIN_EXE_singletrack-sim"))
        .args(["--board", "uno", "--quiet", "--command-port", "0"])
        .args(["--data-port", "0", "--port"])
        .arg(&link)
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut simulator = Simulator(program);
    wait_for("serial port", || link.exists().then_some(()));
    let image = child_of(simulator.0.id()).unwrap();

    let killed = Command::new("kill")
        .args(["-KILL", &image.to_string()])
        .status()
        .unwrap();
    assert!(killed.success());
    let since = Instant::now();
    let status = wait_for("end", || simulator.0.try_wait().unwrap());
    assert!(since.elapsed() < Duration::from_secs(2), "{since:?}");
    assert_eq!(status.code(), Some(1));
    let mut message = String::new();
    let mut errors = simulator.0.stderr.take().unwrap();
    errors.read_to_string(&mut message).unwrap();
    assert!(message.contains("the board failed"), "{message}");
    assert!(
        message.contains("the process that runs the image"),
        "{message}"
    );
    assert!(!link.exists());
}

#[test]
fn a_drive_at_100_hz_leaves_80_percent_of_the_processor_and_600_bytes_of_memory() {
    let mut drive = armed(config(1));
    let before = drive.world.board.figures().unwrap();
    drive.drive(1_000, 400, 800, |_| {});
    assert_eq!(drive.host.mode(), Some(BoardMode::Driving));
    let after = drive.world.board.figures().unwrap();
    let cycles = after.cycles - before.cycles;
    // Ten seconds with an oscillator error of up to 0.5 %.
    assert!(cycles.abs_diff(160_000_000) < 1_000_000, "{cycles}");
    let busy = 1.0 - (after.cycles_asleep - before.cycles_asleep) as f64 / cycles as f64;
    assert!((0.01..=0.20).contains(&busy), "{busy}");
    let size = ImageSize::read(&Installation::find().unwrap().image).unwrap();
    assert!(size.flash_bytes <= 24 * 1_024, "{size:?}");
    let memory = size.static_bytes + u64::from(after.stack_bytes);
    assert!((200..=1_400).contains(&memory), "{size:?} {after:?}");
    // A byte takes 1,360 cycles: the longest delay loses none.
    let longest = |vector| {
        after
            .interrupts
            .iter()
            .find(|interrupt| interrupt.number == vector)
            .unwrap()
    };
    for vector in [1, 14, 18, 19, 24] {
        let interrupt = longest(vector);
        assert!(interrupt.count > 100, "{interrupt:?}");
        assert!(interrupt.most_cycles < 400, "{interrupt:?}");
    }
    assert!(after.longest_critical_section < 200, "{after:?}");
    assert_eq!(drive.world.board.pulse_jitter_us(), Some(0.0));
}

#[test]
fn the_line_is_loaded_below_40_percent_in_both_directions() {
    let mut drive = armed(config(1));
    let mut received = 0;
    let mut sent = 0;
    for _ in 0..500 {
        let command = drive.host.drive(400, 800);
        sent += command.encode().as_bytes().len();
        drive.send(&command);
        let mut bytes = Vec::new();
        for _ in 0..10 {
            let next_us = drive.world.now_us + 1_000;
            drive.world.advance_to(next_us);
            drive.world.host_read(&mut bytes);
        }
        drive.host.take(&bytes);
        received += bytes.len();
    }
    assert_eq!(drive.host.mode(), Some(BoardMode::Driving));
    // Five seconds at 115200 baud.
    let capacity = 5.0 * 11_520.0;
    let (back, out) = (received as f64 / capacity, sent as f64 / capacity);
    assert!((0.30..=0.40).contains(&back), "{back}");
    assert!((0.05..=0.40).contains(&out), "{out}");
}
