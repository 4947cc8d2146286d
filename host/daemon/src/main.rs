//! `singletrackd`: drives the car.

mod service;
mod signals;

use std::{
    env,
    ffi::OsString,
    io::{self, IsTerminal},
    path::PathBuf,
    process::ExitCode,
};

use clap::{Parser, ValueEnum};
use service::Service;
use signals::Signals;
use singletrack_core::Config;
use singletrackd::{Daemon, StartOptions, Summary, notify::ServiceManager};
use tracing::{error, info, warn};
use tracing_appender::non_blocking::{NonBlockingBuilder, WorkerGuard};
use tracing_subscriber::EnvFilter;

/// Drives the car: motion capture in, commands to the board out, 100 times a
/// second.
///
/// It arms when asked on its control socket, or with --arm. SIGTERM and SIGINT
/// slow the car down, disarm the board and end; a second one disarms at once.
/// SIGHUP reads the configuration anew while the car does not drive; if the terminal
/// that it was started from has been closed, it ends.
#[derive(Debug, Parser)]
#[command(version)]
struct Arguments {
    /// The configuration; singletrackd.example.toml explains every key.
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Arm once, as soon as everything is there. The car moves by itself then.
    #[arg(long)]
    arm: bool,
    /// Say whether the configuration is good, and end.
    #[arg(long)]
    check: bool,
    /// How the log is written, on stderr. `RUST_LOG` filters it.
    #[arg(long, value_enum, value_name = "FORMAT", default_value = "text")]
    log_format: LogFormat,
}

/// How the log is written.
#[derive(Clone, Copy, Debug, ValueEnum)]
enum LogFormat {
    /// For people.
    Text,
    /// One JSON object a line.
    Json,
}

/// The configuration is missing or wrong.
const BAD_CONFIGURATION: u8 = 2;

/// Lines of the log that may wait for their reader.
const LOG_LINES: usize = 4_096;

fn main() -> ExitCode {
    let arguments = Arguments::parse();
    // Before any thread: they inherit it.
    let signals = match Signals::block() {
        Ok(signals) => signals,
        Err(error) => {
            eprintln!("singletrackd: can't block signals: {error}");
            return ExitCode::FAILURE;
        }
    };
    let Some(path) = &arguments.config else {
        eprintln!(
            "singletrackd needs a configuration: singletrackd --config FILE\n\n\
             At least these it can't know: serial.port, motion_capture.server, .rigid_body and .up_axis,\n\
             [law], [outer_loop] and [reference], and the calibration in [board].\n\
             singletrackd.example.toml explains every key."
        );
        return ExitCode::from(BAD_CONFIGURATION);
    };
    let config = match Config::read(path) {
        Ok(config) => config,
        Err(error) => {
            eprintln!("singletrackd: {error}");
            return ExitCode::from(BAD_CONFIGURATION);
        }
    };
    if arguments.check {
        println!("{}: good", path.display());
        return ExitCode::SUCCESS;
    }
    let _log = start_log(arguments.log_format);
    info!(version = env!("CARGO_PKG_VERSION"), config = %path.display(), "singletrackd starts");
    let options = StartOptions {
        arm: arguments.arm,
        lock_memory: true,
        ..StartOptions::default()
    };
    let manager = ServiceManager::from_environment().unwrap_or_else(|error| {
        warn!("the service manager is told nothing: {error}");
        ServiceManager::default()
    });
    match Daemon::start(config, options) {
        Ok(daemon) => Service::new(daemon, path.clone(), manager).run(&signals),
        Err(error) => {
            error!("{error}");
            ExitCode::FAILURE
        }
    }
}

fn tell(summary: &Summary) {
    let figures = &summary.figures;
    info!(
        ticks = figures.ticks,
        driving_ticks = figures.driving_ticks,
        deadline_misses = figures.deadline_misses,
        lateness_p99_us = figures.lateness_us.p99,
        lateness_max_us = figures.lateness_us.max,
        frames = ?figures.frames,
        mocap = ?figures.mocap,
        dropped = ?figures.dropped,
        record = summary.record.as_ref().map(|path| path.display().to_string()),
        "singletrackd ends"
    );
}

/// Starts the log. What it returns writes out what is left when it is dropped.
///
/// A thread that logs never waits for who reads the log, and never notices that
/// nobody does: lines are dropped instead.
fn start_log(format: LogFormat) -> WorkerGuard {
    let (writer, guard) = NonBlockingBuilder::default()
        .lossy(true)
        .buffered_lines_limit(LOG_LINES)
        .finish(io::stderr());
    let (filter, objection) = log_filter(env::var_os(EnvFilter::DEFAULT_ENV));
    let log = tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_ansi(io::stderr().is_terminal())
        .with_writer(writer)
        // There is nowhere to say that the log can't be written.
        .log_internal_errors(false);
    match format {
        LogFormat::Text => log.with_target(false).init(),
        LogFormat::Json => log.json().init(),
    }
    if let Some(objection) = objection {
        warn!("{objection}");
    }
    guard
}

/// The filter that `RUST_LOG` asks for; if it makes no sense, the default and
/// what is wrong.
fn log_filter(asked: Option<OsString>) -> (EnvFilter, Option<String>) {
    let default = || EnvFilter::new("info");
    let Some(asked) = asked.filter(|asked| !asked.is_empty()) else {
        return (default(), None);
    };
    let error = match asked.to_str().map(EnvFilter::try_new) {
        Some(Ok(filter)) => return (filter, None),
        Some(Err(error)) => error.to_string(),
        None => "it is not UTF-8".to_owned(),
    };
    let objection = format!(
        "RUST_LOG is {asked:?}: {error}; the log is as with \"info\". Write a level, or target=level"
    );
    (default(), Some(objection))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_bad_log_filter_is_reported_and_a_missing_one_is_not() {
        for (asked, filter, objected) in [
            (None, "info", false),
            (Some(""), "info", false),
            (Some("debug"), "debug", false),
            (Some("singletrackd=loud"), "info", true),
        ] {
            let (used, objection) = log_filter(asked.map(OsString::from));
            assert_eq!(used.to_string(), filter);
            assert_eq!(objection.is_some(), objected, "{objection:?}");
            if let Some(objection) = objection {
                assert!(objection.contains("singletrackd=loud"), "{objection}");
            }
        }
    }
}
