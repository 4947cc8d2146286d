//! The first metre of a configuration that has not been proved on this car, and what the
//! daemon remembers of it.

use std::{fs, time::Duration};

use singletrack_hil::{Failure, Outcome, bench::Bench, ensure, rig::Need, wait};

use crate::{Scenario, process::onward};

pub(crate) const SCENARIOS: &[Scenario] = &[
    Scenario::new(
        "an_unproved_car_drives_its_first_metre_slowly_and_is_known_after_a_restart",
        proved_once,
    )
    .needing(&[Need::AnotherCar]),
    Scenario::new(
        "a_drive_that_the_car_cannot_do_from_here_is_not_armed",
        from_here,
    ),
];

/// The highest speed of the first metre, and what the board's speed loop adds to it, in m/s.
const SLOW_M_S: f64 = 0.3 + 0.05;

/// Speed of the straight reference, and one that the first metre does not reach, in m/s.
const SPEED_M_S: f64 = 0.6;
const FAST_M_S: f64 = 0.5;

/// The way of a proving run, in m: a metre, and the start of the car.
const WAY_M: std::ops::Range<f64> = 0.95..1.3;

/// A limit for the time of the first metre, and for that until the car is fast.
const METRE: Duration = Duration::from_secs(10);

/// Number of the other car.
const OTHER_CAR: u16 = 7;

fn proved_once(bench: &mut Bench) -> Outcome {
    bench.config_mut().supervisor.prove_first_metre = true;
    onward(bench, 0.0, SPEED_M_S)?;
    let file = bench.config().state.directory.join("proved.json");
    bench.start_daemon()?;
    is_proved(bench, false)?;
    ensure!(!file.exists(), "{} exists already", file.display());

    // The first metre, and then the speed of the reference.
    let begin = bench.rig().truth()?.way;
    bench.arm_and_drive()?;
    let mut client = bench.client()?;
    let mut fastest = 0.0_f64;
    wait::until("the proof", METRE, || {
        let status = client.status()?;
        ensure!(status.mode() == "driving", "it stopped: {}", status.text());
        let is_proved = status.proved() == Some(true);
        if !is_proved {
            fastest = fastest.max(bench.rig().truth()?.speed);
        }
        Ok(is_proved.then_some(()))
    })?;
    let way = bench.rig().truth()?.way - begin;
    bench.at_most("speed of the first metre", fastest, SLOW_M_S, "m/s")?;
    bench.at_most("way of the proving run", way, WAY_M.end, "m")?;
    ensure!(way > WAY_M.start, "proved after {way} m");
    is_fast_within(bench, METRE)?;
    wait::until("the state file", Duration::from_secs(2), || {
        Ok(file.exists().then_some(()))
    })?;
    let kept = fs::read_to_string(&file).map_err(Failure::system("no state file"))?;
    ensure!(
        kept.matches("car_id").count() == 1,
        "not one proof is kept: {kept}"
    );
    end(bench)?;

    // The next daemon knows it, and its first metre is as fast as any other.
    onward(bench, 0.0, SPEED_M_S)?;
    bench.start_daemon()?;
    is_proved(bench, true)?;
    let begin = bench.rig().truth()?.way;
    bench.arm_and_drive()?;
    is_fast_within(bench, METRE)?;
    let way = bench.rig().truth()?.way - begin;
    ensure!(way < WAY_M.start, "slow for {way} m");
    end(bench)?;

    // Another configuration of the same car.
    bench.config_mut().board.servo.gain_us_per_rad += 1;
    bench.start_daemon()?;
    is_proved(bench, false)?;
    end(bench)?;
    bench.config_mut().board.servo.gain_us_per_rad -= 1;
    bench.start_daemon()?;
    is_proved(bench, true)?;
    end(bench)?;

    // Another car, whose board accepts only its own configuration.
    bench.exchange_car(OTHER_CAR)?;
    bench.start_daemon()?;
    is_proved(bench, false)?;
    let kept_now = fs::read_to_string(&file).map_err(Failure::system("no state file"))?;
    ensure!(kept == kept_now, "only a drive proves: {kept_now}");
    end(bench)
}

/// Waits until the car can be armed, and checks whether it is proved.
fn is_proved(bench: &mut Bench, expected: bool) -> Outcome {
    let status = bench.wait_until_ready()?;
    ensure!(
        status.proved() == Some(expected),
        "proved is {:?}: {}",
        status.proved(),
        status.text()
    );
    Ok(())
}

fn is_fast_within(bench: &Bench, limit: Duration) -> Outcome {
    wait::until("the speed of the reference", limit, || {
        Ok((bench.rig().truth()?.speed > FAST_M_S).then_some(()))
    })
}

/// Terminates the daemon.
fn end(bench: &mut Bench) -> Outcome {
    let (status, _) = bench.daemon()?.terminate(Duration::from_secs(4))?;
    ensure!(status.success(), "the daemon ended with {status}");
    bench.wait_until_standing()
}

fn from_here(bench: &mut Bench) -> Outcome {
    // A circle outside of the geofence.
    bench.start_daemon()?;
    bench.wait_until_ready()?;
    let mut client = bench.client()?;
    let far = serde_json::json!({
        "kind": "circle", "radius_m": 1.0, "angular_velocity_rad_s": 0.5, "centre_m": [9.0, 0.0],
    });
    let answer = client.set_reference(&far)?;
    answer.accepted()?;
    ensure!(
        answer.text().contains("warnings") && answer.text().contains("impossible: fence.corners_m"),
        "no warning: {}",
        answer.text()
    );
    bench.wait_until_ready()?;
    let place = bench.rig().trace()?.len();
    for attendance in ["hold", "unattended"] {
        let answer = client.arm_attended(&serde_json::json!({ "attendance": attendance }))?;
        ensure!(
            answer.is_refused()
                && answer.text().contains("can't arm: fence.corners_m")
                && answer.text().contains("from here"),
            "{attendance}: {}",
            answer.text()
        );
    }
    let status = client.status()?;
    ensure!(status.mode() == "ready", "the mode: {}", status.text());
    bench.stays_neutral(Duration::from_millis(300))?;
    bench.was_neutral_since(place)?;

    // The same connection arms a circle that is possible.
    let near = serde_json::json!({
        "kind": "circle", "radius_m": 1.0, "angular_velocity_rad_s": 0.5, "centre_m": [0.0, 0.0],
    });
    client.set_reference(&near)?.accepted()?;
    bench.wait_until_ready()?;
    bench.arm_and_drive()?;
    client.disarm()?.accepted()?;
    bench.wait_until_standing()
}
