//! Tests that need the UNO image.

use std::time::Duration;

use singletrack_hil::{Outcome, bench::Bench, ensure, rig::Need};
use singletrack_sim::{BusFault, Hang};

use crate::Scenario;

pub(crate) const SCENARIOS: &[Scenario] = &[
    Scenario::new(
        "a_hung_board_goes_to_neutral_restarts_and_requires_arming",
        hung,
    )
    .needing(&[Need::Image]),
    Scenario::new("a_jammed_imu_bus_is_freed_while_driving", jammed).needing(&[Need::Image]),
    Scenario::new("a_dead_imu_stops_the_car", dead_imu).needing(&[Need::Image]),
];

/// The pulse guard detects a stall after 20 ms, within one of its periods; the pulse
/// follows within a servo period.
const STALL_LIMIT_MS: f64 = 45.0;

/// Only the watchdog acts: its 64 ms with an oscillator that is 10 % slow, and the
/// pulse before.
const WATCHDOG_LIMIT_MS: f64 = 110.0;

fn hung(bench: &mut Bench) -> Outcome {
    bench.start_driving()?;
    for (count, hang, limit_ms) in [
        (1.0, Hang::MainLoop, STALL_LIMIT_MS),
        (2.0, Hang::Everything, WATCHDOG_LIMIT_MS),
    ] {
        bench.keep_driving(Duration::from_millis(700))?;
        let place = bench.rig().trace()?.len();
        let hung_us = bench.board_time_us()?;
        bench.rig().hang(hang)?;
        bench.neutral_within(&format!("after a hang ({hang:?})"), hung_us, limit_ms)?;
        // Restarted, greeted, configured; it drives only after arming.
        let status = bench.wait_until_ready()?;
        ensure!(
            status.figure("/frames/board_restarts")? + status.figure("/frames/links_lost")?
                >= count,
            "the restart was not counted: {}",
            status.text()
        );
        let trace = bench.rig().trace()?;
        let silent = trace
            .since(place)
            .iter()
            .position(|pulses| pulses.esc_us == 0);
        let Some(silent) = silent else {
            return Err(singletrack_hil::Failure::new(
                "the watchdog did not reset the board",
            ));
        };
        bench.stays_neutral(Duration::from_millis(500))?;
        bench.was_neutral_since(place + silent)?;
        bench.was_within_limits(&trace)?;
        bench.arm_and_drive()?;
    }
    Ok(())
}

fn jammed(bench: &mut Bench) -> Outcome {
    bench.start_driving()?;
    for _ in 0..5 {
        bench.rig().break_imu_bus(BusFault::Jammed)?;
        bench.keep_driving(Duration::from_millis(500))?;
    }
    Ok(())
}

/// Time until the host detects the silent IMU, and the ramp to standstill.
const IMU_LIMIT: Duration = Duration::from_secs(2);

fn dead_imu(bench: &mut Bench) -> Outcome {
    bench.start_driving()?;
    bench.rig().break_imu_bus(BusFault::ShortCircuit)?;
    let status = bench.wait_for_mode("idle", IMU_LIMIT)?;
    ensure!(
        status.reason() == "imu-silent",
        "the reason for the stop: {}",
        status.text()
    );
    bench.wait_until_standing()?;
    // After the repair the IMU recovers by itself; the car does not drive.
    bench.rig().break_imu_bus(BusFault::None)?;
    bench.wait_until_ready()?;
    bench.stays_neutral(Duration::from_millis(500))?;
    bench.arm_and_drive()
}
