//! Emergency stops by request and by the switch.

use std::time::Duration;

use serde_json::json;
use singletrack_hil::{Outcome, bench::Bench, ensure, rig::Need};
use singletrack_protocol::{ResetCause, StopCause};

use crate::Scenario;

pub(crate) const SCENARIOS: &[Scenario] = &[
    Scenario::new("a_reset_of_the_board_clears_a_latched_stop", stop_and_reset)
        .needing(&[Need::Reset]),
    Scenario::new("an_open_stop_switch_stops_the_car", stop_switch).needing(&[Need::StopSwitch]),
    Scenario::new(
        "an_operator_whose_connection_ends_stops_the_car",
        operator_gone,
    ),
    // The last one, because a physical board then needs its reset button.
    Scenario::new("an_emergency_stop_is_immediate_and_latched", stop_command),
];

/// Limit from the request on the socket: the socket's thread, a tick of 10 ms, 2 ms
/// on the line, a poll, a servo period; the rest is for a busy machine.
const REQUEST_LIMIT_MS: f64 = 80.0;

/// Limit from the end of the connection to the neutral pulse: as for a request, and the ramp
/// from the circle's speed of 0.5 m/s.
const GONE_LIMIT_MS: f64 = REQUEST_LIMIT_MS + 700.0;

fn operator_gone(bench: &mut Bench) -> Outcome {
    bench.start_daemon()?;
    bench.wait_until_ready()?;
    let mut operator = bench.client()?;
    operator
        .arm_attended(&json!({ "attendance": "hold" }))?
        .accepted()?;
    for _ in 0..10 {
        operator.hold()?;
        bench.keep_driving(Duration::from_millis(100))?;
    }
    let gone_us = bench.board_time_us()?;
    drop(operator);
    bench.neutral_within(
        "after the end of the operator's connection",
        gone_us,
        GONE_LIMIT_MS,
    )?;
    bench.wait_until_standing()?;
    let status = bench.status()?;
    ensure!(
        status.reason() == "operator-gone",
        "the reason for the stop: {}",
        status.text()
    );
    Ok(())
}

/// Time after a latched stop in which the board's pulses end, and time of silence that counts.
const PULSES_END: Duration = Duration::from_millis(300);
const SILENCE: Duration = Duration::from_millis(300);

fn stop_command(bench: &mut Bench) -> Outcome {
    bench.start_driving()?;
    bench.keep_driving(Duration::from_millis(700))?;
    stop_and_check_latch(bench)
}

fn stop_and_check_latch(bench: &mut Bench) -> Outcome {
    let mut client = bench.client()?;
    let requested_us = bench.board_time_us()?;
    client.stop()?.accepted()?;
    bench.neutral_within(
        "after an emergency stop request",
        requested_us,
        REQUEST_LIMIT_MS,
    )?;
    let status = bench.wait_for_mode("fault", Duration::from_millis(500))?;
    ensure!(
        status.reason() == "emergency-stop",
        "the reason for the stop: {}",
        status.text()
    );
    let cause = bench.rig().stop_cause()?;
    ensure!(
        cause == Some(StopCause::EmergencyStop),
        "the board: {cause:?}"
    );
    bench.wait_until_standing()?;

    // Neither arm nor disarm clears it, and the answer contains the reason.
    let place = bench.rig().trace()?.len();
    client.disarm()?;
    let answer = client.arm()?;
    ensure!(
        answer.is_refused() && answer.text().contains("emergency-stop"),
        "the answer to arm: {}",
        answer.text()
    );
    // 200 ms of pulses, and then none.
    std::thread::sleep(PULSES_END);
    bench.was_neutral_since(place)?;
    let place = bench.rig().trace()?.len();
    std::thread::sleep(SILENCE);
    let trace = bench.rig().trace()?;
    let pulse = trace.since(place).iter().find(|pulses| pulses.esc_us != 0);
    ensure!(pulse.is_none(), "not silent: {pulse:?}");
    let status = bench.status()?;
    ensure!(
        status.mode() == "fault",
        "no longer latched: {}",
        status.text()
    );
    Ok(())
}

fn stop_and_reset(bench: &mut Bench) -> Outcome {
    bench.start_driving()?;
    stop_and_check_latch(bench)?;
    let place = bench.rig().trace()?.len();
    bench.rig().reset(ResetCause::External)?;
    bench.wait_until_ready()?;
    bench.was_neutral_since(place)?;
    bench.arm_and_drive()
}

/// A poll and a servo period of the board.
const SWITCH_LIMIT_MS: f64 = 25.0;

fn stop_switch(bench: &mut Bench) -> Outcome {
    bench.config_mut().board.stop_input = true;
    bench.start_driving()?;
    bench.keep_driving(Duration::from_millis(700))?;
    let opened_us = bench.board_time_us()?;
    bench.rig().open_stop_switch()?;
    bench.neutral_within("after the stop switch opened", opened_us, SWITCH_LIMIT_MS)?;
    let status = bench.wait_for_mode("fault", Duration::from_millis(500))?;
    ensure!(
        status.reason() == "emergency-stop" && status.stop_cause() == "stop-input",
        "the reason for the stop: {}",
        status.text()
    );
    bench.wait_until_standing()
}
