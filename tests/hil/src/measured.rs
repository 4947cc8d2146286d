//! What a test measures, for the table at the end, and the failures of a test; the load of the
//! processors.

use std::{
    collections::HashMap,
    fs,
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
    /// What this process and those that it has started have used.
    own: u64,
}

impl Processors {
    /// The time now; nothing where the kernel does not report it.
    fn now() -> Option<Self> {
        let stat = fs::read_to_string("/proc/stat").ok()?;
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
            own: own_time()?,
        })
    }

    /// The shares of the time from then until later.
    fn shares_until(self, later: Self) -> Option<Shares> {
        let all = later.all.checked_sub(self.all).filter(|&all| all > 0)?;
        let share = |time: u64| time as f64 / all as f64;
        let free = later.free.saturating_sub(self.free);
        let own = later.own.saturating_sub(self.own);
        Some(Shares {
            free: share(free),
            others: share(all.saturating_sub(free + own)),
        })
    }
}

/// The time of this process and of those that it has started, with those that have ended.
fn own_time() -> Option<u64> {
    let processes = fs::read_dir("/proc").ok()?.flatten();
    // One that has just ended has no file, and what is no process has none.
    let stats = processes.filter_map(|entry| fs::read_to_string(entry.path().join("stat")).ok());
    Some(time_of(std::process::id(), stats))
}

/// The time of a process and of those that it has started, of all processes' `stat`.
fn time_of(process: u32, stats: impl Iterator<Item = String>) -> u64 {
    let parsed = |stat: &str| {
        // The program's name may contain anything.
        let (start, fields) = stat.rsplit_once(") ")?;
        let process: u32 = start.split(' ').next()?.parse().ok()?;
        let fields: Vec<&str> = fields.split_whitespace().collect();
        let parent: u32 = fields.get(1)?.parse().ok()?;
        // As a user and as the system, and both of children that have ended.
        let times = fields.get(11..15)?.iter();
        let time: u64 = times.map_while(|field| field.parse::<u64>().ok()).sum();
        Some((process, (parent, time)))
    };
    let all: HashMap<u32, (u32, u64)> = stats.filter_map(|stat| parsed(&stat)).collect();
    let is_of = |one: u32| {
        let parent = |one: &u32| all.get(one).map(|(parent, _)| *parent);
        std::iter::successors(Some(one), parent).any(|one| one == process)
    };
    let of = all.iter().filter(|(one, _)| is_of(**one));
    of.map(|(_, (_, time))| time).sum()
}

/// Shares of the processors' time, 0 to 1.
#[derive(Clone, Copy, Debug)]
pub struct Shares {
    /// What nobody used.
    pub free: f64,
    /// What was used by programs that the tests have not started.
    pub others: f64,
}

impl Shares {
    /// The less that is free of both, and the more that others used.
    fn worse(self, other: Self) -> Self {
        Self {
            free: self.free.min(other.free),
            others: self.others.max(other.others),
        }
    }
}

/// Watches who uses the processors, until it is asked for.
pub struct Load {
    begin: Option<Processors>,
    stop: Sender<()>,
    worst: JoinHandle<Option<Shares>>,
}

impl Load {
    /// A program that is held up for so long has missed every deadline of a drive.
    const WINDOW: Duration = Duration::from_secs(2);

    /// Begins to watch.
    pub fn watch() -> Self {
        let (stop, stopped) = mpsc::channel();
        let worst = thread::spawn(move || {
            let mut worst: Option<Shares> = None;
            let mut begin = Processors::now();
            while stopped.recv_timeout(Self::WINDOW) == Err(RecvTimeoutError::Timeout) {
                let now = Processors::now();
                let shares = begin
                    .zip(now)
                    .and_then(|(begin, now)| begin.shares_until(now));
                worst = worst.into_iter().chain(shares).reduce(Shares::worse);
                begin = now;
            }
            worst
        });
        Self {
            begin: Processors::now(),
            stop,
            worst,
        }
    }

    /// The worst shares, of all the time and of each window; nothing where the kernel does not report
    /// them.
    pub fn worst(self) -> Option<Shares> {
        let whole = self.begin?.shares_until(Processors::now()?)?;
        drop(self.stop);
        let windows = self.worst.join().ok()?;
        Some(windows.map_or(whole, |worst| worst.worse(whole)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_time_of_a_process_is_also_that_of_those_it_has_started() {
        let stat = |process: u32, name: &str, parent: u32, times: &str| {
            format!("{process} ({name}) S {parent} 1 1 0 -1 0 0 0 0 0 {times} 20 0 1\n")
        };
        let stats = [
            stat(1, "init", 0, "1000 1000 1000 1000"),
            stat(7, "hil", 1, "1 2 3 4"),
            stat(8, "a) S 1 (b", 7, "10 20 0 0"),
            stat(9, "below", 8, "100 200 0 0"),
            stat(10, "compiler", 1, "5000 0 0 0"),
            "no process".to_owned(),
        ];
        assert_eq!(time_of(7, stats.into_iter()), 340);
    }
}
