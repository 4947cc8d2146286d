//! The cost of a record of ten minutes: on the thread that pushes, on the thread that
//! writes, and on the disk.
//!
//! ```text
//! cargo run --release -p singletrack-record --example record_cost [FOLDER]
//! ```
//!
//! 100 ticks a second with all their parts, 100 poses, 100 telemetry records and 5 status
//! records, in virtual time: as fast as the writer allows.

use std::{
    error::Error,
    fs,
    hint::black_box,
    path::PathBuf,
    thread,
    time::{Duration, Instant},
};

use singletrack_record::{Encoder, Entry, Recorder, TickRecord, tick_feed};
use singletrack_statistics::Distribution;

#[path = "../tests/common/drive.rs"]
mod drive;

const SECONDS: u64 = 600;
const RATE: u64 = 100;
const PERIOD_NS: u64 = 10_000_000;
const STATUS_EVERY: u64 = 20;
/// Flushes in a second of virtual time. In real time the recorder flushes by the clock.
const FLUSHES: u64 = 2;
/// Capacity of the ring of the daemon, in ticks.
const RING: usize = 256;

fn main() -> Result<(), Box<dyn Error>> {
    let folder = std::env::args_os().nth(1).map_or_else(
        || std::env::temp_dir().join(format!("record-cost-{}", std::process::id())),
        PathBuf::from,
    );
    fs::create_dir_all(&folder)?;
    println!(
        "a tick is {} bytes in memory, an entry {}",
        size_of::<TickRecord>(),
        size_of::<Entry>()
    );
    println!("\nto hand over, ns           p50      p99    p99.9      max");
    pushes();
    encoder()?;
    println!("\nto write, us               p50      p99    p99.9      max");
    let path = folder.join("cost.mcap");
    let bytes = writer(&path)?;
    let entries = SECONDS * (3 * RATE + RATE / STATUS_EVERY);
    println!(
        "\n{} s: {entries} entries, {:.1} MB, {:.0} bytes an entry",
        SECONDS,
        bytes as f64 / 1e6,
        bytes as f64 / entries as f64
    );
    fs::remove_file(&path)?;
    // Fails, and is ignored, if the folder is not empty.
    let _ = fs::remove_dir(&folder);
    Ok(())
}

/// The cost of a push to a ring that another thread empties: of ticks by the control
/// thread, of entries by the collector.
fn pushes() {
    // The cost of the clock and of other processes.
    measure_pushes("nothing", false, |_| (Instant::now().elapsed(), true));
    for cold in [false, true] {
        let (mut input, mut output) = tick_feed(RING);
        let emptying = thread::spawn(move || {
            while !output.is_abandoned() {
                while let Some(tick) = output.pop() {
                    black_box(&tick);
                }
                thread::sleep(Duration::from_millis(1));
            }
        });
        let name = if cold { "tick, cold caches" } else { "tick" };
        measure_pushes(name, cold, |index| {
            let tick = drive::tick(index, index * PERIOD_NS);
            let start = Instant::now();
            let pushed = input.push(&tick);
            (start.elapsed(), pushed)
        });
        drop(input);
        // The thread ends when the input of the ring is gone.
        let _ = emptying.join();
    }
}

fn measure_pushes(name: &str, cold: bool, mut push: impl FnMut(u64) -> (Duration, bool)) {
    let mut took = Durations::default();
    let mut elsewhere = vec![0_u8; if cold { 4 << 20 } else { 0 }];
    let count = if cold { 10_000 } else { SECONDS * RATE };
    for index in 0..count {
        for byte in elsewhere.iter_mut().step_by(64) {
            *byte = byte.wrapping_add(1);
        }
        let (duration, pushed) = push(index);
        if pushed {
            took.0.push(duration);
        } else {
            thread::sleep(Duration::from_millis(2));
        }
    }
    black_box(&elsewhere);
    took.print(name, 1.0);
}

/// The cost of the messages of an entry.
fn encoder() -> Result<(), Box<dyn Error>> {
    println!("\nto encode, us              p50      p99    p99.9      max");
    let mut encoder = Encoder::new(drive::meta().start);
    let mut took = Durations::default();
    let (mut messages, mut bytes) = (0, 0);
    for index in 0..SECONDS * RATE {
        let time_ns = index * PERIOD_NS;
        let entry = Entry::Tick(drive::tick(index, time_ns));
        let start = Instant::now();
        for publication in encoder.encode(&entry)? {
            messages += 1;
            bytes += publication.bytes.len();
        }
        took.0.push(start.elapsed());
    }
    took.print("tick", 1e3);
    let ticks = (SECONDS * RATE) as f64;
    println!(
        "{:.1} messages, {:.0} bytes a tick",
        f64::from(messages) / ticks,
        bytes as f64 / ticks
    );
    Ok(())
}

/// The cost on the writing thread; returns the length of the file.
fn writer(path: &std::path::Path) -> Result<u64, Box<dyn Error>> {
    let mut recorder = Recorder::create(path, &drive::meta())?;
    let [mut ticks, mut others, mut flushes] = [const { Durations(Vec::new()) }; 3];
    for index in 0..SECONDS * RATE {
        let time_ns = index * PERIOD_NS;
        let mut entries = vec![
            Entry::Pose(drive::pose(index, time_ns)),
            Entry::Telemetry(drive::telemetry(index, time_ns)),
            Entry::Tick(drive::tick(index, time_ns)),
        ];
        if index.is_multiple_of(STATUS_EVERY) {
            entries.push(Entry::Status(drive::status(index, time_ns)));
        }
        for entry in &entries {
            let start = Instant::now();
            recorder.write(entry)?;
            let took = start.elapsed();
            match entry {
                Entry::Tick(_) => ticks.0.push(took),
                _ => others.0.push(took),
            }
        }
        if index.is_multiple_of(RATE / FLUSHES) {
            let start = Instant::now();
            recorder.flush()?;
            flushes.0.push(start.elapsed());
        }
    }
    ticks.print("tick", 1e3);
    others.print("other entry", 1e3);
    flushes.print("flush and sync", 1e3);
    let written = ticks.sum() + others.sum() + flushes.sum();
    let finished = recorder.finish()?;
    println!(
        "{:.1} s in all: {:.2} % of a processor",
        written.as_secs_f64(),
        written.as_secs_f64() / SECONDS as f64 * 100.0
    );
    Ok(finished.bytes)
}

#[derive(Default)]
struct Durations(Vec<Duration>);

impl Durations {
    fn sum(&self) -> Duration {
        self.0.iter().sum()
    }

    fn print(&self, name: &str, unit_ns: f64) {
        let durations = self.0.iter();
        let durations =
            Distribution::of(durations.map(|duration| duration.as_nanos() as f64 / unit_ns));
        let [p50, p99, p999, max] =
            [0.5, 0.99, 0.999, 1.0].map(|part| durations.quantile(part).unwrap_or_default());
        println!("{name:24}{p50:>8.1} {p99:>8.1} {p999:>8.1} {max:>8.1}");
    }
}
