//! What a test measures, for the table at the end, and the failures of a test; the load of the
//! processors.

use std::{
    sync::{
        Arc, Mutex, PoisonError,
        mpsc::{self, RecvTimeoutError, Sender},
    },
    thread::{self, JoinHandle},
    time::Duration,
};

/// Measurements with their limits, shared by all tests.
#[derive(Clone, Debug, Default)]
pub struct Measurements(Arc<Mutex<Vec<Line>>>);

#[derive(Debug)]
struct Line {
    test: String,
    what: String,
    value: f64,
    limit: f64,
    unit: &'static str,
}

impl Measurements {
    /// Records a value, and fails if it exceeds its limit or is NaN.
    ///
    /// # Errors
    ///
    /// Fails if the value exceeds its limit.
    pub fn at_most(
        &self,
        test: &str,
        what: &str,
        value: f64,
        limit: f64,
        unit: &'static str,
    ) -> Outcome {
        self.0
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .push(Line {
                test: test.to_owned(),
                what: what.to_owned(),
                value,
                limit,
                unit,
            });
        if value <= limit {
            Ok(())
        } else {
            Err(Failure::new(format!(
                "{what}: {value:.1} {unit}, more than {limit} {unit}"
            )))
        }
    }

    /// Removes the measurements of a test that is repeated.
    pub fn forget(&self, test: &str) {
        self.0
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .retain(|line| line.test != test);
    }

    /// The table; empty if nothing was measured.
    pub fn table(&self) -> String {
        let lines = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let mut lines: Vec<&Line> = lines.iter().collect();
        // Tests run in parallel, so their lines are mixed.
        lines.sort_by_key(|line| &line.test);
        let mut table = String::new();
        let mut test = "";
        for line in lines {
            if line.test != test {
                test = &line.test;
                table.push_str(&format!("{test}\n"));
            }
            table.push_str(&format!(
                "  {:<62} {:>9.1} of {:>7.1} {}\n",
                line.what, line.value, line.limit, line.unit
            ));
        }
        table
    }
}

/// The smallest value that is not exceeded by `part` (0 to 1) of the sorted values;
/// NaN without values.
pub fn percentile(sorted: &[f64], part: f64) -> f64 {
    let rank = (part * sorted.len() as f64).ceil() as usize;
    sorted
        .get(rank.saturating_sub(1))
        .copied()
        .unwrap_or(f64::NAN)
}

/// Failures of a test.
#[derive(Debug, thiserror::Error)]
pub enum Failure {
    /// A requirement is violated.
    #[error("{0}")]
    Failed(String),
    /// The harness missed what it had to observe: the test has no result.
    #[error("void: {0}")]
    Void(String),
    /// An operation of the system failed.
    #[error("{what}: {source}")]
    System {
        /// The operation.
        what: String,
        /// The system's error.
        source: std::io::Error,
    },
    /// The simulator failed.
    #[error("the simulator: {0}")]
    Simulator(#[from] singletrack_sim::RealTimeError),
}

/// Result of a test or a part of it.
pub type Outcome<T = ()> = Result<T, Failure>;

impl Failure {
    /// A violated requirement.
    pub fn new(what: impl Into<String>) -> Self {
        Self::Failed(what.into())
    }

    /// For `map_err`: adds the operation.
    pub fn system(what: impl Into<String>) -> impl FnOnce(std::io::Error) -> Self {
        |source| Self::System {
            what: what.into(),
            source,
        }
    }
}

/// Fails the test with a formatted message unless the condition holds.
#[macro_export]
macro_rules! ensure {
    ($condition:expr, $($message:tt)+) => {
        if !$condition {
            return Err($crate::Failure::new(format!($($message)+)));
        }
    };
}

/// The processors' time since the start of the system, in the kernel's unit.
#[derive(Clone, Copy, Debug)]
struct Processors {
    free: u64,
    all: u64,
}

impl Processors {
    /// The time now; nothing where the kernel does not report it.
    fn now() -> Option<Self> {
        let stat = std::fs::read_to_string("/proc/stat").ok()?;
        let times = stat.lines().next()?.strip_prefix("cpu ")?;
        let times: Vec<u64> = times
            .split_whitespace()
            .map_while(|time| time.parse().ok())
            .collect();
        // user, nice, system, idle, iowait, irq, softirq, steal; guests are in the first two.
        let times = times.get(..8)?;
        Some(Self {
            free: times[3] + times[4],
            all: times.iter().sum(),
        })
    }

    /// Share of the processors' time that was free since then, 0 to 1.
    fn free_until_now(self) -> Option<f64> {
        let later = Self::now()?;
        let all = later.all.checked_sub(self.all).filter(|&all| all > 0)?;
        Some(later.free.saturating_sub(self.free) as f64 / all as f64)
    }
}

/// Watches the share of the processors' time that is free, until it is asked for.
pub struct FreeTime {
    begin: Option<Processors>,
    stop: Sender<()>,
    least: JoinHandle<f64>,
}

impl FreeTime {
    /// A program that is held up for so long has missed every deadline of a drive.
    const WINDOW: Duration = Duration::from_secs(2);

    /// Begins to watch.
    pub fn watch() -> Self {
        let (stop, stopped) = mpsc::channel();
        let least = thread::spawn(move || {
            let mut least = f64::INFINITY;
            let mut begin = Processors::now();
            while stopped.recv_timeout(Self::WINDOW) == Err(RecvTimeoutError::Timeout) {
                let free = begin.and_then(Processors::free_until_now);
                least = least.min(free.unwrap_or(f64::INFINITY));
                begin = Processors::now();
            }
            least
        });
        Self {
            begin: Processors::now(),
            stop,
            least,
        }
    }

    /// The least share, 0 to 1, of all the time and of each window; nothing where the kernel does not
    /// report it.
    pub fn least(self) -> Option<f64> {
        let whole = self.begin?.free_until_now()?;
        drop(self.stop);
        Some(self.least.join().ok()?.min(whole))
    }
}
