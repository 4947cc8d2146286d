//! When the serial line is unplugged, damaged or stuck.

use std::time::{Duration, Instant};

use singletrack_hil::{Outcome, bench::Bench, ensure, rig::LineFaults, wait};

use crate::Scenario;

pub(crate) const SCENARIOS: &[Scenario] = &[
    Scenario::new(
        "an_unplugged_line_stops_the_car_and_comes_back_unarmed",
        unplugged,
    ),
    Scenario::new(
        "keeps_driving_with_half_a_percent_of_the_bytes_damaged",
        slightly_damaged,
    ),
    Scenario::new(
        "stops_with_five_percent_of_the_bytes_damaged",
        badly_damaged,
    ),
    Scenario::new("a_stuck_line_releases_nothing_that_moves", stuck),
];

/// How soon a hang-up shows, and a line that is back is used.
const NOTICED_LIMIT_MS: f64 = 50.0;
const REOPENED_LIMIT_MS: f64 = 1_000.0;

fn unplugged(bench: &mut Bench) -> Outcome {
    bench.start_driving()?;
    bench.keep_driving(Duration::from_millis(1_500))?;
    // A hang-up says so itself; no time-out is needed.
    bench.rig().unplug()?;
    let start = Instant::now();
    let status = bench.wait_for_mode("disconnected", Duration::from_millis(500))?;
    bench.at_most(
        "from the hang-up to its being told",
        start.elapsed().as_secs_f64() * 1_000.0,
        NOTICED_LIMIT_MS,
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

fn slightly_damaged(bench: &mut Bench) -> Outcome {
    bench.start_driving()?;
    bench.rig().set_line(LineFaults {
        corrupt: 0.005,
        stuck: false,
    })?;
    bench.keep_driving(Duration::from_secs(10))?;
    let status = bench.status()?;
    let damaged = status.figure("/frames/crc_errors")? + status.figure("/frames/decode_errors")?;
    // 1,000 records of 42 bytes: about 180 of them.
    ensure!(
        (90.0..=300.0).contains(&damaged),
        "{damaged} damaged frames were counted of about 180"
    );
    bench.was_within_limits(&bench.rig().trace()?)
}

/// From the begin of the damage to the last pulse that is not neutral.
const STOP_LIMIT_MS: f64 = 2_000.0;

fn badly_damaged(bench: &mut Bench) -> Outcome {
    bench.start_driving()?;
    bench.keep_driving(Duration::from_secs(1))?;
    let begin_us = bench.board_time_us()?;
    bench.rig().set_line(LineFaults {
        corrupt: 0.05,
        stuck: false,
    })?;
    bench.neutral_within(
        "after 5 % of the bytes are damaged",
        begin_us,
        STOP_LIMIT_MS,
    )?;
    bench.wait_until_standing()?;
    // It can't be armed through this, and nothing moves by itself.
    let place = bench.rig().trace()?.len();
    bench.stays_neutral(Duration::from_secs(2))?;
    bench.rig().set_line(LineFaults::default())?;
    bench.wait_for_mode("ready", Duration::from_secs(4))?;
    bench.stays_neutral(Duration::from_millis(500))?;
    bench.was_neutral_since(place)?;
    bench.was_within_limits(&bench.rig().trace()?)?;
    bench.arm_and_drive()
}

/// Commands that may wait in a stuck line.
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
    // As long as it takes for a hundred commands to pile up, were they sent.
    std::thread::sleep(Duration::from_secs(1));

    let place = bench.rig().trace()?.len();
    bench.rig().set_line(LineFaults::default())?;
    bench.wait_for_mode("ready", Duration::from_secs(4))?;
    bench.stays_neutral(Duration::from_millis(500))?;
    bench.was_neutral_since(place)?;
    // What had waited came too late, and the board has said so.
    let refused = bench.drives_refused()? - refused_before;
    bench.at_most(
        "commands that waited in the stuck line",
        refused,
        MAX_QUEUED,
        "",
    )?;
    bench.arm_and_drive()
}
