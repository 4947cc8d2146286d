//! Counts what is passed on and what is not, and logs reasons without flooding the log.

use std::{
    collections::{BTreeMap, BTreeSet},
    sync::{Mutex, MutexGuard, PoisonError},
    time::{Duration, Instant},
};

/// A reason is logged once in this time.
const LOG_INTERVAL: Duration = Duration::from_secs(5);

/// The counts, shared by all threads.
#[derive(Debug, Default)]
pub(crate) struct Tally(Mutex<Counts>);

/// The counts since the start.
#[derive(Clone, Debug, Default)]
pub(crate) struct Counts {
    /// Set-points that were passed on to the daemon.
    pub(crate) passed: u64,
    /// Set-points that this program refused, by code.
    pub(crate) refused: BTreeMap<&'static str, u64>,
    /// Set-points that the daemon rejected, by code.
    pub(crate) rejected: BTreeMap<&'static str, u64>,
    /// Set-points that did not reach the daemon.
    pub(crate) lost: u64,
    /// Entries of the record that this program was too slow for.
    pub(crate) missed: u64,
    /// Messages that were not published, because a reliable subscriber is too slow.
    pub(crate) held_up: u64,
    logged: BTreeMap<String, Instant>,
    /// What is warned of a single time.
    warned: BTreeSet<&'static str>,
}

impl Tally {
    pub(crate) fn lock(&self) -> MutexGuard<'_, Counts> {
        // The counts hold no invariant that a panic could break.
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Warns of a reason, unless that was done a short while ago.
    pub(crate) fn warn(&self, reason: &str, text: &str) {
        if self.lock().may_log(reason, Instant::now()) {
            tracing::warn!("{text}");
        }
    }

    /// Warns of something the first time.
    pub(crate) fn warn_once(&self, text: &'static str) {
        if self.lock().warned.insert(text) {
            tracing::warn!("{text}");
        }
    }
}

impl Counts {
    /// Whether `reason` has not been logged for a while; it counts as logged now.
    fn may_log(&mut self, reason: &str, now: Instant) -> bool {
        let logged = self.logged.get(reason);
        let may = logged.is_none_or(|logged| now.duration_since(*logged) >= LOG_INTERVAL);
        if may {
            self.logged.insert(reason.to_owned(), now);
        }
        may
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_reason_is_logged_once_in_a_while() {
        let mut counts = Counts::default();
        let now = Instant::now();
        assert!(counts.may_log("old", now));
        assert!(!counts.may_log("old", now + Duration::from_millis(4_999)));
        assert!(counts.may_log("frame", now));
        assert!(counts.may_log("old", now + LOG_INTERVAL));
    }
}
