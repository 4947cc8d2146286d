//! `uno-figures`: resource usage of the UNO image, measured while it drives the
//! simulated car. One line each: name, value, unit.

use std::process::ExitCode;

use singletrack_protocol::BoardMode;
use singletrack_sim::{
    BoardKind, BusFault, Cost, Figures, ImageSize, Installation, ScriptedDrive, SimulationConfig,
    WireFaults,
};

fn main() -> ExitCode {
    match run() {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("uno-figures: {error}");
            ExitCode::FAILURE
        }
    }
}

fn run() -> Result<(), Box<dyn std::error::Error>> {
    let installation = Installation::find()?;
    let size = ImageSize::read(&installation.image)?;
    let mut config = SimulationConfig::default();
    config.board.kind = BoardKind::Uno;
    let mut drive = ScriptedDrive::new(config)?;
    drive.run_ms(2_000);
    // An image for one car refuses the configuration of another.
    let car_id = drive.host.car_id.ok_or("the board named no car")?;
    drive.configuration.car_id = car_id;
    drive.prepare();
    let before = figures(&mut drive)?;
    let mut angle = 0_i16;
    for _ in 0..1_000 {
        angle = (angle + 37) % 3_000;
        drive.drive(1, 400, angle, |_| {});
    }
    let mode = drive.host.mode();
    let driving = figures(&mut drive)?;
    misuse(&mut drive);
    let after = figures(&mut drive)?;
    if mode != Some(BoardMode::Driving) {
        return Err(format!("the car did not drive: the board is in mode {mode:?}").into());
    }

    println!("car-id {car_id} greeted");
    println!("flash {} B", size.flash_bytes);
    println!("static {} B", size.static_bytes);
    println!("stack {} B", after.stack_bytes);
    println!("cpu {:.2} %", busy_percent(&before, &driving));
    let jitter_us = drive.world.board.pulse_jitter_us().unwrap_or(0.0);
    println!("pulse-jitter {jitter_us:.4} us");
    println!("critical-section {} cycles", after.longest_critical_section);
    for interrupt in &after.interrupts {
        let name = interrupt_name(interrupt.number);
        println!("interrupt-{name} {} cycles", interrupt.most_cycles);
    }
    if let Some(poll) = section(&driving, 1) {
        println!("poll-mean {} cycles", poll.all_cycles / poll.count.max(1));
        println!("poll-longest {} cycles", poll.most_cycles);
    }
    let codec = installation.measure("singletrack-uno-cycles.elf", 2_000_000)?;
    for (number, name) in [
        (1, "parse-drive"),
        (2, "parse-configure"),
        (3, "encode-telemetry"),
        (4, "encode-status"),
        (5, "poll-idle"),
        (6, "poll-with-telemetry"),
    ] {
        let cost = section(&codec, number)
            .ok_or_else(|| format!("section {number} ({name}) of the benchmark did not end"))?;
        println!("{name} {} cycles", cost.most_cycles);
    }
    Ok(())
}

/// Exercises what may need more stack than driving.
fn misuse(drive: &mut ScriptedDrive) {
    for fault in [
        BusFault::Absent,
        BusFault::Jammed,
        BusFault::ShortCircuit,
        BusFault::Restarted,
        BusFault::None,
    ] {
        drive.world.board.set_imu_bus(fault);
        drive.drive(50, 400, 0, |_| {});
    }
    drive.world.wire.faults.corrupt = 0.02;
    drive.drive(200, 400, 0, |_| {});
    drive.world.wire.faults = WireFaults::default();
    drive.world.host_write(&[0x55; 600]);
    drive.run_ms(3_000);
    drive.prepare();
    drive.drive(50, -400, 0, |_| {});
}

fn figures(drive: &mut ScriptedDrive) -> Result<Figures, String> {
    let board = &mut drive.world.board;
    match board.figures() {
        Some(figures) => Ok(figures),
        None => Err(board.failure().unwrap_or("no figures").to_owned()),
    }
}

/// Load of the processor between two measurements, in percent.
fn busy_percent(before: &Figures, after: &Figures) -> f64 {
    let cycles = after.cycles.saturating_sub(before.cycles);
    let asleep = after.cycles_asleep.saturating_sub(before.cycles_asleep);
    100.0 * (1.0 - asleep as f64 / cycles.max(1) as f64)
}

fn section(figures: &Figures, number: u8) -> Option<&Cost> {
    let mut sections = figures.sections.iter();
    sections.find(|section| section.number == number)
}

/// Name of an interrupt by its source in the ATmega328P.
fn interrupt_name(vector: u8) -> String {
    match vector {
        1 => "motor-int0".to_owned(),
        14 => "tick-timer0".to_owned(),
        18 => "receive-usart".to_owned(),
        19 => "transmit-usart".to_owned(),
        24 => "bus-twi".to_owned(),
        other => format!("vector-{other}"),
    }
}
