//! Latency of the system's pseudo-terminals.

use std::{
    fs::{File, OpenOptions},
    io::Read,
    sync::{
        Arc,
        atomic::{AtomicBool, AtomicU64, Ordering},
    },
    thread::{self, JoinHandle},
    time::{Duration, Instant},
};

use rustix::thread::{CpuSet, sched_getaffinity, sched_setaffinity};
use singletrack_sim::Pty;

use super::priority::raise_priority;
use crate::{Failure, Outcome};

/// Time between two bytes.
const PERIOD: Duration = Duration::from_millis(10);

/// A separate pseudo-terminal per processor, through which a byte is sent every 10 ms.
///
/// The kernel's worker threads move bytes between the ends of a pseudo-terminal and
/// share the processors with all programs: on a machine that compiles, telemetry
/// was delayed there by 200 ms while simulator and daemon were in time, and on one
/// processor only. The delay measured here applies to the board's line too.
#[derive(Debug)]
pub(super) struct Canary {
    late_us: Arc<AtomicU64>,
    stop: Arc<AtomicBool>,
    threads: Vec<JoinHandle<()>>,
}

impl Canary {
    pub(super) fn start() -> Outcome<Self> {
        let mut canary = Self {
            late_us: Arc::new(AtomicU64::new(0)),
            stop: Arc::new(AtomicBool::new(false)),
            threads: Vec::new(),
        };
        let processors = sched_getaffinity(None)
            .map_err(|error| Failure::new(format!("can't ask for the processors: {error}")))?;
        for processor in (0..CpuSet::MAX_CPU).filter(|&number| processors.is_set(number)) {
            canary.watch(processor)?;
        }
        Ok(canary)
    }

    fn watch(&mut self, processor: usize) -> Outcome {
        let pty = Pty::open(None).map_err(|error| Failure::new(error.to_string()))?;
        let far_end = OpenOptions::new()
            .read(true)
            .open(pty.path())
            .map_err(Failure::system("can't open a pseudo-terminal"))?;
        let (worst_us, stopped) = (Arc::clone(&self.late_us), Arc::clone(&self.stop));
        let thread = thread::Builder::new()
            .name("canary".to_owned())
            .spawn(move || {
                raise_priority();
                let mut only = CpuSet::new();
                only.set(processor);
                // A processor that was taken away meanwhile can't be late.
                let _ = sched_setaffinity(None, &only);
                measure(&pty, far_end, &worst_us, &stopped);
            })
            .map_err(Failure::system("can't start a thread"))?;
        self.threads.push(thread);
        Ok(())
    }

    /// Longest delay of a byte.
    pub(super) fn lateness(&self) -> Duration {
        Duration::from_micros(self.late_us.load(Ordering::Relaxed))
    }
}

impl Drop for Canary {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        for thread in self.threads.drain(..) {
            // Its result is no longer needed.
            let _ = thread.join();
        }
    }
}

fn measure(pty: &Pty, mut far_end: File, worst_us: &AtomicU64, stop: &AtomicBool) {
    let mut byte = [0];
    while !stop.load(Ordering::Relaxed) {
        thread::sleep(PERIOD);
        let written = Instant::now();
        if !pty.write(&[1]).is_ok_and(|count| count == 1) || far_end.read_exact(&mut byte).is_err()
        {
            return;
        }
        let took_us = u64::try_from(written.elapsed().as_micros()).unwrap_or(u64::MAX);
        worst_us.fetch_max(took_us, Ordering::Relaxed);
    }
}
