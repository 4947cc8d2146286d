//! The log of the program: set-up, and the summary at the end.

use std::{
    env,
    ffi::OsString,
    io::{self, IsTerminal},
};

use serde_json::json;
use singletrack_record::{Entry, Level, Log};
use tracing::{debug, error, info, warn};
use tracing_appender::non_blocking::{NonBlockingBuilder, WorkerGuard};
use tracing_subscriber::{
    filter::{LevelFilter, Targets},
    layer::SubscriberExt as _,
    util::SubscriberInitExt as _,
};

use crate::{Dropped, LogFormat, Summary};

/// The variable with the filter of the log.
const FILTER: &str = "RUST_LOG";
/// Lines that may wait to be written; more are dropped.
const LOG_LINES: usize = 4_096;

/// Starts the log on stderr. The guard writes the lines that wait when it is dropped.
///
/// A thread that logs never waits for the reader of the log: lines are dropped instead.
pub(crate) fn start_log(format: LogFormat, level: LevelFilter) -> WorkerGuard {
    let (writer, guard) = NonBlockingBuilder::default()
        .lossy(true)
        .buffered_lines_limit(LOG_LINES)
        .finish(io::stderr());
    let (filter, error) = log_filter(env::var_os(FILTER), level);
    let colour = wants_colour(io::stderr().is_terminal(), env::var_os("NO_COLOR"));
    let log = tracing_subscriber::fmt()
        .with_max_level(LevelFilter::TRACE)
        .with_ansi(colour)
        .with_writer(writer)
        // An error of the log's own output has no place to be reported.
        .log_internal_errors(false);
    match format {
        LogFormat::Text => log.with_target(false).finish().with(filter).init(),
        LogFormat::Json => log.json().finish().with(filter).init(),
    }
    if let Some(error) = error {
        warn!("{error}");
    }
    guard
}

/// Logs a line. Returns it for the record.
pub(crate) fn logged(time_ns: u64, level: Level, text: String) -> Entry {
    match level {
        Level::Debug => debug!("{text}"),
        Level::Info => info!("{text}"),
        Level::Warning => warn!("{text}"),
        Level::Error => error!("{text}"),
    }
    Entry::Log(Log {
        time_ns,
        level,
        text,
    })
}

/// Logs the figures of a run.
pub(crate) fn log_summary(summary: &Summary) {
    let figures = &summary.figures;
    info!("serial line: {}", json!(figures.frames));
    info!("motion capture: {}", json!(figures.mocap));
    if figures.dropped != Dropped::default() {
        warn!("dropped for want of room: {}", json!(figures.dropped));
    }
    let record = summary.record.as_ref();
    info!(
        ticks = figures.ticks,
        driving_ticks = figures.driving_ticks,
        deadline_misses = figures.deadline_misses,
        lateness_p99_us = figures.lateness_us.p99,
        lateness_max_us = figures.lateness_us.max,
        record = record.map(|path| path.display().to_string()),
        "singletrackd ends"
    );
}

/// Whether the log is coloured: on a terminal, unless `NO_COLOR` is set and not empty
/// (<https://no-color.org>).
fn wants_colour(is_terminal: bool, no_color: Option<OsString>) -> bool {
    is_terminal && no_color.is_none_or(|value| value.is_empty())
}

/// The filter from `RUST_LOG`, or this level. If the value is invalid, the level and the error.
fn log_filter(value: Option<OsString>, level: LevelFilter) -> (Targets, Option<String>) {
    let default = || Targets::new().with_default(level);
    let Some(value) = value.filter(|value| !value.is_empty()) else {
        return (default(), None);
    };
    let error = match value.to_str().map(str::parse::<Targets>) {
        Some(Ok(filter)) => return (filter, None),
        Some(Err(error)) => error.to_string(),
        None => "it is not UTF-8".to_owned(),
    };
    let error = format!(
        "RUST_LOG is {value:?}: {error}; \"{level}\" is used instead. Write a level, or target=level"
    );
    (default(), Some(error))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_bad_log_filter_is_reported_and_a_missing_one_is_not() {
        for (value, filter, reported) in [
            (None, "info", false),
            (Some(""), "info", false),
            (Some("debug"), "debug", false),
            (Some("singletrackd=loud"), "info", true),
        ] {
            let (used, error) = log_filter(value.map(OsString::from), LevelFilter::INFO);
            assert_eq!(used.to_string(), filter);
            assert_eq!(error.is_some(), reported, "{error:?}");
            if let Some(error) = error {
                assert!(error.contains("singletrackd=loud"), "{error}");
            }
        }
    }

    #[test]
    fn only_a_terminal_without_no_color_gets_colours() {
        for (is_terminal, no_color, coloured) in [
            (true, None, true),
            (true, Some(""), true),
            (true, Some("1"), false),
            (false, None, false),
            (false, Some("1"), false),
        ] {
            let found = wants_colour(is_terminal, no_color.map(OsString::from));
            assert_eq!(found, coloured, "{is_terminal} {no_color:?}");
        }
    }
}
