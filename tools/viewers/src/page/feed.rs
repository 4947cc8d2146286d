//! The newest state and status, for all browsers at once.

use std::{
    collections::VecDeque,
    path::{Path, PathBuf},
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    thread,
    time::{Duration, Instant},
};

use serde_json::{Map, Value, json};
use singletrack_api::{Answer, ClientError, Connection, Request, ask_as};
use tokio::sync::watch;

use super::setup::car;
use crate::daemon::PATIENCE;

/// Interval of the states, and of the statuses.
const STATE_INTERVAL: Duration = Duration::from_millis(40);
const STATUS_INTERVAL: Duration = Duration::from_secs(1);

/// States of the history: those of 20 s.
const STATES: usize = 500;

/// What the history has of a state: what charts and trail show.
const KEPT: [&str; 7] = [
    "t_s",
    "point_m",
    "reference_m",
    "speed_m_s",
    "commanded_speed_m_s",
    "steering_rad",
    "pose_age_s",
];

/// What the page shows of another car.
const SHOWN: [&str; 7] = [
    "mode",
    "reason",
    "x_m",
    "y_m",
    "yaw_rad",
    "steering_rad",
    "pose_age_s",
];

/// For this long the daemon is watched after the last viewer has left: it may be loading the page
/// again.
const LINGER: Duration = Duration::from_secs(5);

/// A car that is shown beside that of the page.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct OtherCar {
    /// The control socket of its daemon.
    pub socket: PathBuf,
    /// Colour as CSS writes it.
    pub colour: Option<String>,
}

/// The newest events, ready to be sent. Empty before the first.
#[derive(Debug)]
pub(super) struct Feed {
    pub(super) states: watch::Sender<Arc<str>>,
    /// The status, or why there is no daemon.
    pub(super) statuses: watch::Sender<Arc<str>>,
    /// The last states of this daemon, for a viewer that has just come.
    history: Mutex<VecDeque<Map<String, Value>>>,
    /// The newest of every other car; null without its daemon.
    others: Mutex<Vec<Value>>,
}

impl Feed {
    /// Nothing yet, of a car and `others` more.
    pub(super) fn new(others: usize) -> Self {
        Self {
            states: watch::Sender::new(Arc::from("")),
            statuses: watch::Sender::new(Arc::from("")),
            history: Mutex::default(),
            others: Mutex::new(vec![Value::Null; others]),
        }
    }

    pub(super) fn is_watched(&self) -> bool {
        self.states.receiver_count() > 0
    }

    /// The last states, the oldest first.
    pub(super) fn history(&self) -> MutexGuard<'_, VecDeque<Map<String, Value>>> {
        self.history.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Publishes what the daemon at `socket` does for as long as a browser watches,
    /// and [`LINGER`] longer.
    pub(super) fn follow(&self, socket: &Path) -> Result<(), ClientError> {
        if !self.is_watched() {
            return Ok(());
        }
        let mut asked: Option<Instant> = None;
        let streamed = self.stream(socket, |newest| {
            if asked.is_none() {
                // Another daemon may have answered before.
                self.history().clear();
            }
            if asked.is_none_or(|asked| asked.elapsed() >= STATUS_INTERVAL) {
                asked = Some(Instant::now());
                // As the daemon wrote it, which may be newer than this program.
                let answer: Value = ask_as(&Request::Status {}, socket, PATIENCE)?;
                let status = answer.get("status").unwrap_or(&Value::Null);
                self.statuses.send_replace(event("status", status));
            }
            if let Some(mut state) = newest {
                self.keep(&state);
                let others = self.others();
                if let (Some(state), false) = (state.as_object_mut(), others.is_empty()) {
                    state.insert("others".to_owned(), json!(*others));
                }
                self.states.send_replace(event("state", &state));
            }
            Ok(())
        });
        self.statuses.send_replace(match &streamed {
            // Nothing old is shown to the next one.
            Ok(()) => Arc::from(""),
            Err(error) => event("lost", &json!(error.to_string())),
        });
        streamed
    }

    /// Keeps the newest of another car for the states.
    pub(super) fn follow_other(&self, index: usize, other: &OtherCar) -> Result<(), ClientError> {
        if !self.is_watched() {
            return Ok(());
        }
        let set = |value| {
            if let Some(other) = self.others().get_mut(index) {
                *other = value;
            }
        };
        let mut shown = car(&other.socket)?;
        if let Some(shown) = shown.as_object_mut() {
            shown.insert("colour".to_owned(), json!(other.colour));
        }
        let result = self.stream(&other.socket, |newest| {
            if let (Some(newest), Some(shown)) = (newest, shown.as_object_mut()) {
                shown.extend(picked(&newest, &SHOWN));
                set(json!(shown));
            }
            Ok(())
        });
        set(Value::Null);
        result
    }

    /// Gives each newest state of the daemon at `socket` for as long as a browser watches, and
    /// [`LINGER`] longer.
    fn stream(
        &self,
        socket: &Path,
        mut each: impl FnMut(Option<Value>) -> Result<(), ClientError>,
    ) -> Result<(), ClientError> {
        let mut states = Connection::watch_states(socket, PATIENCE)?;
        let answer: Option<Answer> = states.receive_within(PATIENCE)?;
        let silent = || ClientError::silent(socket, PATIENCE);
        answer.ok_or_else(silent)?.agreed()?;
        let mut watched = Instant::now();
        while watched.elapsed() < LINGER {
            if self.is_watched() {
                watched = Instant::now();
            }
            let mut newest = None;
            while let Some(line) = states.receive::<Value>()? {
                // Other lines are about states that were missed.
                newest = Some(line)
                    .filter(|line| line.get("topic").is_some())
                    .or(newest);
            }
            each(newest)?;
            thread::sleep(STATE_INTERVAL);
        }
        Ok(())
    }

    fn others(&self) -> MutexGuard<'_, Vec<Value>> {
        self.others.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn keep(&self, state: &Value) {
        let mut history = self.history();
        if history.len() == STATES {
            history.pop_front();
        }
        history.push_back(picked(state, &KEPT).collect());
    }
}

/// Some keys of a state.
fn picked<'a>(state: &'a Value, keys: &'a [&str]) -> impl Iterator<Item = (String, Value)> + 'a {
    keys.iter()
        .filter_map(|key| Some(((*key).to_owned(), state.get(key)?.clone())))
}

/// An event.
fn event(name: &str, data: &Value) -> Arc<str> {
    Arc::from(format!("event: {name}\ndata: {data}\n\n"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_event_is_one_line_of_data() {
        let text = event("lost", &json!("no\nline"));
        assert_eq!(&*text, "event: lost\ndata: \"no\\nline\"\n\n");
    }
}
