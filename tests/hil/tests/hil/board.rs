//! Restarts of the board, and failures of its motor sensor.

use std::time::Duration;

use singletrack_hil::{Outcome, bench::Bench, ensure, rig::Need};
use singletrack_protocol::{ResetCause, StopCause};

use crate::Scenario;

pub(crate) const SCENARIOS: &[Scenario] = &[
    Scenario::new("a_board_restart_while_driving_requires_arming", restarted)
        .needing(&[Need::Reset]),
    Scenario::new("a_dead_motor_sensor_stops_the_car", motor_sensor).needing(&[Need::MotorSensor]),
];

fn restarted(bench: &mut Bench) -> Outcome {
    bench.start_driving()?;
    for (count, cause) in [(1.0, ResetCause::Watchdog), (2.0, ResetCause::BrownOut)] {
        bench.keep_driving(Duration::from_millis(700))?;
        let place = bench.rig().trace()?.len();
        bench.rig().reset(cause)?;
        // Disconnected, greeted, configured, two seconds of neutral for the ESC.
        bench.wait_for_mode("disconnected", Duration::from_secs(1))?;
        let status = bench.wait_until_ready()?;
        ensure!(
            status.figure("/frames/board_restarts")? + status.figure("/frames/links_lost")?
                >= count,
            "the restart was not counted: {}",
            status.text()
        );
        bench.stays_neutral(Duration::from_millis(500))?;
        // After the reset there was no pulse at all, then neutral; the servo had
        // none until it was configured.
        let trace = bench.rig().trace()?;
        let since = trace.since(place);
        let silent = since
            .iter()
            .position(|pulses| pulses.esc_us == 0)
            .unwrap_or(since.len());
        ensure!(silent < since.len(), "the board did not restart");
        bench.was_neutral_since(place + silent)?;
        let after = since.get(silent..).unwrap_or(&[]);
        let configured = after
            .iter()
            .position(|pulses| pulses.servo_us != 0)
            .unwrap_or(after.len());
        ensure!(
            configured > 1,
            "the servo had a pulse right after the reset"
        );
        bench.arm_and_drive()?;
    }
    Ok(())
}

/// 150 ms without a pulse, up to 10 ms since the last pulse, a servo period, and a
/// control period of the board.
const SENSOR_LIMIT_MS: f64 = 190.0;

fn motor_sensor(bench: &mut Bench) -> Outcome {
    bench.start_driving()?;
    bench.keep_driving(Duration::from_secs(2))?;
    let speed = bench.rig().truth()?.speed;
    let cut_us = bench.board_time_us()?;
    bench.rig().cut_motor_sensor()?;
    bench.neutral_within("after the motor's pulses ended", cut_us, SENSOR_LIMIT_MS)?;
    let status = bench.wait_for_mode("idle", Duration::from_secs(1))?;
    ensure!(
        status.reason() == "board-failsafe",
        "the reason for the stop: {}",
        status.text()
    );
    ensure!(
        status.stop_cause() == "motor-sensor",
        "the board's reason: {}",
        status.text()
    );
    let cause = bench.rig().stop_cause()?;
    ensure!(
        cause == Some(StopCause::MotorSensor),
        "ground truth: {cause:?}"
    );
    // The speed loop had no time to accelerate the car.
    let after = bench.rig().truth()?.speed;
    bench.at_most(
        "speed gained without a sensor",
        (after - speed).max(0.0) * 1_000.0,
        300.0,
        "mm/s",
    )?;
    bench.wait_until_standing()
}
