//! A new configuration for a controller that runs.
//!
//! Read, checked and built here, by whoever asks for it; handed to the control
//! thread whole, in a box that comes back to be dropped here: the control thread
//! reads no file, waits for nobody and frees nothing. What it can't take over,
//! or not now, changes nothing.

use std::{
    path::{Path, PathBuf},
    sync::{Arc, Mutex, PoisonError, mpsc},
    thread,
    time::Duration,
};

use rtrb::Consumer;
use serde::Serialize;
use singletrack_pilot::PilotConfig;
use singletrack_protocol::Configuration;
use singletrack_record::{ConfigurationRecord, Entry, Level, Log};
use tracing::{info, warn};

use crate::{
    clock::monotonic_ns,
    config::{Config, ConfigError, ReferenceSection},
    control_loop::ControlRequest,
    controller::ReconfigureError,
    requests::{Requests, Stalled},
    restart_keys::restart_keys,
};

/// How long the control thread may take to answer: many ticks.
const PATIENCE: Duration = Duration::from_millis(200);

/// How often it is looked for.
const LOOK: Duration = Duration::from_millis(1);

/// What the control thread takes over between two ticks.
#[derive(Clone, Debug, PartialEq)]
pub struct Reconfiguration {
    /// Its number; the one that the daemon started with is 1.
    pub number: u32,
    /// For the pilot.
    pub pilot: PilotConfig,
    /// For the board.
    pub board: Configuration,
    /// Later than this, nobody waits for it any more and it is not taken over.
    pub until_ns: u64,
    /// What became of it; none until the control thread has seen it.
    pub outcome: Option<Result<(), Refusal>>,
}

/// Why the control thread did not take a configuration over.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum Refusal {
    /// The pilot says no.
    #[error(transparent)]
    Pilot(#[from] ReconfigureError),
    /// The daemon is about to end.
    #[error("singletrackd is about to end")]
    Ending,
    /// It was handed over too late.
    #[error("the control thread was stalled")]
    Late,
}

/// Why the configuration in force is still the one of before.
#[derive(Debug, thiserror::Error)]
pub enum ChangeError {
    /// The new one makes no sense.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// The new one differs in what is only read at the start.
    #[error(
        "{} can't change while singletrackd runs: restart it, or take {} back",
        .0.join(", "),
        if .0.len() == 1 { "that" } else { "those" }
    )]
    Restart(Vec<String>),
    /// It can't be compared with the one in force.
    #[error("{0}; every path must be UTF-8")]
    Path(#[from] toml::ser::Error),
    /// The control thread does not take it over.
    #[error(transparent)]
    Refused(#[from] Refusal),
    /// The control thread takes no requests.
    #[error(transparent)]
    Stalled(#[from] Stalled),
    /// A reference that names a file by a path that depends on who reads it.
    #[error("reference.file is {}: a daemon needs an absolute path", .0.display())]
    RelativePath(PathBuf),
}

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
    in_force: Config,
    number: u32,
    returned: Consumer<Box<Reconfiguration>>,
    /// Handed over and not yet back: who asked, and for what.
    under_way: Option<(&'static str, Config)>,
}

impl Reconfigurer {
    /// `config` is in force; `returned` is where boxes come back.
    pub(crate) fn new(
        config: Config,
        requests: Requests,
        returned: Consumer<Box<Reconfiguration>>,
        told: mpsc::Sender<Entry>,
    ) -> Self {
        let takes_setpoints = takes_setpoints(&config);
        Self(Arc::new(Shared {
            requests,
            told,
            view: Mutex::new((
                ConfigurationView {
                    number: 1,
                    last_change: None,
                },
                takes_setpoints,
            )),
            state: Mutex::new(State {
                in_force: config,
                number: 1,
                returned,
                under_way: None,
            }),
        }))
    }

    /// Reads the configuration anew.
    pub(crate) fn reload(&self, path: &Path) -> Result<u32, ChangeError> {
        self.change("reload", |_| Ok(Config::read(path)?))
    }

    /// The configuration in force with another reference.
    pub(crate) fn set_reference(&self, reference: ReferenceSection) -> Result<u32, ChangeError> {
        self.change("set-reference", |in_force| {
            if let ReferenceSection::Waypoints { file } = &reference
                && !file.is_absolute()
            {
                return Err(ChangeError::RelativePath(file.clone()));
            }
            let config = Config {
                reference,
                ..in_force.clone()
            };
            config.validate()?;
            Ok(config)
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
        make: impl FnOnce(&Config) -> Result<Config, ChangeError>,
    ) -> Result<u32, ChangeError> {
        // Whoever panicked with it changed nothing by halves.
        let mut state = self.0.state.lock().unwrap_or_else(PoisonError::into_inner);
        let result = self.try_change(&mut state, by, make);
        if let Err(error) = &result {
            warn!("{by}: configuration {} stays: {error}", state.number);
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
        make: impl FnOnce(&Config) -> Result<Config, ChangeError>,
    ) -> Result<u32, ChangeError> {
        // One that came back when nobody waited for it any more.
        self.settle(state);
        if state.under_way.is_some() {
            return Err(Stalled.into());
        }
        let mut config = make(&state.in_force)?;
        config.reference = config.reference.written_out()?;
        let keys = restart_keys(&state.in_force, &config)?;
        if !keys.is_empty() {
            return Err(ChangeError::Restart(keys));
        }
        let patience_ns = u64::try_from(PATIENCE.as_nanos()).unwrap_or(u64::MAX);
        let change = Box::new(Reconfiguration {
            number: state.number.wrapping_add(1),
            pilot: config.pilot()?,
            board: config.board.configuration(),
            until_ns: monotonic_ns().saturating_add(patience_ns),
            outcome: None,
        });
        self.0.requests.push(ControlRequest::Reconfigure(change))?;
        state.under_way = Some((by, config));
        // Twice: in the first half it may still be taken over.
        for _ in 0..2 * PATIENCE.as_millis() / LOOK.as_millis() {
            thread::sleep(LOOK);
            if let Some(outcome) = self.settle(state) {
                return outcome;
            }
        }
        Err(Stalled.into())
    }

    /// Takes in what came back, and says what became of it.
    fn settle(&self, state: &mut State) -> Option<Result<u32, ChangeError>> {
        let change = state.returned.pop().ok()?;
        let (by, config) = state.under_way.take()?;
        match change.outcome {
            Some(Ok(())) => {}
            Some(Err(refusal)) => return Some(Err(refusal.into())),
            None => return Some(Err(Stalled.into())),
        }
        state.in_force = config;
        state.number = change.number;
        self.record(by, state);
        Some(Ok(state.number))
    }

    /// Logs what is in force now; the record gets all of it.
    fn record(&self, by: &'static str, state: &State) {
        let number = state.number;
        info!("{by}: configuration {number} is in force");
        let time_ns = monotonic_ns();
        let (level, text) = match state.in_force.to_toml() {
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
        view.1 = takes_setpoints(&state.in_force);
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
