//! What the control socket costs in real time: from a new pose to a foreign controller's command,
//! beside the daemon's own law; and readers of the state, some of which read nothing.
//!
//! `cargo run --release -p singletrack-hil --example socket_figures`

#![allow(clippy::print_stdout, reason = "a program")]

use std::{
    collections::HashMap,
    fs,
    path::PathBuf,
    process::ExitCode,
    sync::{
        Arc, Mutex, PoisonError,
        atomic::{AtomicBool, Ordering},
    },
    thread,
    time::{Duration, Instant},
};

use clap::Parser;
use serde_json::json;
use singletrack_core::config::ReferenceSection;
use singletrack_hil::{
    Failure, Measurements, Outcome,
    bench::{Bench, Equipment},
    client::Client,
    controller::{Holder, State},
    daemon, ensure, percentile,
};
use singletrack_sim::BoardKind;

/// Readers of the state, and how many of them read nothing.
const READERS: usize = 10;
const STOPPED: usize = 2;

/// Clock ticks a second of `/proc`, on every Linux.
const CLOCK_TICKS: f64 = 100.0;

/// Measure the control socket of the shipped daemon, with the simulator in real time.
#[derive(Debug, Parser)]
struct Options {
    /// Time of each of the four measurements, in s
    #[arg(long, default_value_t = 15)]
    seconds: u64,

    /// Measure this singletrackd instead of building one
    #[arg(long, value_name = "PATH")]
    daemon: Option<PathBuf>,

    /// Board to simulate
    #[arg(long, value_name = "native|uno", default_value_t = BoardKind::Native)]
    board: BoardKind,
}

fn main() -> ExitCode {
    match run(Options::parse()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => {
            eprintln!("error: {failure}");
            ExitCode::FAILURE
        }
    }
}

fn run(options: Options) -> Outcome {
    let time = Duration::from_secs(options.seconds);
    let equipment = Equipment {
        program: options.daemon.map_or_else(daemon::build, Ok)?,
        port: None,
        board: options.board,
        kills: 0,
        whole: false,
        octave: false,
        browser: false,
        measurements: Measurements::default(),
    };
    let mut bench = Bench::new("own law", &equipment, 1)?;
    own_law(&mut bench, time)?;
    readers(&mut bench, time)?;
    drop(bench);
    let mut bench = Bench::new("foreign controller", &equipment, 1)?;
    foreign(&mut bench, time)
}

/// The circle, by the daemon's own law.
fn own_law(bench: &mut Bench, time: Duration) -> Outcome {
    bench.start_driving()?;
    bench.keep_driving(time)?;
    let status = bench.status()?;
    let ms = |part: &str| -> Outcome<f64> {
        Ok(status.figure(&format!("/capture_to_command_us/{part}"))? * 1e-3)
    };
    println!(
        "from a pose to the command of the daemon's own law: p50 {:.1} ms, p99 {:.1} ms",
        ms("p50")?,
        ms("p99")?
    );
    Ok(())
}

/// A controller outside: it answers each state that has a new pose.
fn foreign(bench: &mut Bench, time: Duration) -> Outcome {
    bench.config_mut().reference = ReferenceSection::External {
        setpoint_timeout_ms: 200,
    };
    bench.start_daemon()?;
    let commands = commands(bench.client()?)?;
    let (mut states, mut sender) = (bench.client()?, bench.client()?);
    states.watch_states()?;
    let mut captures = Vec::new();
    let mut holder = None;
    let mut since = None;
    loop {
        let Some(state) = State::of(&states.line()?) else {
            continue;
        };
        let sequence = captures.len() as u64;
        sender.setpoint(&json!({
            "steering_rad": 0.25, "speed_m_s": 0.5, "sequence": sequence,
            "time_ns": singletrackd::monotonic_ns(),
        }))?;
        let capture_ns = state.time_ns as f64 - state.pose_age_s * 1e9;
        captures.push((!state.is_held && state.mode == "driving").then_some(capture_ns));
        match (state.mode.as_str(), since) {
            ("ready", None) if holder.is_none() => holder = Some(Holder::arm(bench.client()?)?),
            ("driving", None) => since = Some(Instant::now()),
            ("driving", Some(begun)) if begun.elapsed() > time => break,
            ("driving", _) | (_, None) => {}
            (mode, Some(_)) => {
                return Err(Failure::new(format!("{mode} because of {}", state.reason)));
            }
        }
    }
    drop(holder);
    let commands = commands.lock().unwrap_or_else(PoisonError::into_inner);
    let mut ms: Vec<f64> = (0..)
        .zip(&captures)
        .filter_map(|(sequence, capture_ns)| {
            let command_ns = *commands.get(&sequence)?;
            Some((command_ns - (*capture_ns)?) * 1e-6)
        })
        .collect();
    ms.sort_by(f64::total_cmp);
    println!(
        "from a pose to the command that obeys a client's answer: p50 {:.1} ms, p99 {:.1} ms ({} of \
         {} answers were obeyed)",
        percentile(&ms, 0.5),
        percentile(&ms, 0.99),
        ms.len(),
        captures.iter().flatten().count()
    );
    Ok(())
}

/// When the first command left that obeyed each set-point, by its number.
fn commands(mut client: Client) -> Outcome<Arc<Mutex<HashMap<u64, f64>>>> {
    client.send_lines("{\"version\":3,\"command\":\"watch\",\"topics\":[\"tick\"]}\n")?;
    ensure!(client.line()?["ok"] == true, "no ticks");
    let commands = Arc::new(Mutex::new(HashMap::new()));
    let collected = Arc::clone(&commands);
    thread::spawn(move || {
        while let Ok(tick) = client.line() {
            let sequence = tick["setpoint"]["sequence"].as_u64();
            let written = &tick["drive"];
            let time_ns = written["time_ns"]
                .as_f64()
                .filter(|_| written["written"] == true);
            if let (Some(sequence), Some(time_ns)) = (sequence, time_ns) {
                let mut commands = collected.lock().unwrap_or_else(PoisonError::into_inner);
                commands.entry(sequence).or_insert(time_ns);
            }
        }
    });
    Ok(commands)
}

/// The daemon's share of a processor and its memory, without and with readers of the state.
fn readers(bench: &mut Bench, time: Duration) -> Outcome {
    let id = bench.daemon()?.id();
    let alone = Usage::of(id, time)?;
    let over = Arc::new(AtomicBool::new(false));
    let mut stopped = Vec::new();
    let mut reading = Vec::new();
    for number in 0..READERS {
        let mut client = bench.client()?;
        client.watch_states()?;
        if number < STOPPED {
            stopped.push(client);
            continue;
        }
        let over = Arc::clone(&over);
        reading.push(thread::spawn(move || -> Outcome<u64> {
            let mut missed = 0;
            while !over.load(Ordering::Relaxed) {
                missed += client.line()?["missed"].as_u64().unwrap_or(0);
            }
            Ok(missed)
        }));
    }
    let with = Usage::of(id, time)?;
    over.store(true, Ordering::Relaxed);
    let mut missed = 0;
    for reader in reading {
        missed += reader
            .join()
            .map_err(|_| Failure::new("a reader has panicked"))??;
    }
    let late = bench.status()?.figure("/deadline_misses")?;
    println!(
        "the daemon alone: {:.1} % of a processor, {} kB of memory\n\
         with {READERS} readers of the state, {STOPPED} of them stopped: {:.1} %, {} kB; the others \
         missed {missed} states, and {late} ticks were missed since the start",
        alone.percent, alone.memory_kb, with.percent, with.memory_kb
    );
    Ok(())
}

struct Usage {
    percent: f64,
    memory_kb: u64,
}

impl Usage {
    fn of(id: u32, time: Duration) -> Outcome<Self> {
        let (begun, before) = (Instant::now(), processor_time_s(id)?);
        thread::sleep(time);
        let used = processor_time_s(id)? - before;
        Ok(Self {
            percent: 100.0 * used / begun.elapsed().as_secs_f64(),
            memory_kb: memory_kb(id)?,
        })
    }
}

/// User and system time of all threads of a process.
fn processor_time_s(id: u32) -> Outcome<f64> {
    let text = read(&format!("/proc/{id}/stat"))?;
    // The name may have spaces; times are the 14th and the 15th field.
    let fields = text.rsplit(')').next().unwrap_or_default();
    let times = fields.split_whitespace().skip(11).take(2);
    Ok(times
        .filter_map(|time| time.parse::<f64>().ok())
        .sum::<f64>()
        / CLOCK_TICKS)
}

fn memory_kb(id: u32) -> Outcome<u64> {
    let text = read(&format!("/proc/{id}/status"))?;
    text.lines()
        .find_map(|line| {
            line.strip_prefix("VmRSS:")?
                .split_whitespace()
                .next()?
                .parse()
                .ok()
        })
        .ok_or_else(|| Failure::new("no VmRSS"))
}

fn read(path: &str) -> Outcome<String> {
    fs::read_to_string(path).map_err(Failure::system(format!("can't read {path}")))
}
