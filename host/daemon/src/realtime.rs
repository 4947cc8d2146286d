//! What the system grants a thread that must not be late.
//!
//! All of it is best effort: without it the car drives, and everybody is told.

use core::num::NonZeroU64;
use std::{
    fs::{File, OpenOptions},
    io::Write as _,
};

use rustix::{
    mm::{MlockAllFlags, mlockall},
    process::{Resource, getrlimit},
    thread::{CapabilitySet, capabilities, set_current_timer_slack},
};
use serde::Serialize;
use singletrack_core::control_loop::Rings;

use crate::system;

/// What the system granted the control thread.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct RealTimeStatus {
    /// Its `SCHED_FIFO` priority; none if it is scheduled like any other thread.
    pub fifo_priority: Option<u8>,
    /// Whether the process stays in memory.
    pub memory_locked: bool,
    /// Whether the processors are kept from idling so deeply that waking up takes
    /// long.
    pub idle_bounded: bool,
    /// What was not granted, and how to change that.
    pub refusals: Vec<String>,
}

/// Where Linux takes the longest wake-up that somebody can bear with, in µs, for as
/// long as it is open.
const WAKE_UP: &str = "/dev/cpu_dma_latency";

/// Keeps the processors from idling deeply while the file is open: a thread that
/// sleeps 10 ms at a time is otherwise woken up late by as long as that takes, be
/// it a governor's saving or a virtual machine's host.
pub(crate) fn bound_idle() -> Result<File, String> {
    let refusal = |error| {
        format!(
            "the processors may idle deeply: {WAKE_UP}: {error}; let the daemon's group write to it, \
             as the shipped udev rule does"
        )
    };
    let mut file = OpenOptions::new()
        .write(true)
        .open(WAKE_UP)
        .map_err(refusal)?;
    file.write_all(&0_i32.to_ne_bytes()).map_err(refusal)?;
    Ok(file)
}

/// So much of its stack a control thread may use, in bytes; a tick takes a tenth
/// of it.
const STACK: usize = 512 * 1_024;

/// Keeps the process in memory, if it may lock as much as it likes.
///
/// With a limit, `MCL_FUTURE` would make some later allocation fail.
///
/// # Errors
///
/// What was not granted, and how to change that.
pub fn lock_memory() -> Result<(), String> {
    let unlimited = getrlimit(Resource::Memlock).current.is_none();
    let capable =
        capabilities(None).is_ok_and(|sets| sets.effective.contains(CapabilitySet::IPC_LOCK));
    if !unlimited && !capable {
        return Err(
            "memory is not locked: the limit for it is too small; set LimitMEMLOCK=infinity or ulimit -l unlimited"
                .to_owned(),
        );
    }
    mlockall(MlockAllFlags::CURRENT | MlockAllFlags::FUTURE)
        .map_err(|error| format!("memory is not locked: mlockall: {error}"))
}

/// Has the memory there that a control thread on the calling thread will write
/// to: its stack and the room of these rings. If memory is locked, it is already.
pub fn touch_memory<L>(rings: &mut Rings<L>) {
    system::touch_stack::<STACK>();
    system::touch_room(&mut rings.reports);
    system::touch_room(&mut rings.returned);
    system::touch_room(&mut rings.reconfigured);
}

/// Makes the calling thread a real-time thread.
///
/// # Errors
///
/// What was not granted, and how to change that.
pub fn make_punctual(priority: u8) -> Result<Option<u8>, String> {
    // For when the thread is not scheduled in real time: its timers are not
    // to be bundled with others'. Without it they are 50 µs later.
    let _ = set_current_timer_slack(NonZeroU64::new(1));
    if priority == 0 {
        return Ok(None);
    }
    system::schedule_fifo(priority).map(|()| Some(priority)).map_err(|error| {
        format!(
            "the control thread is not scheduled in real time: SCHED_FIFO at {priority}: {error}; \
             set LimitRTPRIO={priority} or ulimit -r {priority}, or control.realtime_priority = 0"
        )
    })
}
