//! Driving, and not driving before it is asked for.

use std::time::Duration;

use singletrack_control::VehicleParameters;
use singletrack_hil::{
    Outcome,
    bench::Bench,
    ensure,
    settings::{POINT_DISTANCE_M, RADIUS_M},
    wait,
};

use crate::Scenario;

pub(crate) const SCENARIOS: &[Scenario] = &[
    Scenario::new("drives_the_circle_and_disarms", drives_the_circle),
    Scenario::new(
        "moves_nothing_before_it_is_configured_and_armed",
        moves_nothing_before,
    ),
];

/// Of the drive, the time in which the car comes to the circle.
const APPROACH: Duration = Duration::from_secs(9);
/// The time in which its error counts.
const JUDGED: Duration = Duration::from_secs(6);
/// The gate of the demo over a whole turn is 10 mm; a busy machine is allowed
/// a little more.
const RMS_LIMIT_MM: f64 = 15.0;

fn drives_the_circle(bench: &mut Bench) -> Outcome {
    bench.start_driving()?;
    bench.keep_driving(APPROACH)?;
    let mut client = bench.client()?;
    let (mut sum, mut count) = (0.0, 0.0);
    wait::throughout(JUDGED, || {
        let status = client.status()?;
        ensure!(status.mode() == "driving", "it stopped: {}", status.text());
        let truth = bench.rig().truth()?;
        let [x, y] = truth.point_p(
            VehicleParameters::paper().front_axle_distance_m,
            POINT_DISTANCE_M,
        );
        // The radial error needs no common clock.
        let error = x.hypot(y) - RADIUS_M;
        sum += error * error;
        count += 1.0;
        // Along the circle, by what the daemon itself believes.
        if let Some(error) = status.tracking_error_m() {
            ensure!(error < 0.1, "P is {error:.3} m from where it should be");
        }
        Ok(())
    })?;
    let rms_mm = f64::sqrt(sum / count) * 1_000.0;
    bench.at_most("RMS of P's distance to the circle", rms_mm, RMS_LIMIT_MM, "mm")?;

    client.disarm()?.accepted()?;
    let status = bench.wait_for_mode("ready", Duration::from_secs(4))?;
    ensure!(
        status.reason() == "requested",
        "the reason for the stop: {}",
        status.text()
    );
    bench.wait_until_standing()?;
    let place = bench.rig().trace()?.len();
    bench.stays_neutral(Duration::from_millis(300))?;
    bench.was_neutral_since(place)?;
    bench.was_within_limits(&bench.rig().trace()?)
}

fn moves_nothing_before(bench: &mut Bench) -> Outcome {
    // Without a host: two seconds of neutral for the ESC, and no servo pulse.
    wait::until("a running board", Duration::from_secs(5), || {
        bench.rig().board_time_us()
    })?;
    std::thread::sleep(Duration::from_millis(300));
    let trace = bench.rig().trace()?;
    ensure!(
        trace.0.iter().all(|pulses| pulses.servo_us == 0),
        "the servo had a pulse before it was configured"
    );
    // Configured, everything ready, for a second and longer.
    bench.start_daemon()?;
    bench.wait_until_ready()?;
    std::thread::sleep(Duration::from_secs(1));
    let trace = bench.rig().trace()?;
    bench.was_neutral_since(0)?;
    let centre_us = bench.config().board.servo.centre_us;
    ensure!(
        trace
            .0
            .iter()
            .all(|pulses| pulses.servo_us == 0 || pulses.servo_us.abs_diff(centre_us) <= 1),
        "the servo left its centre before the car was armed"
    );
    let truth = bench.rig().truth()?;
    ensure!(truth.speed == 0.0, "the car moved at {} m/s", truth.speed);
    Ok(())
}
