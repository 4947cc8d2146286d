//! Changes of configuration that are requested while the daemon runs.
//!
//! The file is read and checked on the requester's thread; the control thread takes it
//! over as a whole or not at all, see [`singletrack_core::reconfigure`].

use std::{
    path::Path,
    sync::{Arc, Mutex, PoisonError, mpsc},
    thread,
    time::Duration,
};

use serde::Serialize;
use singletrack_core::{
    Requests, Stalled,
    config::{Config, ReferenceSection},
    reconfigure::{ChangeError, Configurations},
};
use singletrack_record::{ConfigurationRecord, Entry, Level, Log};
use tracing::{info, warn};

use crate::clock::monotonic_ns;

/// How long the control thread may take to answer: many ticks.
const PATIENCE: Duration = Duration::from_millis(200);

/// How often it is looked for.
const LOOK: Duration = Duration::from_millis(1);

/// Which configuration is in force.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct ConfigurationView {
    /// 1 for the one that the daemon started with, one more for each change.
    pub number: u32,
    /// What came of the last attempt to change it; none before the first.
    pub last_change: Option<ChangeView>,
}

/// What came of an attempt to change the configuration.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct ChangeView {
    /// Who asked: "reload" or "set-reference".
    pub by: &'static str,
    /// Why nothing has changed; none if it has.
    pub error: Option<String>,
}

/// Where anybody but the control thread asks for another configuration.
#[derive(Clone, Debug)]
pub(crate) struct Reconfigurer(Arc<Shared>);

#[derive(Debug)]
struct Shared {
    requests: Requests,
    /// For the record.
    told: mpsc::Sender<Entry>,
    /// Held for as long as a change is under way.
    state: Mutex<State>,
    /// Never held for long.
    view: Mutex<(ConfigurationView, bool)>,
}

#[derive(Debug)]
struct State {
    configurations: Configurations,
    /// Who requested the change under way.
    by: &'static str,
}

impl Reconfigurer {
    pub(crate) fn new(
        configurations: Configurations,
        requests: Requests,
        told: mpsc::Sender<Entry>,
    ) -> Self {
        Self(Arc::new(Shared {
            requests,
            told,
            view: Mutex::new((
                ConfigurationView {
                    number: configurations.number(),
                    last_change: None,
                },
                takes_setpoints(configurations.in_force()),
            )),
            state: Mutex::new(State {
                configurations,
                by: "",
            }),
        }))
    }

    /// Reloads the configuration.
    pub(crate) fn reload(&self, path: &Path) -> Result<u32, ChangeError> {
        self.change("reload", |_| Ok(Config::read(path)?))
    }

    /// The configuration in force with another reference.
    pub(crate) fn set_reference(&self, reference: ReferenceSection) -> Result<u32, ChangeError> {
        self.change("set-reference", |configurations| {
            configurations.with_reference(reference)
        })
    }

    pub(crate) fn view(&self) -> ConfigurationView {
        let view = self.0.view.lock();
        view.unwrap_or_else(PoisonError::into_inner).0.clone()
    }

    /// Whether the reference in force is made of set-points.
    pub(crate) fn takes_setpoints(&self) -> bool {
        let view = self.0.view.lock();
        view.unwrap_or_else(PoisonError::into_inner).1
    }

    fn change(
        &self,
        by: &'static str,
        make: impl FnOnce(&Configurations) -> Result<Config, ChangeError>,
    ) -> Result<u32, ChangeError> {
        // A panic of another requester left no half of a change.
        let mut state = self.0.state.lock().unwrap_or_else(PoisonError::into_inner);
        let result = self.try_change(&mut state, by, make);
        if let Err(error) = &result {
            let number = state.configurations.number();
            warn!("{by}: configuration {number} stays: {error}");
            self.tell(ChangeView {
                by,
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
        // A change that was returned after its requester had given up.
        self.settle(state);
        let config = make(&state.configurations)?;
        let patience_ns = u64::try_from(PATIENCE.as_nanos()).unwrap_or(u64::MAX);
        let until_ns = monotonic_ns().saturating_add(patience_ns);
        state
            .configurations
            .begin(config, until_ns, &self.0.requests)?;
        state.by = by;
        // Twice as long: in the first half it may still be taken over.
        for _ in 0..2 * PATIENCE.as_millis() / LOOK.as_millis() {
            thread::sleep(LOOK);
            if let Some(outcome) = self.settle(state) {
                return outcome;
            }
        }
        Err(Stalled.into())
    }

    /// Takes in the outcome of the change under way.
    fn settle(&self, state: &mut State) -> Option<Result<u32, ChangeError>> {
        let outcome = state.configurations.settle()?;
        if outcome.is_ok() {
            self.record(state.by, &state.configurations);
        }
        Some(outcome)
    }

    /// Logs what is in force now; the record gets all of it.
    fn record(&self, by: &'static str, configurations: &Configurations) {
        let number = configurations.number();
        info!("{by}: configuration {number} is in force");
        let time_ns = monotonic_ns();
        let (level, text) = match configurations.in_force().to_toml() {
            Ok(toml) => {
                // Without a collector there is no record either.
                let _ = self.0.told.send(Entry::Configuration(ConfigurationRecord {
                    time_ns,
                    number,
                    toml,
                }));
                (
                    Level::Info,
                    format!("{by}: configuration {number} is in force"),
                )
            }
            Err(error) => (
                Level::Warning,
                format!("{by}: configuration {number} is in force and can't be recorded: {error}"),
            ),
        };
        let _ = self.0.told.send(Entry::Log(Log {
            time_ns,
            level,
            text,
        }));
        let mut view = self.0.view.lock().unwrap_or_else(PoisonError::into_inner);
        view.0.number = number;
        view.1 = takes_setpoints(configurations.in_force());
        view.0.last_change = Some(ChangeView { by, error: None });
    }

    fn tell(&self, change: ChangeView) {
        let mut view = self.0.view.lock().unwrap_or_else(PoisonError::into_inner);
        view.0.last_change = Some(change);
    }
}

const fn takes_setpoints(config: &Config) -> bool {
    matches!(config.reference, ReferenceSection::External { .. })
}
