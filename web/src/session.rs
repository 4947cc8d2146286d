//! The drive that the page shows and the requests about it; the replay of a record, bit for bit; and the map
//! of stability of the car at hand under the front-point law.

use std::{collections::BTreeMap, error::Error, io::Cursor, path::Path};

use serde::Deserialize;
use serde_json::{Map, Value, json};
use singletrack_analysis::stability::{
    Ages, Belief, ClosedLoop, Law, SampledLoop, Servo, Timing, critical_speed,
    first_unstable_speed, hopf_points,
};
use singletrack_api::Setpoint;
use singletrack_control::VehicleParameters;
use singletrack_core::{Config, state_stream::States, top_view};
use singletrack_record::{Digest, Ending, Entry, Reader, Replay, Topic};
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

fn reply(answer: &impl serde::Serialize) -> Answer {
    Ok(serde_json::to_vec(answer)?)
}

/// Ticks from one state to the next.
const TICKS_PER_STATE: u64 = 5;

/// Replays a record and compares all outputs; with its states, to be drawn.
pub(crate) fn replay(record: Vec<u8>) -> Answer {
    let bytes = record.len();
    let mut reader = Reader::from_read(Cursor::new(record), Path::new("the record"))?
        .only(&[Topic::Configuration, Topic::Tick]);
    let meta = &reader.meta;
    let config = Config::from_toml(&meta.configuration)?;
    let (software, seed) = (meta.software.clone(), meta.seed);
    let mut replay = Replay::new(config.pilot()?);
    let (mut digest, mut seen, mut states) = (Digest::default(), States::default(), Vec::new());
    let (mut ticks, mut different, mut first) = (0_u64, 0_u64, None);
    let mut modes: BTreeMap<&str, u64> = BTreeMap::new();
    for entry in reader.by_ref() {
        match entry? {
            Entry::Configuration(found) => {
                let config = Config::from_toml(&found.toml)?;
                replay.configuration(found.number, config.pilot()?);
            }
            Entry::Tick(tick) => {
                let output = replay.tick(&tick)?;
                if !tick.is_output(&output) {
                    different += 1;
                    first.get_or_insert_with(|| {
                        let fields = tick.differences(&output).into_iter();
                        let fields: Vec<_> = fields.map(|it| it.to_string()).collect();
                        (tick.index, fields)
                    });
                }
                digest.add(&tick);
                seen.tick(&tick);
                if ticks % TICKS_PER_STATE == 0 {
                    states.push(seen.state(&tick));
                }
                ticks += 1;
                *modes.entry(tick.output.mode.name()).or_default() += 1;
            }
            _ => {}
        }
    }
    reply(&json!({
        "bytes": bytes,
        "software": software,
        "seed": seed,
        "ticks": ticks,
        "different": different,
        "first": first,
        "finished": reader.ending == Some(Ending::Finished),
        "digest": digest.to_string(),
        "modes": modes,
        "setup": top_view::setup(1, &config),
        "states": states,
    }))
}

/// Points of the Hopf curve.
const HOPF_SPEEDS: u32 = 100;
/// The searched speeds of the sampled loop, in m/s.
const SEARCHED_SPEEDS: [f64; 2] = [0.1, 20.0];

/// A steady motion.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Steady {
    /// The car; the paper's if left out.
    #[serde(default)]
    vehicle: VehicleParameters,
    /// p, in m.
    point_distance_m: f64,
    /// Speed, in m/s.
    speed_m_s: f64,
    /// Error of `l_f` in the law, in m.
    deviation_m: f64,
    /// The largest speed of the map, in m/s.
    largest_speed_m_s: f64,
}

/// Eigenvalues at the steady motion, the Hopf curve over speed and dl, and the speeds from which on
/// the motion is unstable: of the paper's loop, and of the loop in ticks with the simulated car's
/// servo and delays.
fn map(steady: &Steady) -> Result<Value, Box<dyn Error>> {
    let Steady {
        vehicle,
        point_distance_m: p,
        speed_m_s: speed,
        deviation_m: deviation,
        ..
    } = *steady;
    vehicle.validate()?;
    let (law, belief) = (Law::FrontPoint, Belief::FrontAxle);
    let closed = ClosedLoop::new(vehicle, law, p, speed, deviation)?.believing(belief);
    let eigenvalues = closed.eigenvalues();
    let eigenvalues: Vec<_> = eigenvalues.iter().map(|it| [it.re, it.im]).collect();
    let mut hopf = Vec::new();
    for index in 1..=HOPF_SPEEDS {
        let speed = steady.largest_speed_m_s * f64::from(index) / f64::from(HOPF_SPEEDS);
        let points = hopf_points(vehicle, law, belief, p, speed)?;
        let ends = points.iter().filter(|it| it.ends_stability());
        hopf.extend(ends.map(|it| [it.deviation, speed]));
    }
    let servo = Servo {
        lag: 0.04,
        dead_time: 0.002,
    };
    // The timing of the simulated car, as `singletrack stability first-unstable-speed` has it.
    let timing = Timing {
        predicted_pose: 2,
        servo_frame: 2,
        ages: Ages {
            yaw_rate: 0.005,
            sideslip: 0.0,
        },
        servo: Some(servo),
        ..Timing::new(0.01, 0.007)
    };
    let sampled = SampledLoop::new(closed, timing)?;
    Ok(json!({
        "eigenvalues": eigenvalues,
        "stable": closed.is_stable(),
        "hopf": hopf,
        "meaningful_m": ClosedLoop::meaningful_deviations(&vehicle),
        "critical_speed_m_s": critical_speed(vehicle, p, [deviation; 2])?,
        "first_unstable_speed_m_s": first_unstable_speed(&sampled, &[deviation], SEARCHED_SPEEDS)?,
    }))
}
