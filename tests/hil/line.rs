//! When the serial line is unplugged, damaged or stuck.

use std::time::Duration;

use singletrack_hil::{Outcome, bench::Bench, ensure, rig::LineFaults};

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

fn unplugged(bench: &mut Bench) -> Outcome {
    bench.start_driving()?;
    bench.keep_driving(Duration::from_millis(1_500))?;
    bench.rig().unplug()?;
    bench.neutral_after_last_command()?;
    // A hang-up says so itself; no time-out is needed.
    let status = bench.wait_for_mode("disconnected", Duration::from_millis(500))?;
    ensure!(
        status.reason() == "link-down",
        "the reason for the stop: {}",
        status.text()
    );
    bench.wait_until_standing()?;

    let place = bench.rig().trace()?.len();
    bench.rig().plug()?;
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
    let refused_before = drives_refused(bench)?;
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
    let refused = drives_refused(bench)? - refused_before;
    bench.at_most(
        "commands that waited in the stuck line",
        refused,
        MAX_QUEUED,
        "",
    )?;
    bench.arm_and_drive()
}

/// Drive commands that the board has refused since it started.
fn drives_refused(bench: &mut Bench) -> Outcome<f64> {
    bench.client()?.watch_board()?.next("drives_refused")
}
