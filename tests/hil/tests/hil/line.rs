//! A serial line that is unplugged, corrupted or stuck.

use std::time::{Duration, Instant};

use singletrack_hil::{
    Outcome,
    bench::Bench,
    ensure,
    rig::{LineFaults, Need},
    wait,
};

use crate::Scenario;

pub(crate) const SCENARIOS: &[Scenario] = &[
    Scenario::new(
        "an_unplugged_line_stops_the_car_and_returns_disarmed",
        unplugged,
    ),
    Scenario::new(
        "a_cable_that_takes_the_power_along_stops_the_car_and_returns_disarmed",
        unpowered,
    )
    .needing(&[Need::Power]),
    Scenario::new(
        "keeps_driving_with_half_a_percent_of_the_bytes_corrupted",
        slightly_corrupted,
    ),
    Scenario::new(
        "stops_with_five_percent_of_the_bytes_corrupted",
        badly_corrupted,
    ),
    Scenario::new("commands_released_by_a_stuck_line_do_not_drive", stuck),
];

/// Limits for the detection of a hang-up, and for the use of a line that is back.
const DETECTION_LIMIT_MS: f64 = 50.0;
const REOPENED_LIMIT_MS: f64 = 1_000.0;

fn unplugged(bench: &mut Bench) -> Outcome {
    bench.start_driving()?;
    bench.keep_driving(Duration::from_millis(1_500))?;
    // A hang-up is an event; it needs no timeout.
    bench.rig().interrupt()?;
    let start = Instant::now();
    let status = bench.wait_for_mode("disconnected", Duration::from_millis(500))?;
    bench.at_most(
        "from the hang-up to the status",
        start.elapsed().as_secs_f64() * 1_000.0,
        DETECTION_LIMIT_MS,
        "ms",
    )?;
    bench.neutral_after_last_command()?;
    ensure!(
        status.reason() == "link-down",
        "the reason for the stop: {}",
        status.text()
    );
    bench.wait_until_standing()?;

    let place = bench.rig().trace()?.len();
    bench.rig().plug()?;
    let start = Instant::now();
    let mut client = bench.client()?;
    wait::until("an open port", Duration::from_secs(3), || {
        Ok((client.status()?.link() != "disconnected").then_some(()))
    })?;
    bench.at_most(
        "from plugging in to an open port",
        start.elapsed().as_secs_f64() * 1_000.0,
        REOPENED_LIMIT_MS,
        "ms",
    )?;
    bench.wait_for_mode("ready", Duration::from_secs(4))?;
    bench.stays_neutral(Duration::from_secs(1))?;
    bench.was_neutral_since(place)?;
    let status = bench.status()?;
    ensure!(status.mode() == "ready", "not waiting: {}", status.text());
    ensure!(
        status.figure("/frames/hang_ups")? >= 1.0,
        "the hang-up was not counted"
    );
    bench.arm_and_drive()
}

/// The board gives no neutral pulse: the ESC stops the car by itself.
fn unpowered(bench: &mut Bench) -> Outcome {
    bench.start_driving()?;
    bench.keep_driving(Duration::from_millis(1_500))?;
    let place = bench.rig().trace()?.len();
    bench.rig().unplug()?;
    bench.wait_for_mode("disconnected", Duration::from_millis(500))?;
    bench.wait_until_standing()?;
    let trace = bench.rig().trace()?;
    let last = trace.since(place).last();
    ensure!(
        last.is_some_and(|pulses| pulses.esc_us == 0),
        "pulses of a board without power: {last:?}"
    );
    let place = trace.len();
    bench.rig().plug()?;
    bench.wait_for_mode("ready", Duration::from_secs(6))?;
    bench.stays_neutral(Duration::from_secs(1))?;
    bench.was_neutral_since(place)?;
    bench.arm_and_drive()
}

fn slightly_corrupted(bench: &mut Bench) -> Outcome {
    bench.start_driving()?;
    bench.rig().set_line(LineFaults {
        corrupt: 0.005,
        stuck: false,
    })?;
    bench.keep_driving(Duration::from_secs(10))?;
    let status = bench.status()?;
    let damaged = status.figure("/frames/crc_errors")? + status.figure("/frames/decode_errors")?;
    // About 180 of 1,000 records of 42 bytes.
    ensure!(
        (90.0..=300.0).contains(&damaged),
        "{damaged} corrupted frames were counted, expected about 180"
    );
    bench.was_within_limits(&bench.rig().trace()?)
}

/// From the start of the corruption to the last pulse that is not neutral.
const STOP_LIMIT_MS: f64 = 2_000.0;

fn badly_corrupted(bench: &mut Bench) -> Outcome {
    bench.start_driving()?;
    bench.keep_driving(Duration::from_secs(1))?;
    let begin_us = bench.board_time_us()?;
    bench.rig().set_line(LineFaults {
        corrupt: 0.05,
        stuck: false,
    })?;
    bench.neutral_within(
        "after 5 % of the bytes are corrupted",
        begin_us,
        STOP_LIMIT_MS,
    )?;
    bench.wait_until_standing()?;
    // Arming is impossible now, and nothing moves by itself.
    let place = bench.rig().trace()?.len();
    bench.stays_neutral(Duration::from_secs(2))?;
    bench.rig().set_line(LineFaults::default())?;
    bench.wait_for_mode("ready", Duration::from_secs(4))?;
    bench.stays_neutral(Duration::from_millis(500))?;
    bench.was_neutral_since(place)?;
    bench.was_within_limits(&bench.rig().trace()?)?;
    bench.arm_and_drive()
}

/// Number of commands that may wait in a stuck line.
const MAX_QUEUED: f64 = 2.0;

fn stuck(bench: &mut Bench) -> Outcome {
    bench.start_driving()?;
    bench.keep_driving(Duration::from_secs(1))?;
    let refused_before = bench.drives_refused()?;
    bench.rig().set_line(LineFaults {
        corrupt: 0.0,
        stuck: true,
    })?;
    bench.neutral_after_last_command()?;
    bench.wait_until_standing()?;
    // Long enough for a hundred commands, if they were sent.
    std::thread::sleep(Duration::from_secs(1));

    let place = bench.rig().trace()?.len();
    bench.rig().set_line(LineFaults::default())?;
    bench.wait_for_mode("ready", Duration::from_secs(4))?;
    bench.stays_neutral(Duration::from_millis(500))?;
    bench.was_neutral_since(place)?;
    // The queued commands were too late, and the board refused them.
    let refused = bench.drives_refused()? - refused_before;
    bench.at_most(
        "commands that waited in the stuck line",
        refused,
        MAX_QUEUED,
        "",
    )?;
    bench.arm_and_drive()
}
