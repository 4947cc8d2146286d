//! Load of the processors.

/// The processors' time since the start of the system, in the kernel's unit.
#[derive(Clone, Copy, Debug)]
pub struct Processors {
    free: u64,
    all: u64,
}

impl Processors {
    /// The time now; nothing where the kernel does not report it.
    #[must_use]
    pub fn now() -> Option<Self> {
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
    #[must_use]
    pub fn free_until_now(self) -> Option<f64> {
        let later = Self::now()?;
        let all = later.all.checked_sub(self.all).filter(|&all| all > 0)?;
        Some(later.free.saturating_sub(self.free) as f64 / all as f64)
    }
}
