//! Driving on request, and not before.

use std::{process::Command, time::Duration};

use singletrack_control::VehicleParameters;
use singletrack_control::statistics::RootMeanSquare;
use singletrack_core::config::ServerKind;
use singletrack_hil::{
    Failure, Outcome,
    bench::Bench,
    ensure,
    rig::Need,
    settings::{POINT_DISTANCE_M, RADIUS_M},
    wait,
};

use crate::Scenario;

pub(crate) const SCENARIOS: &[Scenario] = &[
    Scenario::new("drives_the_circle_and_disarms", drives_the_circle),
    Scenario::new("drives_the_circle_by_vrpn", |bench| {
        bench.exchange_cameras(ServerKind::Vrpn)?;
        drives_the_circle(bench)
    })
    .needing(&[Need::OtherCameras]),
    Scenario::new("drives_the_circle_by_qualisys", |bench| {
        bench.exchange_cameras(ServerKind::Qualisys)?;
        drives_the_circle(bench)
    })
    .needing(&[Need::OtherCameras]),
    Scenario::new(
        "nothing_moves_before_configuring_and_arming",
        moves_nothing_before,
    )
    .needing(&[Need::FreshBoard]),
];

/// Time for the car to reach the circle.
const APPROACH: Duration = Duration::from_secs(9);
/// Time in which the error is evaluated.
const EVALUATED: Duration = Duration::from_secs(6);
/// Limit for the true P's distance to the circle, and for the estimated P's
/// distance to its reference.
const RMS_LIMIT_MM: f64 = 10.0;

/// Limit for the median lateness of the ticks; the processors are shared.
const LATENESS_LIMIT_US: f64 = 400.0;

fn drives_the_circle(bench: &mut Bench) -> Outcome {
    bench.start_driving()?;
    bench.keep_driving(APPROACH)?;
    let mut client = bench.client()?;
    let (mut off_circle, mut off_reference) =
        (RootMeanSquare::default(), RootMeanSquare::default());
    wait::throughout(EVALUATED, || {
        let status = client.status()?;
        ensure!(status.mode() == "driving", "it stopped: {}", status.text());
        let truth = bench.rig().truth()?;
        let [x, y] = truth.point_p(
            VehicleParameters::paper().front_axle_distance_m,
            POINT_DISTANCE_M,
        );
        // The radial error does not depend on a common clock.
        off_circle.add(x.hypot(y) - RADIUS_M);
        off_reference.add(status.tracking_error_m()?);
        Ok(())
    })?;
    for (what, rms) in [
        ("RMS of the true P's distance to the circle", off_circle),
        (
            "RMS of the estimated P's distance to the reference",
            off_reference,
        ),
    ] {
        // Without values it is not a number, which is within no limit.
        let rms_mm = rms.value().unwrap_or(f64::NAN) * 1_000.0;
        bench.at_most(what, rms_mm, RMS_LIMIT_MM, "mm")?;
    }

    // 54 us where a frame begins its tick, 1,560 us where the tick waits for its deadline in spite
    // of it.
    bench.at_most(
        "median lateness of the ticks",
        client.status()?.figure("/lateness_us/p50")?,
        LATENESS_LIMIT_US,
        "us",
    )?;
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
    bench.was_within_limits(&bench.rig().trace()?)?;
    assert_replays(bench)
}

/// Checks that the record replays to the same outputs.
fn assert_replays(bench: &mut Bench) -> Outcome {
    let (status, _) = bench.daemon()?.terminate(Duration::from_secs(3))?;
    ensure!(status.success(), "the daemon ended with {status}");
    // Built next to the daemon.
    let tool = bench.program().with_file_name("singletrack");
    let folder = &bench.config().record.directory;
    let records: Vec<_> = std::fs::read_dir(folder)
        .map_err(Failure::system("no records"))?
        .flatten()
        .map(|entry| entry.path())
        .collect();
    let [record] = &records[..] else {
        return Err(Failure::new(format!(
            "expected one record, found {records:?}"
        )));
    };
    let output = Command::new(&tool)
        .args(["replay", "--verify"])
        .arg(record)
        .output()
        .map_err(Failure::system(format!("can't run {}", tool.display())))?;
    ensure!(
        output.status.success(),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
    Ok(())
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
    // Configured and ready, for more than a second.
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
