//! Waiting for events with a time limit.

use std::{
    thread,
    time::{Duration, Instant},
};

use crate::{Failure, Outcome};

/// Polling interval.
const INTERVAL: Duration = Duration::from_millis(2);

/// Polls until `look` returns a value.
///
/// # Errors
///
/// Fails at the time limit, or if `look` fails.
pub fn until<T>(
    what: &str,
    limit: Duration,
    mut look: impl FnMut() -> Outcome<Option<T>>,
) -> Outcome<T> {
    let start = Instant::now();
    loop {
        if let Some(value) = look()? {
            return Ok(value);
        }
        if start.elapsed() >= limit {
            return Err(Failure::new(format!("{what}: not within {limit:?}")));
        }
        thread::sleep(INTERVAL);
    }
}

/// Polls for the whole time: checks a condition that must hold throughout.
///
/// # Errors
///
/// Fails if `look` fails.
pub fn throughout(time: Duration, mut look: impl FnMut() -> Outcome) -> Outcome {
    let start = Instant::now();
    while start.elapsed() < time {
        look()?;
        thread::sleep(INTERVAL * 10);
    }
    look()
}
