//! The newest state and status, for all browsers at once; and what the page needs once: where the car
//! may be, where it should be, how large it is, and what the reasons mean.

use std::{
    collections::VecDeque,
    path::{Path, PathBuf},
    sync::Arc,
    thread,
    time::{Duration, Instant},
};

use serde_json::{Map, Value, json};
use singletrack_api::{
    Answer, ClientError, Code, Connection, Refused, Request, ask_as, ask_within,
};
use singletrack_core::{config::Config, top_view};
use tokio::{
    sync::{Notify, watch},
    task::spawn_blocking,
};

use crate::PATIENCE;

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
    /// The last states of this daemon, the oldest first, for a viewer that has just come.
    pub(super) history: watch::Sender<VecDeque<Map<String, Value>>>,
    /// The newest of every other car; null without its daemon.
    others: watch::Sender<Vec<Value>>,
}

impl Feed {
    /// Nothing yet, of a car and `others` more.
    pub(super) fn new(others: usize) -> Self {
        Self {
            states: watch::Sender::new(Arc::from("")),
            statuses: watch::Sender::new(Arc::from("")),
            history: watch::Sender::default(),
            others: watch::Sender::new(vec![Value::Null; others]),
        }
    }

    pub(super) fn is_watched(&self) -> bool {
        self.states.receiver_count() > 0
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
                self.history.send_modify(VecDeque::clear);
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
                let others = self.others.borrow();
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
        let set = |value| self.others.send_modify(|others| others[index] = value);
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

    fn keep(&self, state: &Value) {
        self.history.send_modify(|history| {
            if history.len() == STATES {
                history.pop_front();
            }
            history.push_back(picked(state, &KEPT).collect());
        });
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

/// For this long an answer is given again.
const FRESH: Duration = Duration::from_secs(1);

/// The answer to `/setup.json`: made once for all that ask for it together.
#[derive(Debug, Default)]
pub(super) struct Setup {
    wanted: Notify,
    newest: watch::Sender<Option<(Instant, SetupAnswer)>>,
}

/// The answer, or why there is none.
type SetupAnswer = Result<Arc<str>, Arc<str>>;

impl Setup {
    /// An answer that is at most [`FRESH`] old.
    pub(super) async fn get(&self) -> SetupAnswer {
        let mut newest = self.newest.subscribe();
        loop {
            if let Some(answer) = fresh(newest.borrow_and_update().as_ref()) {
                return answer;
            }
            self.wanted.notify_one();
            if newest.changed().await.is_err() {
                return Err(Arc::from("the page ends"));
            }
        }
    }

    /// Asks the daemon at `socket`, one question at a time, for as long as it is polled.
    pub(super) async fn run(&self, socket: &Path) {
        loop {
            self.wanted.notified().await;
            if fresh(self.newest.borrow().as_ref()).is_some() {
                continue;
            }
            let socket = socket.to_owned();
            let asked = spawn_blocking(move || {
                let (number, config) = configuration(&socket)?;
                Ok::<_, ClientError>(top_view::setup(number, &config).to_string())
            })
            .await;
            let answer = match asked {
                Ok(Ok(setup)) => Ok(Arc::from(setup)),
                Ok(Err(error)) => Err(Arc::from(error.to_string())),
                Err(error) => Err(Arc::from(error.to_string())),
            };
            self.newest.send_replace(Some((Instant::now(), answer)));
        }
    }
}

fn fresh(newest: Option<&(Instant, SetupAnswer)>) -> Option<SetupAnswer> {
    let (made, answer) = newest?;
    (made.elapsed() < FRESH).then(|| answer.clone())
}

/// The configuration in force of the daemon at `socket`, and its number.
fn configuration(socket: &Path) -> Result<(u32, Config), ClientError> {
    let answer = ask_within(&Request::Configuration {}, socket, PATIENCE)?;
    let (Some(number), Some(text)) = (answer.configuration, answer.toml) else {
        let why = "the daemon's configuration has no number or no text";
        return Err(Refused::new(Code::Other, why).into());
    };
    // It is in force: the daemon has judged it.
    let config = toml::from_str(&text).map_err(|error| {
        Refused::new(
            Code::Other,
            format_args!("can't read the daemon's configuration: {error}; is it the same version?"),
        )
    })?;
    Ok((number, config))
}

/// What the page needs of another car, whose daemon is at `socket`.
fn car(socket: &Path) -> Result<Value, ClientError> {
    let (_, config) = configuration(socket)?;
    Ok(json!({
        "car": top_view::car(&config),
        "corners_m": config.fence.corners_m,
        "hold_ms": config.supervisor.hold_ms,
    }))
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
