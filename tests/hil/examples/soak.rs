//! An hour of driving with clients of every kind: memory, files, threads and lateness of the
//! daemon at the end as at the beginning.
//!
//! `cargo run --release -p singletrack-hil --example soak -- --minutes 60`
//!
//! The clients: a reader of ticks and one of states, a program that polls the status, one that
//! connects for each request, one that sends invalid requests, requests to page and live view, and
//! the command `singletrack status`. The operator starts a new drive every few minutes. A line is
//! printed each minute. The example fails if the daemon has grown.

#![allow(clippy::print_stdout, reason = "a program")]

use std::{
    fs,
    io::{Read as _, Write as _},
    net::{SocketAddr, TcpStream},
    path::{Path, PathBuf},
    process::{Command, ExitCode, Stdio},
    sync::atomic::{AtomicBool, AtomicU64, Ordering},
    thread,
    time::{Duration, Instant},
};

use clap::Parser;
use singletrack_hil::{
    Failure, Measurements, Outcome,
    bench::{Bench, Equipment},
    client::Client,
    daemon, ensure, percentile, settings,
    viewer::Viewer,
};
use singletrack_sim::BoardKind;

/// The time after which the daemon has all the memory that it needs.
const SETTLED_MINUTES: usize = 3;

/// What may be added to the memory after that, in kB: the C library's arenas, the first change of the
/// configuration.
const GROWTH_KB: u64 = 4_096;

/// What the index of the record may add in a minute, in kB.
const INDEX_KB: u64 = 150;

/// Minutes of a drive.
const DRIVE_MINUTES: usize = 4;

#[derive(Debug, Parser)]
struct Options {
    /// Time, in minutes
    #[arg(long, default_value_t = 60)]
    minutes: usize,

    /// Without a record, whose index takes memory: a fiftieth of the file
    #[arg(long)]
    no_record: bool,

    /// Measure this singletrackd instead of building one
    #[arg(long, value_name = "PATH")]
    daemon: Option<PathBuf>,
}

/// What a process has.
#[derive(Clone, Copy, Debug)]
struct Holdings {
    memory_kb: u64,
    files: usize,
    threads: u64,
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
    let equipment = Equipment {
        program: options.daemon.map_or_else(daemon::build, Ok)?,
        port: None,
        board: BoardKind::Native,
        kills: 0,
        whole: false,
        octave: false,
        browser: false,
        measurements: Measurements::default(),
    };
    let mut bench = Bench::new("soak", &equipment, 1)?;
    bench.config_mut().record.enabled = !options.no_record;
    bench.start_driving()?;
    let viewers = [
        Viewer::start("page", &bench)?,
        Viewer::start("live", &bench)?,
    ];
    let addresses = viewers.each_ref().map(Viewer::address);
    let socket = settings::socket(bench.folder());
    let program = bench.program().with_file_name("singletrack");
    let (ends, answers) = (AtomicBool::new(false), AtomicU64::new(0));
    let clients: [&(dyn Fn() -> Outcome + Sync); 6] = [
        &|| read_states(&socket, &ends, &answers),
        &|| poll(&socket, &ends, &answers),
        &|| connect_anew(&socket, &ends, &answers),
        &|| send_rubbish(&socket, &ends, &answers),
        &|| ask_pages(&addresses, &ends, &answers),
        &|| run_status(&program, &socket, &ends, &answers),
    ];
    let outcome = thread::scope(|scope| {
        let clients = clients.map(|client| {
            let ends = &ends;
            scope.spawn(move || {
                let outcome = client();
                // The end of one is that of all.
                ends.store(true, Ordering::Relaxed);
                outcome
            })
        });
        let watched = watch(
            &mut bench,
            options.minutes,
            options.no_record,
            &ends,
            &answers,
        );
        ends.store(true, Ordering::Relaxed);
        for client in clients {
            let joined = client.join();
            joined.map_err(|_| Failure::new("a client panicked"))??;
        }
        watched
    });
    drop(viewers);
    outcome
}

/// Drives, and prints what the daemon has.
fn watch(
    bench: &mut Bench,
    minutes: usize,
    no_record: bool,
    ends: &AtomicBool,
    answers: &AtomicU64,
) -> Outcome {
    println!("minute  memory_kB  files  threads  late_p50_us  p99_us  largest_us  answers");
    let mut settled = None;
    let mut last = None;
    for minute in 1..=minutes {
        if minute.is_multiple_of(DRIVE_MINUTES) {
            bench.client()?.disarm()?.accepted()?;
            bench.wait_until_standing()?;
            bench.wait_until_ready()?;
            bench.client()?.reload()?.accepted()?;
            bench.wait_until_ready()?;
            bench.arm_and_drive()?;
        }
        let late_us = lateness(bench)?;
        ensure!(!ends.load(Ordering::Relaxed), "a client has ended");
        let holdings = holdings(bench.daemon()?.id())?;
        let [half, most, largest] = [0.5, 0.99, 1.0].map(|part| percentile(&late_us, part));
        println!(
            "{minute:6} {:10} {:6} {:8} {half:12.0} {most:7.0} {largest:11.0} {:8}",
            holdings.memory_kb,
            holdings.files,
            holdings.threads,
            answers.load(Ordering::Relaxed)
        );
        if minute == SETTLED_MINUTES {
            settled = Some((holdings, most));
        }
        last = Some((holdings, most));
    }
    let (Some((before, late_before)), Some((after, late_after))) = (settled, last) else {
        return Ok(());
    };
    let index_kb = if no_record {
        0
    } else {
        INDEX_KB * minutes as u64
    };
    ensure!(
        after.memory_kb <= before.memory_kb + GROWTH_KB + index_kb,
        "the memory grew: {before:?} to {after:?}"
    );
    // A connection may just be opened.
    ensure!(
        after.files <= before.files + 3 && after.threads <= before.threads,
        "files or threads are left: {before:?} to {after:?}"
    );
    println!(
        "lateness at 99 %: {late_before:.0} us at the beginning, {late_after:.0} us at the end"
    );
    Ok(())
}

/// The lateness of a minute's ticks, in us.
fn lateness(bench: &mut Bench) -> Outcome<Vec<f64>> {
    let mut ticks = bench.client()?.watch_ticks()?;
    let end = Instant::now() + Duration::from_secs(60);
    let mut late_us = Vec::new();
    while Instant::now() < end {
        late_us.push(1e-3 * ticks.next("lateness_ns")?);
    }
    late_us.sort_by(f64::total_cmp);
    Ok(late_us)
}

fn holdings(id: u32) -> Outcome<Holdings> {
    let folder = PathBuf::from(format!("/proc/{id}"));
    let status = fs::read_to_string(folder.join("status"))
        .map_err(Failure::system("no status of the daemon"))?;
    let number = |name: &str| {
        let line = status.lines().find_map(|line| line.strip_prefix(name));
        let word = line.and_then(|line| line.split_whitespace().next());
        word.and_then(|word| word.parse().ok())
            .ok_or_else(|| Failure::new(format!("no {name} in the daemon's status")))
    };
    let files = fs::read_dir(folder.join("fd")).map_err(Failure::system("no files"))?;
    Ok(Holdings {
        memory_kb: number("VmRSS:")?,
        files: files.count(),
        threads: number("Threads:")?,
    })
}

fn read_states(socket: &Path, ends: &AtomicBool, answers: &AtomicU64) -> Outcome {
    let mut client = Client::connect(socket)?;
    client.watch_states()?;
    while !ends.load(Ordering::Relaxed) {
        client.line()?;
        answers.fetch_add(1, Ordering::Relaxed);
    }
    Ok(())
}

fn poll(socket: &Path, ends: &AtomicBool, answers: &AtomicU64) -> Outcome {
    let mut client = Client::connect(socket)?;
    while !ends.load(Ordering::Relaxed) {
        client.status()?;
        answers.fetch_add(1, Ordering::Relaxed);
        thread::sleep(Duration::from_millis(20));
    }
    Ok(())
}

fn connect_anew(socket: &Path, ends: &AtomicBool, answers: &AtomicU64) -> Outcome {
    while !ends.load(Ordering::Relaxed) {
        Client::connect(socket)?.status()?;
        answers.fetch_add(1, Ordering::Relaxed);
        thread::sleep(Duration::from_millis(50));
    }
    Ok(())
}

fn send_rubbish(socket: &Path, ends: &AtomicBool, answers: &AtomicU64) -> Outcome {
    let lines = [
        "nothing\n",
        "{\"version\":3,\"command\":\"tune\",\"gain_per_s\":4.0}\n",
        "{\"version\":3,\"command\":\"arm\"}\n",
        "{\"version\":1,\"command\":\"status\"}\n",
    ];
    for line in lines.iter().cycle() {
        if ends.load(Ordering::Relaxed) {
            break;
        }
        let mut client = Client::connect(socket)?;
        client.send_lines(line)?;
        client.line()?;
        answers.fetch_add(1, Ordering::Relaxed);
        thread::sleep(Duration::from_millis(100));
    }
    Ok(())
}

fn ask_pages(addresses: &[SocketAddr; 2], ends: &AtomicBool, answers: &AtomicU64) -> Outcome {
    while !ends.load(Ordering::Relaxed) {
        for address in addresses {
            let ask = || -> std::io::Result<usize> {
                let mut stream = TcpStream::connect(address)?;
                stream.set_read_timeout(Some(Duration::from_secs(5)))?;
                stream
                    .write_all(b"GET / HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n")?;
                stream.read(&mut [0; 4_096])
            };
            ask().map_err(Failure::system("page or live view do not answer"))?;
            answers.fetch_add(1, Ordering::Relaxed);
        }
        thread::sleep(Duration::from_millis(500));
    }
    Ok(())
}

fn run_status(program: &Path, socket: &Path, ends: &AtomicBool, answers: &AtomicU64) -> Outcome {
    while !ends.load(Ordering::Relaxed) {
        let status = Command::new(program)
            .args(["status", "--socket"])
            .arg(socket)
            .stdout(Stdio::null())
            .status()
            .map_err(Failure::system("can't run singletrack status"))?;
        ensure!(status.success(), "singletrack status failed: {status}");
        answers.fetch_add(1, Ordering::Relaxed);
        thread::sleep(Duration::from_secs(2));
    }
    Ok(())
}
