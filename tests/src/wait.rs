//! Waiting for events, never longer than stated.

use std::{
    thread,
    time::{Duration, Instant},
};

use crate::{Failure, Outcome};

/// Time between two looks.
const INTERVAL: Duration = Duration::from_millis(2);

/// Looks until there is something to see.
///
/// # Errors
///
/// Nothing within the limit, or what looking failed with.
pub fn until<T>(
    what: &str,
    limit: Duration,
    mut look: impl FnMut() -> Outcome<Option<T>>,
) -> Outcome<T> {
    let start = Instant::now();
    loop {
        if let Some(seen) = look()? {
            return Ok(seen);
        }
        if start.elapsed() >= limit {
            return Err(Failure::new(format!("{what}: not within {limit:?}")));
        }
        thread::sleep(INTERVAL);
    }
}

/// Looks for the whole of the time: what must stay so is checked all along.
///
/// # Errors
///
/// What looking failed with.
pub fn throughout(time: Duration, mut look: impl FnMut() -> Outcome) -> Outcome {
    let start = Instant::now();
    while start.elapsed() < time {
        look()?;
        thread::sleep(INTERVAL * 10);
    }
    look()
}
