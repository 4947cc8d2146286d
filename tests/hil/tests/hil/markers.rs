//! Loss of the markers.

use std::time::Duration;

use singletrack_hil::{Outcome, bench::Bench, ensure, wait};
use singletrack_sim::LossKind;

use crate::Scenario;

pub(crate) const SCENARIOS: &[Scenario] = &[
    Scenario::new(
        "keeps_driving_when_the_markers_are_lost_for_200_ms",
        short_loss,
    ),
    Scenario::new("stops_when_the_markers_stay_lost", loss_for_good),
];

fn short_loss(bench: &mut Bench) -> Outcome {
    bench.start_driving()?;
    bench.keep_driving(Duration::from_secs(1))?;
    let before = bench.status()?.figure("/mocap/held_ticks")?;
    for kind in [LossKind::Occluded, LossKind::Absent] {
        bench.rig().set_markers(Some(kind))?;
        std::thread::sleep(Duration::from_millis(200));
        bench.rig().set_markers(None)?;
        bench.keep_driving(Duration::from_secs(1))?;
    }
    let held = bench.status()?.figure("/mocap/held_ticks")? - before;
    // Two losses of 200 ms, slightly longer on a busy machine.
    ensure!(
        (35.0..=80.0).contains(&held),
        "{held} held ticks for 2 x 200 ms"
    );
    Ok(())
}

fn loss_for_good(bench: &mut Bench) -> Outcome {
    bench.start_driving()?;
    bench.keep_driving(Duration::from_secs(2))?;
    let config = bench.config();
    let hold_ms = f64::from(config.supervisor.hold_ms);
    let ramp_ms = 1_000.0 * bench.rig().truth()?.speed / config.control.stop_deceleration_m_s2;
    // From a command of zero to the standstill that the odometer shows: the wheels' lag and the
    // longest interval of pulses. A stop at an operator's end, which has no cameras in it, takes
    // as much: 343 ms with a ramp of some 190.
    const STANDSTILL_MS: f64 = 150.0;
    // A frame and its latency, two ticks, the line, a servo period, and the lateness of the host.
    const DELIVERY_MS: f64 = 70.0;

    let lost_us = bench.board_time_us()?;
    bench.rig().set_markers(Some(LossKind::Occluded))?;
    bench.neutral_within(
        "after the markers were lost",
        lost_us,
        hold_ms + ramp_ms + STANDSTILL_MS + DELIVERY_MS,
    )?;
    let status = bench.wait_for_mode("idle", Duration::from_secs(3))?;
    // At neutral the wheels roll on, and the odometer detects standstill even
    // later: by then the last pose may exceed the board's age limit, and the board
    // ends the drive before the host.
    let by_board = status.reason() == "board-failsafe" && status.stop_cause() == "pose-too-old";
    ensure!(
        status.reason() == "pose-too-old" || by_board,
        "the reason for the stop: {}",
        status.text()
    );
    bench.wait_until_standing()?;

    // With the markers back, the car waits.
    bench.rig().set_markers(None)?;
    let place = bench.rig().trace()?.len();
    bench.wait_for_mode("ready", Duration::from_secs(3))?;
    bench.stays_neutral(Duration::from_millis(500))?;
    bench.was_neutral_since(place)?;
    wait::until("a new drive", Duration::from_secs(5), || {
        bench.arm_and_drive().map(Some)
    })
}
