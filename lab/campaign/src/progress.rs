//! How far a campaign is, on standard error.

use std::{
    io::{self, IsTerminal as _, Write as _},
    sync::{Mutex, PoisonError},
    time::{Duration, Instant},
};

use indicatif::{ProgressBar, ProgressStyle};

/// Interval of the lines in a log.
const LINE_INTERVAL: Duration = Duration::from_secs(60);

/// A bar on a terminal, and a line a minute in a log, as the job of a cluster has it.
#[derive(Debug)]
pub struct Progress {
    name: &'static str,
    bar: ProgressBar,
    /// When the next line is due; `None` on a terminal.
    next_line: Option<Mutex<Instant>>,
}

impl Progress {
    /// For `length` units.
    #[must_use]
    pub fn new(name: &'static str, length: u64) -> Self {
        let bar = ProgressBar::new(length);
        if let Ok(style) =
            ProgressStyle::with_template("{bar:30} {pos}/{len}, {per_sec}, {eta} left")
        {
            bar.set_style(style);
        }
        let next_line =
            (!io::stderr().is_terminal()).then(|| Mutex::new(Instant::now() + LINE_INTERVAL));
        Self {
            name,
            bar,
            next_line,
        }
    }

    /// A unit is done.
    pub fn advance(&self) {
        self.bar.inc(1);
        let Some(next) = &self.next_line else {
            return;
        };
        let mut next = next.lock().unwrap_or_else(PoisonError::into_inner);
        if Instant::now() >= *next {
            *next += LINE_INTERVAL;
            let (done, all) = (self.bar.position(), self.bar.length().unwrap_or(0));
            // Standard error may be closed.
            let _ = writeln!(
                io::stderr().lock(),
                "{}: {done} of {all} after {:.0} s",
                self.name,
                self.bar.elapsed().as_secs_f64()
            );
        }
    }

    /// The end.
    pub fn finish(&self) {
        self.bar.finish_and_clear();
    }
}
