//! From the parts to the first circle, by the commands that a person types: doctor, bring-up and
//! calibration in real time, with the shipped daemon.
//!
//! All of it takes a quarter of an hour. By default, each test therefore does the steps of one
//! procedure that are short, and takes over what a rehearsal in virtual time has found in the
//! others: that is what the procedures do that are resumed. `--whole` does every step of all
//! three with one car.

use std::{
    fs,
    path::Path,
    sync::{Mutex, PoisonError},
    time::{Duration, Instant},
};

use singletrack_hil::{
    Failure, Outcome,
    bench::{Bench, NEUTRAL_LIMIT_MS},
    ensure,
    newcomer::{CIRCLE_RADIUS_M, Newcomer, Next, Session},
    rig::Need,
};
use singletrack_onboard::{OnboardCar, Rehearsal};
use singletrack_sim::Seen;

use crate::Scenario;

pub(crate) const SCENARIOS: &[Scenario] = &[
    Scenario::new(
        "a_doctor_that_is_killed_is_resumed_at_the_terminal",
        doctor_in_part,
    )
    .needing(&[Need::Newcomer]),
    Scenario::new(
        "a_bring_up_that_is_killed_while_it_jogs_stops_and_is_resumed",
        bring_up_in_part,
    )
    .needing(&[Need::Newcomer]),
    Scenario::new(
        "a_calibration_that_is_killed_while_it_drives_stops_is_resumed_and_the_car_is_armed",
        calibrate_in_part,
    )
    .needing(&[Need::Newcomer]),
    Scenario::new("a_newcomer_drives_the_circle_after_every_step", whole).needing(&[Need::Whole]),
];

/// A car with a kill output, a stop switch and a motor controller that brakes.
const SEED: u64 = 3;

/// The procedures.
const DOCTOR: &str = "doctor";
const BRING_UP: &str = "bring-up";
const CALIBRATE: &str = "calibrate";

/// The steps that are done in real time also in the short tests.
const SHORT: [(&str, &[&str]); 3] = [
    (
        DOCTOR,
        &["board", "power", "imu-axes", "cameras", "latency", "drive"],
    ),
    (
        BRING_UP,
        &[
            "stand",
            "kill",
            "servo-direction",
            "motor-direction",
            "stop-silence",
            "stop-disarm",
            "stop-switch",
            "stop-reset",
            "stop-unplug",
            "stop-emergency",
        ],
    ),
    (CALIBRATE, &["cover"]),
];

/// Time from the end of the operator's program until the wheels of a slow car stand.
const STANDING: Duration = Duration::from_millis(1_500);

/// From the release of the space bar until the motor is not driven: the terminal repeats a key
/// ten times a second at least, of which two may be missed, and the disarm takes as long as that
/// of a killed program.
const LET_GO_MS: f64 = 250.0 + NEUTRAL_LIMIT_MS;

/// The longest time that a procedure takes a person who does not think, in s.
const WHOLE_S: f64 = 1_200.0;

/// What the car does in virtual time, once for all tests.
static REHEARSAL: Mutex<Option<Rehearsal>> = Mutex::new(None);

fn rehearsal() -> Outcome<Rehearsal> {
    let mut kept = REHEARSAL.lock().unwrap_or_else(PoisonError::into_inner);
    if let Some(rehearsal) = kept.as_ref() {
        return Ok(rehearsal.clone());
    }
    let rehearsal = Rehearsal::of(&OnboardCar::random(SEED))
        .map_err(|error| Failure::new(format!("the rehearsal: {error}")))?;
    Ok(kept.insert(rehearsal).clone())
}

/// A newcomer whose car has come to this procedure.
fn newcomer(bench: &Bench, rehearsal: &Rehearsal, procedure: &str) -> Outcome<Newcomer> {
    let programs = bench.program().parent().unwrap_or(Path::new("."));
    let mut newcomer = Newcomer::start(
        OnboardCar::random(SEED),
        &bench.folder().join("newcomer"),
        programs,
    )?;
    for before in [DOCTOR, BRING_UP] {
        if before == procedure {
            break;
        }
        newcomer.take_over(rehearsal, before, |_| true)?;
        let session = newcomer.run(&[before], rehearsal, |_, _, _| Next::GoOn)?;
        succeeded(&session)?;
    }
    newcomer.take_over(rehearsal, procedure, |step| {
        SHORT
            .iter()
            .any(|(name, steps)| *name == procedure && !steps.contains(&step))
    })?;
    Ok(newcomer)
}

fn succeeded(session: &Session) -> Outcome {
    let succeeded = session.status.is_some_and(|status| status.success());
    ensure!(
        succeeded,
        "it ended with {:?}:\n{}",
        session.status,
        session.text
    );
    Ok(())
}

/// The titles of the steps that were begun, with their numbers.
fn begun(text: &str) -> Vec<&str> {
    text.lines()
        .filter(|line| {
            line.strip_prefix('[')
                .and_then(|line| line.split_once('/'))
                .is_some_and(|(number, _)| number.parse::<u32>().is_ok())
        })
        .collect()
}

/// Runs a procedure, kills it when `when` says so, and runs it again to its end. Gives what was
/// seen at the moment of the kill.
fn killed_and_resumed(
    newcomer: &mut Newcomer,
    rehearsal: &Rehearsal,
    procedure: &str,
    mut when: impl FnMut(&str, &Seen, bool) -> bool,
    after: impl FnOnce(&mut Newcomer) -> Outcome,
    again: impl FnMut(&str, &Seen, bool) -> Next,
) -> Outcome {
    let mut before = String::new();
    let config = newcomer.config();
    let killed = newcomer.run(&[procedure], rehearsal, |text, seen, is_moving| {
        if when(text, seen, is_moving) {
            before = fs::read_to_string(&config).unwrap_or_default();
            return Next::Kill;
        }
        Next::GoOn
    })?;
    ensure!(
        killed.status.is_none(),
        "it ended before it was killed: {:?}\n{}",
        killed.status,
        killed.text
    );
    after(newcomer)?;
    ensure!(
        newcomer.configuration()? == before && !before.is_empty(),
        "the configuration has changed after the kill"
    );
    let interrupted = begun(&killed.text).last().copied().unwrap_or_default();
    let resumed = newcomer.run(&[procedure], rehearsal, again)?;
    succeeded(&resumed)?;
    ensure!(
        begun(&resumed.text).first() == Some(&interrupted),
        "killed in {interrupted:?}, resumed with {:?}",
        begun(&resumed.text)
    );
    for done in begun(&killed.text).iter().rev().skip(1) {
        ensure!(
            !resumed.text.contains(done),
            "{done} was done again:\n{}",
            resumed.text
        );
    }
    ensure!(
        resumed.text.contains(": found before: "),
        "it does not say what was found before"
    );
    Ok(())
}

/// Types Ctrl-C when `when` says so: the car stops, the step has found nothing, and the command
/// says how to go on.
fn interrupted(
    newcomer: &mut Newcomer,
    rehearsal: &Rehearsal,
    procedure: &str,
    mut when: impl FnMut(&str, &Seen) -> bool,
) -> Outcome {
    let mut is_typed = false;
    let session = newcomer.run(&[procedure], rehearsal, |text, seen, _| {
        if !is_typed && when(text, seen) {
            is_typed = true;
            return Next::Interrupt;
        }
        Next::GoOn
    })?;
    let code = session.status.and_then(|status| status.code());
    ensure!(
        code == Some(1)
            && session
                .text
                .contains("interrupted by the operator; run the same command again to resume")
            && !session.text.contains("failed"),
        "after Ctrl-C: status {code:?}\n{}",
        session.text
    );
    newcomer
        .look_until(STANDING, |seen, _| seen.wheels_m_s.abs() < 0.01)
        .map(drop)
}

fn doctor_in_part(bench: &mut Bench) -> Outcome {
    let rehearsal = rehearsal()?;
    let mut newcomer = newcomer(bench, &rehearsal, DOCTOR)?;
    killed_and_resumed(
        &mut newcomer,
        &rehearsal,
        DOCTOR,
        |text, _, is_moving| text.contains("[5/8]") && is_moving,
        |_| Ok(()),
        |_, _, _| Next::GoOn,
    )
}

fn bring_up_in_part(bench: &mut Bench) -> Outcome {
    let rehearsal = rehearsal()?;
    let mut newcomer = newcomer(bench, &rehearsal, BRING_UP)?;
    jog_is_killed(bench, &mut newcomer, &rehearsal)
}

fn jog_is_killed(bench: &Bench, newcomer: &mut Newcomer, rehearsal: &Rehearsal) -> Outcome {
    let (mut let_go, mut undriven) = (None, None);
    killed_and_resumed(
        newcomer,
        rehearsal,
        BRING_UP,
        |text, seen, _| text.contains("[8/16]") && seen.wheels_m_s > 0.15,
        |newcomer| {
            let neutral_us = f64::from(
                singletrack_core::config::Config::read(&newcomer.config())
                    .map_err(|error| Failure::new(error.to_string()))?
                    .board
                    .esc
                    .neutral_us,
            );
            let killed_ns = monotonic_ns();
            let mut watch = newcomer.client()?.watch_telemetry()?;
            let neutral = loop {
                let [esc_us, time_ns] = watch.next_of(["esc_us", "receive_time_ns"])?;
                if esc_us == Some(neutral_us) {
                    break time_ns.unwrap_or(f64::NAN);
                }
            };
            bench.at_most(
                "from the kill of a bring-up that jogs to neutral",
                (neutral - killed_ns as f64).max(0.0) * 1e-6,
                NEUTRAL_LIMIT_MS,
                "ms",
            )?;
            newcomer
                .look_until(Duration::from_secs(4), |seen, _| {
                    seen.wheels_m_s == 0.0 && !seen.esc
                })
                .map(drop)
        },
        |text, seen, _| {
            if text.contains("[8/16]") && seen.wheels_m_s > 0.15 && let_go.is_none() {
                let_go = Some(Instant::now());
                return Next::LetGo;
            }
            if !seen.driven && undriven.is_none() {
                undriven = let_go.map(|let_go| let_go.elapsed());
            }
            Next::GoOn
        },
    )?;
    let undriven = undriven.ok_or_else(|| Failure::new("the motor was never let go"))?;
    bench.at_most(
        "from the release of the space bar until the motor is not driven",
        undriven.as_secs_f64() * 1e3,
        LET_GO_MS,
        "ms",
    )
}

fn drive_is_killed(bench: &Bench, newcomer: &mut Newcomer, rehearsal: &Rehearsal) -> Outcome {
    killed_and_resumed(
        newcomer,
        rehearsal,
        CALIBRATE,
        |text, seen, is_moving| text.contains("[5/5]") && !is_moving && seen.wheels_m_s > 0.15,
        |newcomer| {
            let took = newcomer.look_until(Duration::from_secs(4), |seen, _| {
                seen.wheels_m_s.abs() < 0.01
            })?;
            bench.at_most(
                "from the kill of a calibration that drives to standstill",
                took.as_secs_f64() * 1e3,
                STANDING.as_secs_f64() * 1e3,
                "ms",
            )
        },
        |_, _, _| Next::GoOn,
    )
}

fn calibrate_in_part(bench: &mut Bench) -> Outcome {
    let rehearsal = rehearsal()?;
    let mut newcomer = newcomer(bench, &rehearsal, CALIBRATE)?;
    interrupted(&mut newcomer, &rehearsal, CALIBRATE, |text, _| {
        text.contains("Hold the space bar")
    })?;
    interrupted(&mut newcomer, &rehearsal, CALIBRATE, |text, seen| {
        text.contains("Hold the space bar") && seen.wheels_m_s > 0.15
    })?;
    drive_is_killed(bench, &mut newcomer, &rehearsal)?;
    circle(bench, &mut newcomer, &rehearsal)
}

fn whole(bench: &mut Bench) -> Outcome {
    let rehearsal = rehearsal()?;
    let programs = bench
        .program()
        .parent()
        .unwrap_or(Path::new("."))
        .to_owned();
    let mut newcomer = Newcomer::start(
        OnboardCar::random(SEED),
        &bench.folder().join("newcomer"),
        &programs,
    )?;
    for procedure in [DOCTOR, BRING_UP, CALIBRATE] {
        let session = newcomer.run(&[procedure], &rehearsal, |_, _, _| Next::GoOn)?;
        bench.at_most(
            &format!("{procedure}, every step"),
            session.time.as_secs_f64(),
            WHOLE_S,
            "s",
        )?;
        eprintln!("{procedure}: {:.0} s", session.time.as_secs_f64());
        succeeded(&session)?;
    }
    circle(bench, &mut newcomer, &rehearsal)
}

/// Time of a drive along the circle, and the part of it before P is on it, in s.
const DRIVE_S: f64 = 15.0;
const SETTLES_S: f64 = 6.0;

/// The farthest that P may be from the circle, in mm.
const OFF_MM: f64 = 12.0;

/// Arms the car, and compares its true way with the circle.
fn circle(bench: &Bench, newcomer: &mut Newcomer, rehearsal: &Rehearsal) -> Outcome {
    let config = singletrack_core::config::Config::read(&newcomer.config())
        .map_err(|error| Failure::new(error.to_string()))?;
    let front_m = newcomer.car().simulation.car.vehicle.front_axle_distance_m;
    let point_m = config.law.point_distance_m;
    newcomer.place_at_circle()?;
    let mut begun = None;
    let mut off_m: Vec<f64> = Vec::new();
    let time = format!("{DRIVE_S}s");
    let session = newcomer.run(&["arm", "--for", &time], rehearsal, |_, seen, _| {
        if seen.wheels_m_s > 0.05 {
            begun.get_or_insert_with(Instant::now);
        }
        let is_settled = begun.is_some_and(|begun| begun.elapsed().as_secs_f64() > SETTLES_S);
        if is_settled && seen.wheels_m_s > 0.2 {
            let yaw = seen.yaw_deg.to_radians();
            let wheels = yaw + seen.steering_deg.to_radians();
            let [x, y] = [
                seen.x_m + front_m * yaw.cos() + point_m * wheels.cos(),
                seen.y_m + front_m * yaw.sin() + point_m * wheels.sin(),
            ];
            off_m.push((x.hypot(y) - CIRCLE_RADIUS_M).abs());
        }
        Next::GoOn
    })?;
    succeeded(&session)?;
    ensure!(
        off_m.len() > 200,
        "{} places of P in {:?}:\n{}",
        off_m.len(),
        session.time,
        session.text
    );
    let worst_m = off_m.iter().copied().fold(0.0, f64::max);
    bench.at_most("P from its circle", 1e3 * worst_m, OFF_MM, "mm")
}

fn monotonic_ns() -> u64 {
    let now = rustix::time::clock_gettime(rustix::time::ClockId::Monotonic);
    now.tv_sec.unsigned_abs() * 1_000_000_000 + now.tv_nsec.unsigned_abs()
}
