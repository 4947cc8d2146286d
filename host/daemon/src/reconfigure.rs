//! Changes of the configuration while the daemon runs.
//!
//! The configuration is read and validated on the requester's thread. The control thread
//! applies all of it or nothing, see [`singletrack_core::reconfigure`].

use std::{
    path::Path,
    sync::{Arc, Mutex, MutexGuard, PoisonError, mpsc},
    thread,
    time::Duration,
};

use singletrack_api::{Change, Configuration};
use singletrack_core::{
    Requests, Stalled,
    commissioned::Subject,
    config::{Config, ReferenceSection},
    reconfigure::{CHANGE_TIMEOUT_NS, ChangeError, Configurations},
};
use singletrack_record::{ConfigurationRecord, Entry, Level};
use tracing::warn;

use crate::{clock::monotonic_ns, commissioned_file::subject, log::logged};

/// The longest time until the control thread takes a change.
const CHANGE_TIMEOUT: Duration = Duration::from_nanos(CHANGE_TIMEOUT_NS);

/// Interval at which the requester polls for the outcome.
const POLL_INTERVAL: Duration = Duration::from_millis(1);

/// Changes the configuration on behalf of any thread but the control thread.
#[derive(Clone, Debug)]
pub(crate) struct Reconfigurer(Arc<Shared>);

#[derive(Debug)]
struct Shared {
    requests: Requests,
    /// Entries for the record.
    entries: mpsc::Sender<Entry>,
    /// Held for as long as a change is under way.
    state: Mutex<State>,
    /// For the status. It is locked for short times only.
    published: Mutex<Published>,
}

/// What other threads may know of the configuration in force.
#[derive(Debug)]
pub(crate) struct Published {
    pub(crate) view: Configuration,
    pub(crate) config: Arc<Config>,
    pub(crate) subject: Option<Subject>,
    /// All of it; none if a path is not UTF-8.
    pub(crate) toml: Option<String>,
}

impl Published {
    fn of(configurations: &Configurations, last_change: Option<Change>) -> Self {
        let config = &configurations.in_force;
        Self {
            view: Configuration {
                number: configurations.number,
                last_change,
            },
            config: Arc::new(config.clone()),
            subject: subject(config).ok(),
            toml: config.to_toml().ok(),
        }
    }

    /// How long a set-point is valid, in s; `None` if the reference is not external.
    pub(crate) fn setpoint_timeout(&self) -> Option<f64> {
        match self.config.reference {
            ReferenceSection::External {
                setpoint_timeout_ms,
            } => Some(f64::from(setpoint_timeout_ms) * 1e-3),
            _ => None,
        }
    }
}

#[derive(Debug)]
struct State {
    configurations: Configurations,
    /// The kind of request of the change under way.
    by: &'static str,
}

impl Reconfigurer {
    pub(crate) fn new(
        configurations: Configurations,
        requests: Requests,
        entries: mpsc::Sender<Entry>,
    ) -> Self {
        Self(Arc::new(Shared {
            requests,
            entries,
            published: Mutex::new(Published::of(&configurations, None)),
            state: Mutex::new(State {
                configurations,
                by: "",
            }),
        }))
    }

    /// Reads the file and puts it in force. Blocks for up to twice [`CHANGE_TIMEOUT`].
    pub(crate) fn reload(&self, path: &Path) -> Result<u32, ChangeError> {
        self.change("reload", |_| Ok(Config::read(path)?))
    }

    /// Replaces the reference of the configuration in force, whose file is `path`. Blocks like
    /// [`reload`](Self::reload).
    pub(crate) fn set_reference(
        &self,
        reference: ReferenceSection,
        path: Option<&Path>,
    ) -> Result<u32, ChangeError> {
        self.change("set-reference", |configurations| {
            let folder = path.and_then(Path::parent);
            let state = &configurations.in_force.state.directory;
            configurations.with_reference(reference, folder.unwrap_or(state))
        })
    }

    /// The configuration in force, with its number. It waits for a change that is under way.
    pub(crate) fn in_force(&self) -> (u32, Config) {
        let state = self.0.state.lock().unwrap_or_else(PoisonError::into_inner);
        let configurations = &state.configurations;
        (configurations.number, configurations.in_force.clone())
    }

    /// Delays every change and every reader of the configuration for as long as it is held.
    #[cfg(test)]
    pub(crate) fn pause(&self) -> impl Drop + '_ {
        self.0.state.lock().unwrap()
    }

    /// Looks as if the configuration had changed.
    #[cfg(test)]
    pub(crate) fn renumber(&self) {
        self.published().view.number += 1;
    }

    /// The configuration in force; it waits for no change.
    pub(crate) fn published(&self) -> MutexGuard<'_, Published> {
        let published = self.0.published.lock();
        published.unwrap_or_else(PoisonError::into_inner)
    }

    fn change(
        &self,
        by: &'static str,
        make: impl FnOnce(&Configurations) -> Result<Config, ChangeError>,
    ) -> Result<u32, ChangeError> {
        // A panic of another requester leaves a consistent state.
        let mut state = self.0.state.lock().unwrap_or_else(PoisonError::into_inner);
        let result = self.try_change(&mut state, by, make);
        if let Err(error) = &result {
            let number = state.configurations.number;
            warn!("{by}: configuration {number} stays: {error}");
            self.published().view.last_change = Some(Change {
                by: by.into(),
                error: Some(error.to_string()),
            });
        }
        result
    }

    fn try_change(
        &self,
        state: &mut State,
        by: &'static str,
        make: impl FnOnce(&Configurations) -> Result<Config, ChangeError>,
    ) -> Result<u32, ChangeError> {
        // The outcome of an earlier change whose requester had timed out.
        self.settle(state);
        if state.configurations.is_changing() {
            return Err(Stalled.into());
        }
        let config = make(&state.configurations)?;
        let until_ns = monotonic_ns().saturating_add(CHANGE_TIMEOUT_NS);
        state
            .configurations
            .begin(config, until_ns, &self.0.requests)?;
        state.by = by;
        // Twice as long: up to the timeout, the control thread may still apply it.
        for _ in 0..2 * CHANGE_TIMEOUT.as_millis() / POLL_INTERVAL.as_millis() {
            thread::sleep(POLL_INTERVAL);
            if let Some(outcome) = self.settle(state) {
                return outcome;
            }
        }
        Err(Stalled.into())
    }

    /// The outcome of the change under way, if it has come; logs and records a success.
    fn settle(&self, state: &mut State) -> Option<Result<u32, ChangeError>> {
        let outcome = state.configurations.settle()?;
        if outcome.is_ok() {
            self.record(state.by, &state.configurations);
        }
        Some(outcome)
    }

    /// Logs, records and publishes the configuration that is now in force.
    fn record(&self, by: &'static str, configurations: &Configurations) {
        let number = configurations.number;
        let time_ns = monotonic_ns();
        let mut text = format!("{by}: configuration {number} is in force");
        let mut level = Level::Info;
        match configurations.in_force.to_toml() {
            Ok(toml) => {
                let record = ConfigurationRecord {
                    time_ns,
                    number,
                    toml,
                };
                // An error means that the collector, and with it the record, has ended.
                let _ = self.0.entries.send(Entry::Configuration(record));
            }
            Err(error) => {
                level = Level::Warning;
                text += &format!(" and can't be recorded: {error}");
            }
        }
        let _ = self.0.entries.send(logged(time_ns, level, text));
        let change = Change {
            by: by.into(),
            error: None,
        };
        let published = Published::of(configurations, Some(change));
        *self.published() = published;
    }
}
