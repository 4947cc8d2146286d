//! Priority of the threads that stand for hardware, and of the kernel's.

use std::fs;

/// Raises the priority of this thread and of those that it starts: they stand for
/// hardware, which shares no processor.
pub(super) fn raise_priority() {
    // Below the threads of the daemon. By nice values alone, another session's programs would still
    // get an equal share of the processors.
    let in_real_time = singletrackd::realtime::make_punctual(1).is_ok();
    if !in_real_time {
        // Without permission, the rig is late more often, which it reports.
        let _ = rustix::process::setpriority_process(None, -20);
    }
}

/// The group of this session, among which and the kernel's threads the kernel shares processors.
const GROUP: &str = "/proc/self/autogroup";

/// Share of a group by its nice value: about a tenth of a kernel thread's.
const MODEST: i32 = 10;

/// Lets the kernel's threads go before this session until it is dropped.
///
/// They move the bytes of the pseudo-terminals. Beside a busy session they waited for up to 8 s
/// (Linux 6.18), which no program in it can prevent by its own priority.
#[derive(Debug)]
pub struct ModestSession(Option<i32>);

impl ModestSession {
    /// Without permission, or without groups, rigs are late more often, which they report.
    #[must_use]
    pub fn begin() -> Self {
        let nice = fs::read_to_string(GROUP)
            .ok()
            .and_then(|text| text.rsplit(' ').next()?.trim().parse().ok())
            .filter(|&nice: &i32| nice < MODEST);
        Self(nice.filter(|_| fs::write(GROUP, MODEST.to_string()).is_ok()))
    }
}

impl Drop for ModestSession {
    fn drop(&mut self) {
        if let Some(nice) = self.0 {
            // There is nobody to tell.
            let _ = fs::write(GROUP, nice.to_string());
        }
    }
}
