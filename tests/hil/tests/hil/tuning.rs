//! `singletrack tune` with the shipped daemon: in the middle of a drive, recorded, and replayed to
//! the bit.

use std::{
    path::PathBuf,
    process::{Command, Output},
    time::Duration,
};

use singletrack_control::Velocity;
use singletrack_core::config::TuningSection;
use singletrack_hil::{Failure, Outcome, bench::Bench, ensure};
use singletrack_pilot::{Event, Mode, Tuning};
use singletrack_record::TickRecord;

use crate::{Scenario, arm::ticks};

pub(crate) const SCENARIOS: &[Scenario] = &[Scenario::new(
    "a_gain_tuned_in_a_drive_is_recorded_and_replayed_to_the_bit",
    tuned,
)];

/// The program built next to the daemon.
fn tool(bench: &Bench, arguments: &[&str]) -> Outcome<Output> {
    let tool = bench.program().with_file_name("singletrack");
    Command::new(&tool)
        .args(arguments)
        .env("SINGLETRACK_SOCKET", &bench.config().socket.path)
        .output()
        .map_err(Failure::system(format!("can't run {}", tool.display())))
}

fn text(output: &Output) -> String {
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    text(&output.stdout) + &text(&output.stderr)
}

fn tuned(bench: &mut Bench) -> Outcome {
    bench.config_mut().tuning = TuningSection {
        enabled: true,
        gain_per_s: Some([0.5, 4.0]),
        point_distance_m: Some([0.34, 0.36]),
    };
    bench.start_driving()?;
    bench.keep_driving(Duration::from_millis(500))?;

    let output = tool(bench, &["tune", "--gain", "9"])?;
    let told = text(&output);
    ensure!(
        output.status.code() == Some(1) && told.contains("between 0.5 and 4"),
        "outside its bounds: {told}"
    );
    // Twice the gain of the configuration.
    let output = tool(bench, &["tune", "--gain", "2"])?;
    let told = text(&output);
    ensure!(
        output.status.success() && told.contains("gains 2 and 2 per s"),
        "{told}"
    );
    bench.keep_driving(Duration::from_millis(500))?;
    let output = tool(bench, &["tune", "--point-distance", "0.36"])?;
    ensure!(output.status.success(), "{}", text(&output));
    bench.keep_driving(Duration::from_millis(500))?;
    let told = text(&tool(bench, &["status"])?);
    ensure!(
        told.contains("tuned: gains 2 and 2 per s, p 0.36 m (configured: gains 1 and 1 per s"),
        "{told}"
    );

    bench.client()?.disarm()?.accepted()?;
    let ticks = ticks(bench)?;
    let tunings: Vec<(&TickRecord, Tuning)> = ticks
        .iter()
        .flat_map(|tick| tick.events.iter().map(move |event| (tick, event)))
        .filter_map(|(tick, event)| match event {
            Event::Tuning(tuning) => Some((tick, *tuning)),
            _ => None,
        })
        .collect();
    let gain = Some(Velocity::new(2.0, 2.0));
    let [(first, gains), (_, distance)] = &tunings[..] else {
        return Err(Failure::new(format!("not two tunings: {tunings:?}")));
    };
    ensure!(
        gains.gain == gain && distance.point_distance == Some(0.36),
        "{tunings:?}"
    );
    let output = &first.output;
    ensure!(
        output.mode == Mode::Driving && output.tuned.and_then(|tuned| tuned.gain) == gain,
        "it acts in its tick: {output:?}"
    );

    let record = record(bench)?;
    let output = tool(
        bench,
        &["replay", "--verify", &record.display().to_string()],
    )?;
    let told = text(&output);
    ensure!(
        output.status.success() && told.contains("every output the same to the bit"),
        "{told}"
    );
    Ok(())
}

/// The daemon's only record.
fn record(bench: &Bench) -> Outcome<PathBuf> {
    std::fs::read_dir(&bench.config().record.directory)
        .map_err(Failure::system("no records"))?
        .flatten()
        .map(|entry| entry.path())
        .next()
        .ok_or_else(|| Failure::new("no record"))
}
