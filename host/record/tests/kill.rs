//! A recorder that is killed at any moment loses at most the last second.
//!
//! The test starts itself as the process to kill.

#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    reason = "a test may fail"
)]

#[path = "common/drive.rs"]
mod drive;

use std::{
    env,
    io::{self, Read, Write},
    ops::Range,
    path::{Path, PathBuf},
    process::{Child, Command, Stdio},
    thread,
    time::{Duration, Instant},
};

use libtest_mimic::{Arguments, Trial};
use singletrack_record::{
    Ending, Entry, Reader, RecordError, Recorder, RecorderThread, feed, part_path, recover,
};

/// The argument with which the program is the process to kill.
const RECORD: &str = "record-until-killed";
const KILLS: u64 = 50;
/// Recorders at a time: few, so that the disk does not limit them.
const WAVE: u64 = 25;
const PERIOD: Duration = Duration::from_millis(10);
/// The first and the last moment to kill.
const FROM: Duration = Duration::from_millis(300);
const UNTIL: Duration = Duration::from_millis(2_800);
const SECOND_NS: u64 = 1_000_000_000;

fn main() {
    let mut arguments = env::args_os().skip(1);
    if arguments.next().is_some_and(|argument| argument == RECORD) {
        record(Path::new(&arguments.next().expect("a path")));
    }
    let test = Trial::test(
        "a_recorder_killed_at_any_moment_loses_a_second_at_most",
        || {
            a_recorder_killed_at_any_moment_loses_a_second_at_most();
            Ok(())
        },
    );
    libtest_mimic::run(&Arguments::from_args(), vec![test]).exit();
}

/// Records in real time, and prints the time of every tick that was pushed.
fn record(path: &Path) -> ! {
    let (mut input, output) = feed(1_024);
    let recorder = Recorder::create(path, &drive::meta()).unwrap();
    let _thread = RecorderThread::start(recorder, output, |_| {}).unwrap();
    let start = Instant::now();
    let mut output = io::stdout().lock();
    for index in 0.. {
        let time_ns = start.elapsed().as_nanos() as u64;
        for entry in [
            Entry::Pose(drive::pose(index, time_ns)),
            Entry::Telemetry(drive::telemetry(index, time_ns)),
            Entry::Tick(drive::tick(index, time_ns)),
        ] {
            assert!(input.push(entry), "the writer does not keep up");
        }
        // The ring holds three seconds. A pipe without a reader holds more.
        output.write_all(&time_ns.to_le_bytes()).unwrap();
        output.flush().unwrap();
        thread::sleep(PERIOD);
    }
    unreachable!("a lifetime of ticks")
}

struct Victim {
    process: Child,
    path: PathBuf,
    moment: Duration,
}

fn a_recorder_killed_at_any_moment_loses_a_second_at_most() {
    let mut saved = 0;
    let mut worst_ns = 0;
    for first in (0..KILLS).step_by(WAVE as usize) {
        for (ticks, lost_ns) in kill(first..first + WAVE) {
            saved += ticks;
            worst_ns = worst_ns.max(lost_ns);
        }
    }
    println!(
        "{KILLS} kills, {saved} ticks saved, at most {} ms lost",
        worst_ns / 1_000_000
    );
    assert!(saved > 0, "no victim lived long enough");
    assert!(
        worst_ns <= SECOND_NS,
        "{worst_ns} ns are more than a second"
    );
}

/// Starts recorders and kills each at its own moment; returns what each saved and lost.
fn kill(numbers: Range<u64>) -> Vec<(u64, u64)> {
    let folder = tempfile::tempdir().unwrap();
    let start = Instant::now();
    let mut victims: Vec<_> = numbers
        .map(|index| {
            let path = folder.path().join(format!("{index}.mcap"));
            let process = Command::new(env::current_exe().unwrap())
                .arg(RECORD)
                .arg(&path)
                .stdin(Stdio::null())
                .stdout(Stdio::piped())
                .spawn()
                .unwrap();
            let moment = FROM + (UNTIL - FROM).mul_f64(drive::noise(index, 0) + 0.5);
            Victim {
                process,
                path,
                moment,
            }
        })
        .collect();
    victims.sort_by_key(|victim| victim.moment);
    for victim in &mut victims {
        thread::sleep(victim.moment.saturating_sub(start.elapsed()));
        victim.process.kill().unwrap();
    }
    victims
        .into_iter()
        .map(|mut victim| {
            let mut times = Vec::new();
            let mut pipe = victim.process.stdout.take().unwrap();
            pipe.read_to_end(&mut times).unwrap();
            let status = victim.process.wait().unwrap();
            assert_eq!(status.code(), None, "killed, and not before");
            let pushed: Vec<_> = times
                .chunks_exact(8)
                .map(|time| u64::from_le_bytes(time.try_into().unwrap()))
                .collect();
            saved_and_lost(&victim.path, &pushed)
        })
        .collect()
}

/// The number of ticks that a killed process left, and the time at its end without any.
fn saved_and_lost(path: &Path, pushed: &[u64]) -> (u64, u64) {
    let last_pushed = pushed.last().copied().unwrap_or(0);
    match recover(&part_path(path), path, |_, _| {}) {
        Ok(_) => {}
        Err(RecordError::Empty { .. }) => return (0, last_pushed),
        // Killed before its first tick.
        Err(error) => {
            assert!(pushed.is_empty(), "{error}");
            return (0, 0);
        }
    }
    let mut reader = Reader::open(path).unwrap();
    let (mut ticks, mut last_read) = (0, 0);
    for entry in reader.by_ref() {
        if let Entry::Tick(tick) = entry.unwrap() {
            assert_eq!(tick, drive::tick(ticks, tick.start_ns));
            last_read = tick.start_ns;
            ticks += 1;
        }
    }
    assert_eq!(reader.ending, Some(Ending::Finished));
    (ticks, last_pushed.saturating_sub(last_read))
}
