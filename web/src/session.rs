//! The drive that the page shows, and the requests about it.

use std::{error::Error, path::Path};

use serde::Deserialize;
use serde_json::{Map, Value, json};
use singletrack_api::Setpoint;
use singletrack_core::top_view;
use singletrack_record::Digest;
use singletrack_scenario::{
    laboratory::{FaultValue, Laboratory},
    simulate::{
        Progress, Row, RunOptions, Scenario, ScenarioRun, SimulateError, simulate_with,
        virtual_drive_config, write_csv,
    },
    simulated::merge,
};
use singletrack_sim::StartPose;
use toml::Table;

use crate::stability::{Steady, map};

/// JSON, or what the request asks for; or why not.
pub(crate) type Answer = Result<Vec<u8>, Box<dyn Error>>;

/// A request of the page.
#[derive(Deserialize)]
#[serde(tag = "command", rename_all = "kebab-case", deny_unknown_fields)]
enum Request {
    /// Begins the drive of a scenario: what a view of it needs, and its first state.
    Begin { toml: String },
    /// Runs at most `ticks`, up to the end of the scenario if the drive has not passed it: the states
    /// of every `every`-th tick and of the last one.
    Step { ticks: u32, every: u32 },
    /// A set-point, with the keys of the control socket.
    Setpoint { keys: Setpoint },
    /// A fault by its name.
    Fault { name: String, value: FaultValue },
    /// Loses the markers for a duration such as `300ms`.
    LoseMarkers { duration: String },
    /// Puts the car down, at rest.
    Place { x_m: f64, y_m: f64, yaw_rad: f64 },
    /// A request to the pilot by its word.
    Pilot { word: String },
    /// The trajectory so far, as CSV.
    Csv {},
    /// Ends the record of the drive and answers with its bytes.
    Record {},
    /// Runs a scenario as a whole and answers with its CSV.
    Simulate { toml: String },
    /// The digest of a whole scenario.
    Digest { toml: String },
    /// The keys of a scenario, as JSON.
    Keys { toml: String },
    /// A scenario with other values of some keys, as TOML.
    Change {
        toml: String,
        keys: Map<String, Value>,
    },
    /// The map of stability.
    Stability(Steady),
}

/// The drive that is shown.
#[derive(Default)]
pub(crate) struct Session(Option<Shown>);

struct Shown {
    run: ScenarioRun,
    rows: Vec<Row>,
    /// At the end of the scenario.
    digest: Option<Digest>,
}

impl Session {
    pub(crate) fn ask(&mut self, request: &[u8]) -> Answer {
        match serde_json::from_slice(request)? {
            Request::Begin { toml } => {
                // Without room for two.
                self.0 = None;
                let shown = self.0.insert(Shown::begin(&toml)?);
                return reply(&json!({
                    "setup": top_view::setup(1, &shown.laboratory().config),
                    "external": shown.laboratory().is_external(),
                    "state": shown.laboratory().state(),
                }));
            }
            Request::Step { ticks, every } => return self.shown()?.step(ticks, every),
            Request::Setpoint { keys } => self.laboratory()?.setpoint(keys)?,
            Request::Fault { name, value } => self.laboratory()?.set_fault(&name, &value)?,
            Request::LoseMarkers { duration } => self.laboratory()?.lose_markers(&duration)?,
            Request::Place { x_m, y_m, yaw_rad } => {
                self.laboratory()?.place(StartPose { x_m, y_m, yaw_rad })?;
            }
            Request::Pilot { word } => self.laboratory()?.request(&word)??,
            Request::Csv {} => return csv(&self.shown()?.rows),
            Request::Record {} => return Ok(self.laboratory()?.take_record()?),
            Request::Simulate { toml } => {
                return csv(&simulate_with(&scenario(&toml)?, RunOptions::default())?.rows);
            }
            Request::Digest { toml } => {
                let options = RunOptions {
                    digest: true,
                    ..RunOptions::default()
                };
                let digest = simulate_with(&scenario(&toml)?, options)?.digest;
                let digest = digest.ok_or(SimulateError::NoPilot("no digest"))?;
                return Ok(digest.to_string().into());
            }
            Request::Keys { toml } => return reply(&toml.parse::<Table>()?),
            Request::Change { toml, keys } => return change(&toml, &keys),
            Request::Stability(steady) => return reply(&map(&steady)?),
        }
        reply(&json!({}))
    }

    fn shown(&mut self) -> Result<&mut Shown, &'static str> {
        self.0.as_mut().ok_or("there is no drive: begin one")
    }

    fn laboratory(&mut self) -> Result<&mut Laboratory, &'static str> {
        Ok(&mut self.shown()?.run.laboratory)
    }
}

impl Shown {
    fn begin(toml: &str) -> Result<Self, Box<dyn Error>> {
        let scenario = scenario(toml)?;
        let (config, simulation) = virtual_drive_config(&scenario)?;
        let options = RunOptions {
            in_memory: true,
            digest: true,
            ..RunOptions::default()
        };
        Ok(Self {
            run: ScenarioRun::begin(&scenario, &config, &simulation, options)?,
            rows: Vec::new(),
            digest: None,
        })
    }

    const fn laboratory(&self) -> &Laboratory {
        &self.run.laboratory
    }

    fn step(&mut self, ticks: u32, every: u32) -> Answer {
        let mut states = Vec::new();
        let mut done = 0;
        while done < ticks {
            match self.run.advance()? {
                Progress::Row(row) => self.rows.push(row),
                Progress::Tick => {
                    done += 1;
                    if done == ticks || done % every.max(1) == 0 {
                        states.extend(self.laboratory().state());
                    }
                }
            }
            if self.digest.is_none() && self.run.is_complete() {
                self.digest = self.laboratory().digest;
                states.extend(self.laboratory().state());
                break;
            }
        }
        reply(&json!({
            "states": states,
            "error_m": self.rows.last().map(Row::distance_from_reference),
            "digest": self.digest.map(|digest| digest.to_string()),
        }))
    }
}

/// The scenario, or the errors of the command line.
fn scenario(toml: &str) -> Result<Scenario, Box<dyn Error>> {
    Ok(Scenario::from_toml(toml, Path::new("scenario.toml"))?)
}

fn csv(rows: &[Row]) -> Answer {
    let mut text = Vec::new();
    write_csv(rows, &mut text)?;
    Ok(text)
}

/// Replaces keys at any depth. A section with a kind is replaced as a whole: its keys depend on it.
fn change(toml: &str, keys: &Map<String, Value>) -> Answer {
    let mut table: Table = toml.parse()?;
    for (name, _) in keys.iter().filter(|(_, value)| value.get("kind").is_some()) {
        table.remove(name);
    }
    merge(&mut table, &Table::try_from(keys)?);
    Ok(toml::to_string(&table)?.into())
}

pub(crate) fn reply(answer: &impl serde::Serialize) -> Answer {
    Ok(serde_json::to_vec(answer)?)
}
