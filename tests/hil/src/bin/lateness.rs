//! Lateness of the shipped daemon's ticks relative to the machine's own: while the
//! daemon drives the simulated car, rounds of its figures and of cyclictest
//! (Debian: rt-tests) alternate, with one processor loaded. The ratios count, not
//! the times.
//!
//! ```sh
//! cargo run --release -p singletrack-hil --bin lateness -- --rounds 4 --seconds 30
//! ```

use std::{
    process::{Child, Command, ExitCode, Stdio},
    time::{Duration, Instant},
};

use clap::Parser;
use singletrack_control::statistics::Distribution;
use singletrack_hil::{
    Failure, Measurements, Outcome,
    bench::{Bench, Equipment},
    daemon, ensure,
};
use singletrack_sim::BoardKind;

/// Compare the lateness of the shipped daemon's ticks with cyclictest.
#[derive(Debug, Parser)]
#[command(disable_version_flag = true)]
struct Options {
    /// Number of rounds of each
    #[arg(long, value_name = "N", default_value_t = 4)]
    rounds: u32,

    /// Duration of a round
    #[arg(long, value_name = "S", default_value_t = 30)]
    seconds: u64,

    /// Do not load a processor
    #[arg(long)]
    no_load: bool,
}

/// Priority of the daemon and of cyclictest.
const PRIORITY: &str = "40";
/// Period of both, in us.
const PERIOD_US: &str = "10000";
/// Buckets of cyclictest's histogram, of 1 us.
const BUCKETS: &str = "100000";

fn main() -> ExitCode {
    match measure(&Options::parse()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => {
            eprintln!("error: {failure}");
            ExitCode::FAILURE
        }
    }
}

fn measure(options: &Options) -> Outcome {
    let equipment = Equipment {
        program: daemon::build()?,
        port: None,
        board: BoardKind::Native,
        whole: false,
        octave: false,
        browser: false,
        kills: 0,
        measurements: Measurements::default(),
    };
    let mut bench = Bench::new("lateness", &equipment, 1)?;
    let _load = match options.no_load {
        true => None,
        false => Some(Load::start()?),
    };
    let (mut ours, mut theirs, mut latency) = (Vec::new(), Vec::new(), Vec::new());
    for round in 1..=options.rounds {
        eprintln!("round {round} of {}: daemon", options.rounds);
        drive(&mut bench, options.seconds, &mut ours, &mut latency)?;
        eprintln!("round {round} of {}: cyclictest", options.rounds);
        // The same load for both.
        bench.start_driving()?;
        theirs.extend(cyclictest(options.seconds)?);
        finish(&mut bench)?;
    }
    println!(
        "{:<28} {:>8} {:>8} {:>8} {:>8} {:>8}",
        "us", "samples", "p50", "p99", "p99.9", "max"
    );
    let rows = [
        ("daemon, lateness", ours),
        ("cyclictest", theirs),
        ("daemon, capture to command", latency),
    ];
    let [ours, theirs, _] = rows.map(|(name, values)| {
        let values = Distribution::of(values);
        let of = [0.5, 0.99, 0.999, 1.0].map(|part| values.quantile(part).unwrap_or(f64::NAN));
        let [p50, p99, p999, max] = of;
        println!(
            "{name:<28} {:>8} {p50:>8.1} {p99:>8.1} {p999:>8.1} {max:>8.1}",
            values.count()
        );
        of
    });
    let ratio = |index: usize| match (ours.get(index), theirs.get(index)) {
        (Some(ours), Some(theirs)) => ours / theirs,
        _ => f64::NAN,
    };
    println!(
        "{:<28} {:>8} {:>8.2} {:>8.2} {:>8.2} {:>8.2}",
        "daemon / cyclictest",
        "",
        ratio(0),
        ratio(1),
        ratio(2),
        ratio(3)
    );
    Ok(())
}

/// Drives for a round, and records the lateness of every tick, in us.
fn drive(
    bench: &mut Bench,
    seconds: u64,
    lateness: &mut Vec<f64>,
    latency: &mut Vec<f64>,
) -> Outcome {
    bench.start_driving()?;
    let mut ticks = bench.client()?.watch_ticks()?;
    let begin = Instant::now();
    while begin.elapsed() < Duration::from_secs(seconds) {
        let [late_ns, held, captured_ns] =
            ticks.next_of(["lateness_ns", "held", "capture_to_command_ns"])?;
        let late_ns = late_ns.ok_or_else(|| Failure::new("a tick without lateness"))?;
        lateness.push(late_ns.max(0.0) * 1e-3);
        // The age of a held pose is not a latency.
        if held != Some(1.0) {
            latency.extend(captured_ns.map(|ns| ns * 1e-3));
        }
    }
    finish(bench)
}

fn finish(bench: &mut Bench) -> Outcome {
    let (status, _) = bench.daemon()?.terminate(Duration::from_secs(3))?;
    ensure!(status.success(), "the daemon ended with {status}");
    bench.wait_until_standing()
}

/// A round of cyclictest: its latencies, in us.
fn cyclictest(seconds: u64) -> Outcome<Vec<f64>> {
    let output = Command::new("cyclictest")
        .args(["--quiet", "--mlockall", "--threads=1"])
        .args(["--priority", PRIORITY, "--interval", PERIOD_US])
        .args(["--histogram", BUCKETS, "--duration"])
        .arg(format!("{seconds}s"))
        .output()
        .map_err(Failure::system("can't run cyclictest (install rt-tests)"))?;
    ensure!(
        output.status.success(),
        "cyclictest: {}",
        String::from_utf8_lossy(&output.stderr)
    );
    let text = String::from_utf8_lossy(&output.stdout);
    let mut values = Vec::new();
    for line in text.lines().filter(|line| !line.starts_with('#')) {
        let mut words = line.split_whitespace();
        if let (Some(Ok(us)), Some(Ok(count))) = (
            words.next().map(str::parse::<u32>),
            words.next().map(str::parse::<usize>),
        ) {
            // cyclictest rounds down.
            values.extend(std::iter::repeat_n(f64::from(us) + 0.5, count));
        }
    }
    ensure!(!values.is_empty(), "cyclictest has measured nothing");
    Ok(values)
}

/// A program that keeps one processor busy. Dropping it ends the program.
struct Load(Child);

impl Load {
    fn start() -> Outcome<Self> {
        Command::new("taskset")
            .args(["--cpu-list", "0", "sh", "-c", "while :; do :; done"])
            .stdin(Stdio::null())
            .spawn()
            .map(Self)
            .map_err(Failure::system("can't load a processor (taskset)"))
    }
}

impl Drop for Load {
    fn drop(&mut self) {
        // It may have ended already.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}
