//! What the threads share: the options, the car, what is passed on and what is not, and the drive that is
//! held.

use std::{
    collections::{BTreeMap, BTreeSet},
    sync::{Mutex, MutexGuard, PoisonError},
    time::{Duration, Instant},
};

use crate::{arguments::Arguments, car::Car};

/// A reason is logged once in this time.
const LOG_INTERVAL: Duration = Duration::from_secs(5);

/// The last set-point before an arm may be this old.
const ATTENDED: Duration = Duration::from_millis(500);

#[derive(Debug)]
pub(crate) struct Shared {
    pub(crate) arguments: Arguments,
    state: Mutex<State>,
}

/// What changes while the program runs.
#[derive(Debug, Default)]
pub(crate) struct State {
    /// The car, once the daemon has given its configuration.
    pub(crate) car: Option<Car>,
    pub(crate) counts: Counts,
    logged: BTreeMap<String, Instant>,
    /// What is warned of a single time.
    warned: BTreeSet<&'static str>,
    /// When a set-point was passed on, and when the daemon rejected one.
    pub(crate) passed: Option<Instant>,
    pub(crate) rejected: Option<Instant>,
    /// A drive of this process is being armed, or driven.
    pub(crate) is_held: bool,
}

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
}

impl Shared {
    pub(crate) fn new(arguments: Arguments) -> Self {
        let state = Mutex::default();
        Self { arguments, state }
    }

    pub(crate) fn state(&self) -> MutexGuard<'_, State> {
        // The state holds no invariant that a panic could break.
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Warns of a reason, unless that was done a short while ago.
    pub(crate) fn warn(&self, reason: &str, text: &str) {
        if self.state().may_log(reason, Instant::now()) {
            tracing::warn!("{text}");
        }
    }

    /// Warns of each text the first time.
    pub(crate) fn warn_once(&self, texts: [Option<&'static str>; 2]) {
        for text in texts.into_iter().flatten() {
            if self.state().warned.insert(text) {
                tracing::warn!("{text}");
            }
        }
    }
}

impl State {
    /// Whether `reason` has not been logged for a while; it counts as logged now.
    fn may_log(&mut self, reason: &str, now: Instant) -> bool {
        let logged = self.logged.get(reason);
        let may = logged.is_none_or(|logged| now.duration_since(*logged) >= LOG_INTERVAL);
        if may {
            self.logged.insert(reason.to_owned(), now);
        }
        may
    }

    /// Why no drive may be armed now.
    pub(crate) fn refusal(&self, now: Instant) -> Option<&'static str> {
        let recent =
            |time: Option<Instant>| time.is_some_and(|time| now.duration_since(time) <= ATTENDED);
        if self.is_held {
            return Some("a drive of this node is under way");
        }
        if !recent(self.passed) {
            return Some(
                "no set-points come: send them to drive, cmd_vel, point_velocity or path first, then \
                 arm",
            );
        }
        if recent(self.rejected) {
            return Some(
                "the daemon rejects the set-points (see /diagnostics); is reference.kind \
                 \"external\"?",
            );
        }
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_reason_is_logged_once_in_a_while() {
        let mut state = State::default();
        let now = Instant::now();
        assert!(state.may_log("old", now));
        assert!(!state.may_log("old", now + Duration::from_millis(4_999)));
        assert!(state.may_log("frame", now));
        assert!(state.may_log("old", now + LOG_INTERVAL));
    }

    #[test]
    fn a_drive_is_armed_only_while_set_points_come_and_are_taken() {
        let now = Instant::now() + Duration::from_secs(10);
        let ago = |ms| Some(now - Duration::from_millis(ms));
        let refusal = |passed, rejected, is_held| {
            let state = State {
                passed,
                rejected,
                is_held,
                ..State::default()
            };
            state.refusal(now).unwrap_or("none").to_owned()
        };
        assert_eq!(refusal(ago(10), None, false), "none");
        assert_eq!(refusal(ago(10), ago(501), false), "none");
        assert!(refusal(ago(10), ago(10), false).contains("rejects"));
        assert!(refusal(ago(501), None, false).contains("no set-points"));
        assert!(refusal(None, None, false).contains("no set-points"));
        assert!(refusal(ago(10), None, true).contains("under way"));
    }
}
