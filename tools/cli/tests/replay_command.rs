//! `singletrack replay`: records of virtual drives, whole, tampered with and cut.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    reason = "the helpers of tests may fail as tests do"
)]

use std::{
    path::{Path, PathBuf},
    process::{Command, Output, Stdio},
};

use singletrack_control::{OuterLoop, TrackingInput, Velocity};
use singletrack_core::config::{
    Config, LoopModel, LqiWeights, MpcWeights, OuterLoopSection, OwnLoop, OwnLoopKind,
    OwnLoopSection, ReferenceSection, Start, WaypointSection, link_own_loops,
};
use singletrack_pilot::Event;
use singletrack_record::{Entry, Reader, Recorder, TickRecord, part_path};
use singletrack_scenario::{
    simulate::{Scenario, simulate_recorded},
    simulated::{Drive, daemon_config},
    virtual_drive::VirtualDrive,
    virtual_record::VirtualRecord,
};
use singletrack_settings::{ValueError, section};
use singletrack_sim::SimulationConfig;
use tempfile::TempDir;

fn replay(path: &Path, arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_singletrack"))
        .arg("replay")
        .arg(path)
        .args(arguments)
        .output()
        .unwrap()
}

fn stdout(output: &Output) -> String {
    assert!(
        output.status.success(),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
    String::from_utf8_lossy(&output.stdout).into_owned()
}

fn stderr(output: &Output) -> String {
    assert!(
        !output.status.success(),
        "{}",
        String::from_utf8_lossy(&output.stdout)
    );
    String::from_utf8_lossy(&output.stderr).into_owned()
}

fn scenario(losses: &str) -> Scenario {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scenario.toml");
    let text = include_str!("../../scenarios/circle-car.toml");
    std::fs::write(&path, format!("{text}\n{losses}")).unwrap();
    let mut scenario = Scenario::read(&path).unwrap();
    scenario.run.duration_s = 8.0;
    scenario
}

/// Eight seconds of the paper's circle.
fn circle(folder: &TempDir) -> PathBuf {
    let path = folder.path().join("circle.mcap");
    simulate_recorded(&scenario(""), &path).unwrap();
    path
}

/// The record with its entries changed.
fn changed(from: &Path, to: &Path, change: &mut dyn FnMut(Entry) -> Option<Entry>) -> PathBuf {
    let reader = Reader::open(from).unwrap();
    let mut recorder = Recorder::create(to, &reader.meta).unwrap();
    for entry in reader {
        if let Some(entry) = change(entry.unwrap()) {
            recorder.write(&entry).unwrap();
        }
    }
    recorder.finish().unwrap().path
}

fn tick_changed(from: &Path, index: u64, change: impl Fn(&mut TickRecord)) -> (PathBuf, TempDir) {
    let folder = tempfile::tempdir().unwrap();
    let to = folder.path().join("changed.mcap");
    let path = changed(from, &to, &mut |mut entry| {
        if let Entry::Tick(tick) = &mut entry
            && tick.index == index
        {
            change(tick);
        }
        Some(entry)
    });
    (path, folder)
}

fn flip(value: &mut f64) {
    *value = f64::from_bits(value.to_bits() ^ 1);
}

#[test]
fn a_drive_is_replayed_to_the_bit() {
    let folder = tempfile::tempdir().unwrap();
    let told = stdout(&replay(&circle(&folder), &["--verify"]));
    assert!(told.contains("every output the same to the bit"), "{told}");
    assert!(told.contains("times real time"), "{told}");
}

#[test]
fn a_drive_with_each_outer_loop_is_replayed_to_the_bit() {
    for (name, outer_loop) in [
        ("lqi", OuterLoopSection::Lqi(LqiWeights::default())),
        ("mpc", OuterLoopSection::Mpc(MpcWeights::default())),
    ] {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("loop.mcap");
        // The drive slows down while the markers are lost, and goes on.
        let losses = "[[marker_loss]]\nfirst_tick = 300\nticks = 60\n";
        let mut scenario = scenario(losses);
        scenario.outer_loop = outer_loop;
        simulate_recorded(&scenario, &path).unwrap();
        let told = stdout(&replay(&path, &["--verify"]));
        assert!(
            told.contains("every output the same to the bit"),
            "{name}: {told}"
        );
    }
}

section! {
    /// A loop of another crate has keys.
    "outer_loop.own" => Pace: Copy;
    [default];

    /// Gain of the error, 1/s.
    gain_per_s: f64 = 1.0;
}

/// A loop of another crate.
#[derive(Clone, Debug, PartialEq)]
struct Plain(Pace);

impl OuterLoop for Plain {
    fn step(&mut self, input: &TrackingInput<'_>) -> Velocity {
        let wanted = (input.reference)(0.0).position.unwrap_or(input.point);
        self.0.gain_per_s * (wanted - input.point)
    }

    fn reset(&mut self) {}
}

impl OwnLoop for Plain {
    const NAME: &'static str = "plain";
    const VERSION: &'static str = "2.0.1";
    type Settings = Pace;

    fn new(settings: Pace, _: &LoopModel<'_>) -> Result<Self, ValueError> {
        Ok(Self(settings))
    }
}

#[test]
fn a_drive_with_a_loop_of_another_crate_is_refused_without_it_by_name_and_version() {
    link_own_loops([OwnLoopKind::of::<Plain>()]);
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("plain.mcap");
    let mut scenario = scenario("");
    let own = OwnLoopSection::new("plain".to_owned(), None, None);
    scenario.outer_loop = OuterLoopSection::Own(own);
    simulate_recorded(&scenario, &path).unwrap();
    let told = stderr(&replay(&path, &[]));
    for part in [
        "outer_loop.name is plain",
        "this program has no loop of another crate",
        "use the one that was built with plain 2.0.1",
    ] {
        assert!(told.contains(part), "{told}");
    }
    // What another loop would have commanded can be asked for.
    let [kind, gains] = [
        "outer_loop.kind=proportional",
        "outer_loop.gain_per_s=[2.0, 2.0]",
    ];
    let told = stdout(&replay(&path, &["--set", kind, "--set", gains]));
    assert!(told.contains("recorded and replayed commands"), "{told}");
}

#[test]
fn a_governed_drive_is_replayed_to_the_bit() {
    // Too fast for the tyres, and too tight for the wheels.
    for (radius_m, angular_velocity_rad_s) in [(1.0, 1.9), (0.45, 1.1)] {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("governed.mcap");
        let mut scenario = scenario("[governor]\nenabled = true\n");
        scenario.reference = ReferenceSection::Circle {
            radius_m,
            angular_velocity_rad_s,
            centre_m: [0.0; 2],
            start: Start::Beginning,
        };
        simulate_recorded(&scenario, &path).unwrap();
        let slowed = Reader::open(&path)
            .unwrap()
            .filter(
                |entry| matches!(entry, Ok(Entry::Tick(tick)) if tick.output.slowed_by.is_some()),
            )
            .count();
        assert!(slowed > 100, "{slowed}");
        let told = stdout(&replay(&path, &["--verify"]));
        assert!(told.contains("every output the same to the bit"), "{told}");
    }
}

/// Twice the gain after two seconds, another p after four.
const TUNED: &str = "\
[tuning]
enabled = true
gain_per_s = [0.5, 4.0]
point_distance_m = [0.3, 0.4]

[[tune]]
at_s = 2.0
gain_per_s = [2.0, 2.0]

[[tune]]
at_s = 4.0
point_distance_m = 0.4
";

#[test]
fn a_gain_doubled_in_a_drive_is_recorded_and_replayed_to_the_bit_and_not_without_it() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("tuned.mcap");
    simulate_recorded(&scenario(TUNED), &path).unwrap();
    let ticks: Vec<TickRecord> = Reader::open(&path)
        .unwrap()
        .filter_map(|entry| match entry.unwrap() {
            Entry::Tick(tick) => Some(tick),
            _ => None,
        })
        .collect();
    let is_tuned = |tick: &&TickRecord| {
        let mut events = tick.events.iter();
        events.any(|event| matches!(event, Event::Tuning(_)))
    };
    let tuned: Vec<&TickRecord> = ticks.iter().filter(is_tuned).collect();
    let [gain, distance] = tuned[..] else {
        panic!("{} tunings", tuned.len());
    };
    let drive_time = gain.output.drive_time.unwrap();
    assert!((drive_time - 2.0).abs() < 0.011, "{drive_time}");
    let twice = singletrack_control::Velocity::new(2.0, 2.0);
    assert_eq!(gain.output.tuned.unwrap().gain, Some(twice));
    // p moves on with its rate from its tick on, and so does P.
    let slewed = &ticks[usize::try_from(distance.index).unwrap() - 1..];
    for pair in slewed.windows(2).take(150) {
        let [was, is] = [0, 1].map(|index| pair[index].output.tuned.unwrap().point_distance);
        assert!((0.0..=0.000_500_1).contains(&(is - was)), "{was} to {is}");
    }
    assert_eq!(slewed[100].output.tuned.unwrap().point_distance, 0.4);

    let told = stdout(&replay(&path, &["--verify"]));
    assert!(told.contains("every output the same to the bit"), "{told}");

    let to = folder.path().join("untuned.mcap");
    let untuned = changed(&path, &to, &mut |mut entry| {
        if let Entry::Tick(tick) = &mut entry {
            tick.events
                .retain(|event| !matches!(event, Event::Tuning(_)));
        }
        Some(entry)
    });
    let told = stderr(&replay(&untuned, &["--verify"]));
    assert!(told.contains("into the record, differs"), "{told}");
    let first = format!("tick {}, ", gain.index);
    assert!(
        told.contains(&first) && told.contains("point_velocity"),
        "{told}"
    );
}

#[test]
fn tuning_that_is_enabled_and_not_used_changes_no_command() {
    let folder = tempfile::tempdir().unwrap();
    let commands = |name: &str, text: &str| -> Vec<_> {
        let path = folder.path().join(name);
        simulate_recorded(&scenario(text), &path).unwrap();
        Reader::open(&path)
            .unwrap()
            .filter_map(|entry| match entry.unwrap() {
                Entry::Tick(tick) => Some((tick.output.command, tick.output.point)),
                _ => None,
            })
            .collect()
    };
    let enabled = TUNED.split("[[tune]]").next().unwrap();
    assert_eq!(commands("off.mcap", ""), commands("on.mcap", enabled));
}

#[test]
fn a_drive_with_losses_is_replayed_to_the_bit() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("losses.mcap");
    let losses = "[[marker_loss]]\nfirst_tick = 200\nticks = 20\n\
                  [[marker_loss]]\nfirst_tick = 500\nticks = 45\n";
    simulate_recorded(&scenario(losses), &path).unwrap();
    let held = Reader::open(&path)
        .unwrap()
        .filter(|entry| matches!(entry, Ok(Entry::Tick(tick)) if tick.output.held && tick.output.drive_time.is_some()))
        .count();
    assert!(held >= 65, "{held}");
    stdout(&replay(&path, &[]));
}

#[test]
fn an_unfinished_record_is_replayed_as_far_as_it_goes() {
    let folder = tempfile::tempdir().unwrap();
    let path = circle(&folder);
    let bytes = std::fs::read(&path).unwrap();
    let cut = part_path(&folder.path().join("cut.mcap"));
    std::fs::write(&cut, &bytes[..bytes.len() * 6 / 10]).unwrap();
    let output = replay(&cut, &[]);
    let told = stdout(&output);
    assert!(told.contains("every output the same"), "{told}");
    let note = String::from_utf8_lossy(&output.stderr);
    assert!(note.contains("unfinished"), "{note}");
}

#[test]
fn a_record_that_has_not_got_its_name_yet_is_found() {
    let folder = tempfile::tempdir().unwrap();
    let path = circle(&folder);
    std::fs::rename(&path, part_path(&path)).unwrap();
    stdout(&replay(&path, &[]));
}

#[test]
fn a_difference_tells_if_another_version_made_the_record() {
    let folder = tempfile::tempdir().unwrap();
    let (path, _folder) = tick_changed(&circle(&folder), 700, |tick| {
        flip(&mut tick.output.actuation.steering);
    });
    assert!(!stderr(&replay(&path, &[])).contains("made by"));
    let reader = Reader::open(&path).unwrap();
    let mut meta = reader.meta.clone();
    let version = String::from("0.0.7");
    meta.software.insert("singletrackd".to_owned(), version);
    let old = folder.path().join("old.mcap");
    let mut recorder = Recorder::create(&old, &meta).unwrap();
    for entry in reader {
        recorder.write(&entry.unwrap()).unwrap();
    }
    recorder.finish().unwrap();
    let told = stderr(&replay(&old, &[]));
    assert!(told.contains("made by singletrackd 0.0.7"), "{told}");
}

#[test]
fn one_bit_of_an_input_is_found_and_shown_with_all_inputs() {
    type Change = fn(&mut TickRecord);
    let changes: [(&str, Change); 5] = [
        ("a pose's x", |tick| {
            let pose = tick.events.iter_mut().find_map(|event| match event {
                Event::Pose(pose) => Some(pose),
                _ => None,
            });
            flip(&mut pose.unwrap().position.x);
        }),
        ("a pose's yaw", |tick| {
            let pose = tick.events.iter_mut().find_map(|event| match event {
                Event::Pose(pose) => Some(pose),
                _ => None,
            });
            flip(&mut pose.unwrap().yaw);
        }),
        ("a yaw rate", |tick| {
            let sample = tick.events.iter_mut().find_map(|event| match event {
                Event::Board(board) => board.inertial.as_mut(),
                _ => None,
            });
            flip(&mut sample.unwrap().yaw_rate);
        }),
        ("the time", |tick| tick.pilot_time.0 ^= 1),
        ("an event's being there", |tick| {
            let place = tick
                .events
                .iter()
                .position(|event| matches!(event, Event::Pose(_)));
            tick.events.remove(place.unwrap());
        }),
    ];
    let folder = tempfile::tempdir().unwrap();
    let path = circle(&folder);
    for (name, change) in changes {
        let (path, _folder) = tick_changed(&path, 740, change);
        let told = stderr(&replay(&path, &["--verify"]));
        // One bit of an input may show only after some tenths of a second.
        assert!(told.contains("into the record, differs"), "{name}: {told}");
        assert!(told.contains("recorded "), "{name}: {told}");
        assert!(told.contains("The pilot was told, at "), "{name}: {told}");
        assert!(
            told.contains(r#"{"topic":"tick","tick":7"#),
            "{name}: {told}"
        );
    }
}

#[test]
fn one_bit_of_an_output_is_found_at_its_field() {
    let folder = tempfile::tempdir().unwrap();
    let (path, _folder) = tick_changed(&circle(&folder), 700, |tick| {
        flip(&mut tick.output.actuation.steering);
    });
    let told = stderr(&replay(&path, &[]));
    assert!(told.contains("tick 700, "), "{told}");
    assert!(told.contains("actuation.steering_rad: recorded "), "{told}");
}

#[test]
fn a_tick_that_is_missing_ends_a_replay_by_name() {
    let folder = tempfile::tempdir().unwrap();
    let to = folder.path().join("gap.mcap");
    let path = changed(&circle(&folder), &to, &mut |entry| match &entry {
        Entry::Tick(tick) if (500..510).contains(&tick.index) => None,
        _ => Some(entry),
    });
    let told = stderr(&replay(&path, &[]));
    assert!(
        told.contains("ticks 500 to 509 are not in the record"),
        "{told}"
    );
    assert!(
        told.contains("500 ticks before that are the same"),
        "{told}"
    );
}

/// From waypoints to others, while the car stands.
fn reconfigured(path: &Path, tell: bool) {
    let reference = |x_m: f64| ReferenceSection::WaypointList {
        waypoints: vec![
            WaypointSection {
                t_s: 0.0,
                x_m: 0.6,
                y_m: 0.0,
            },
            WaypointSection {
                t_s: 4.0,
                x_m,
                y_m: 0.4,
            },
        ],
    };
    let mut config: Config = daemon_config(Drive::following(reference(1.5)));
    let mut drive = VirtualDrive::new(config.clone(), 1, SimulationConfig::default()).unwrap();
    let mut record = VirtualRecord::start(Some(path), &mut drive, &config, 1).unwrap();
    config.reference = reference(2.0);
    for _ in 0..100 {
        drive.step();
    }
    assert_eq!(drive.reconfigure(config).unwrap(), 2);
    drive.start().unwrap();
    for _ in 0..300 {
        drive.step();
    }
    for entry in drive.entries() {
        if tell || !matches!(entry, Entry::Configuration(_)) {
            record.entry(&entry).unwrap();
        }
    }
    record.finish(&mut drive).unwrap();
}

#[test]
fn a_configuration_that_came_into_force_later_is_replayed_too() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("reconfigured.mcap");
    reconfigured(&path, true);
    stdout(&replay(&path, &[]));
}

#[test]
fn a_configuration_that_is_not_in_the_record_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("reconfigured.mcap");
    reconfigured(&path, false);
    let told = stderr(&replay(&path, &[]));
    assert!(
        told.contains("configuration 2 came into force, and is not in the record"),
        "{told}"
    );
}

#[test]
fn another_configuration_deviates_and_is_drawn() {
    let folder = tempfile::tempdir().unwrap();
    let path = circle(&folder);
    let told = stdout(&replay(&path, &["--set", "law.point_distance_m=0.4"]));
    let row = |name: &str| {
        let row = told.lines().find(|line| line.starts_with(name)).unwrap();
        row.split_whitespace()
            .map(str::to_owned)
            .collect::<Vec<_>>()
    };
    let rms: f64 = row("steering ")[2].parse().unwrap();
    assert!((0.01..0.2).contains(&rms), "{told}");
    // The estimate does not know of P; of the steering that is sent now, which the car of the record
    // did not have, it finds out that it is wrong.
    let largest: f64 = row("estimate yaw rate")[4].parse().unwrap();
    assert!((0.001..0.02).contains(&largest.abs()), "{told}");
    let figure = std::fs::read_to_string(folder.path().join("circle.replay.svg")).unwrap();
    assert!(figure.starts_with("<svg") && figure.contains("replayed"));
}

#[test]
fn the_same_configuration_set_again_deviates_in_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let path = circle(&folder);
    let figure = folder.path().join("other.svg");
    let told = stdout(&replay(
        &path,
        &[
            "--set",
            "law.point_distance_m=0.35",
            "--figure",
            figure.to_str().unwrap(),
        ],
    ));
    assert!(
        told.contains("the mode is the same in every tick"),
        "{told}"
    );
    for line in told
        .lines()
        .filter(|line| line.contains(" rad ") || line.contains(" m/s "))
    {
        assert_eq!(
            line.split_whitespace().rev().nth(2),
            Some("0.000000"),
            "{line}"
        );
    }
    assert!(figure.exists());
}

#[test]
fn a_key_that_can_not_be_set_is_reported_with_its_value() {
    let folder = tempfile::tempdir().unwrap();
    let path = circle(&folder);
    for (set, parts) in [
        (
            "law.point_distance_mm=0.4",
            ["point_distance_mm", "did you mean point_distance_m?"],
        ),
        (
            "law.point_distance_m=-1",
            ["law.point_distance_m is -1", "above zero"],
        ),
        ("law.point_distance_m=far", ["law.point_distance_m", "far"]),
        ("law", ["KEY=VALUE", "law"]),
        (
            "serial.port=/dev/null",
            ["serial.port", "the pilot reads nothing of that"],
        ),
    ] {
        let told = stderr(&replay(&path, &["--set", set]));
        for part in parts {
            assert!(told.contains(part), "{set}: {told}");
        }
    }
}

#[test]
fn a_reader_that_goes_away_is_no_failure() {
    let folder = tempfile::tempdir().unwrap();
    let path = circle(&folder);
    let mut child = Command::new(env!("CARGO_BIN_EXE_singletrack"))
        .arg("replay")
        .arg(&path)
        .args(["--set", "law.point_distance_m=0.4"])
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    drop(child.stdout.take());
    assert!(child.wait().unwrap().success());
    assert!(folder.path().join("circle.replay.svg").exists());
}

#[test]
fn a_file_that_is_not_a_record_is_reported() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("drive.mcap");
    std::fs::write(&path, "no record").unwrap();
    let told = stderr(&replay(&path, &[]));
    assert!(told.contains("drive.mcap"), "{told}");
    let told = stderr(&replay(&folder.path().join("none.mcap"), &[]));
    assert!(told.contains("none.mcap"), "{told}");
}
