//! Helpers of several tests.

use std::time::{Duration, Instant};

/// Waits until `condition` holds. Returns how long that took.
pub(crate) fn wait_for(what: &str, mut condition: impl FnMut() -> bool) -> Duration {
    let begin = Instant::now();
    while !condition() {
        assert!(begin.elapsed() < Duration::from_secs(20), "never: {what}");
        std::thread::sleep(Duration::from_millis(1));
    }
    begin.elapsed()
}
