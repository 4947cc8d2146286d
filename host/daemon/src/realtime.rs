//! Real-time scheduling, locked memory and bounded idling of the processors.
//!
//! Each is best effort: without it the daemon runs, and logs what was refused and how to
//! grant it. `supervisor.require_real_time` makes scheduling and memory a condition to
//! drive.

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
    /// Its `SCHED_FIFO` priority; `None` with the default scheduling.
    pub fifo_priority: Option<u8>,
    /// Whether the memory of the process is locked.
    pub memory_locked: bool,
    /// Whether the processors are kept from deep idle states, which take long to leave.
    pub idle_bounded: bool,
    /// What was refused, and how to grant it.
    pub refusals: Vec<String>,
}

/// While this file is open, Linux keeps the wake-up latency of the processors below the
/// value written to it, in µs.
const LATENCY_FILE: &str = "/dev/cpu_dma_latency";

/// Keeps the processors from idling deeply while the returned file is open. The control
/// thread sleeps for most of its 10 ms; a processor in a deep idle state, or one that a
/// virtual machine's host has halted, would wake it up late.
pub(crate) fn bound_idle() -> Result<File, String> {
    let refusal = |error| {
        format!(
            "the processors may idle deeply: {LATENCY_FILE}: {error}; allow the daemon's group to write to \
             it, as the shipped udev rule does"
        )
    };
    let file = OpenOptions::new().write(true).open(LATENCY_FILE);
    let mut file = file.map_err(refusal)?;
    file.write_all(&0_i32.to_ne_bytes()).map_err(refusal)?;
    Ok(file)
}

/// The part of its stack that the control thread may use, in bytes: ten times the need of
/// a tick.
const STACK: usize = 512 * 1_024;

/// Locks the memory of the process, present and future, if there is no limit on it. With
/// a limit, `MCL_FUTURE` would make a later allocation fail.
///
/// # Errors
///
/// What was refused, and how to grant it.
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

/// Writes to the memory that the control thread will use, on the thread itself: its stack
/// and the free room of these rings. A later write then causes no page fault, also without
/// locked memory.
pub fn touch_memory<L>(rings: &mut Rings<L>) {
    system::touch_stack::<STACK>();
    system::touch_room(&mut rings.reports);
    system::touch_room(&mut rings.returned);
    system::touch_room(&mut rings.reconfigured);
}

/// Schedules the calling thread with `SCHED_FIFO` at `priority` and returns the priority;
/// 0 keeps the default scheduling and returns `None`.
///
/// # Errors
///
/// What was refused, and how to grant it.
pub fn make_punctual(priority: u8) -> Result<Option<u8>, String> {
    // Without real-time scheduling, timers are grouped with others and 50 µs later.
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

/// Schedules the calling thread, which brings what the control thread waits for, one level below
/// a control thread that is scheduled in real time: what else runs on the computer delays neither.
pub fn make_prompt(control_priority: Option<u8>) {
    if let Some(priority) = control_priority.and_then(|priority| priority.checked_sub(1)) {
        // A lower priority than the one that was granted is not refused; if it were, the thread
        // would be scheduled like all others, as without real time.
        let _ = make_punctual(priority);
    }
}
