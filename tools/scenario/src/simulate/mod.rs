//! Closed loops in virtual time, from a scenario file to a trajectory.

mod car;
mod ideal;
mod scenario;
mod summary;

use std::{fmt, path::Path};

use singletrack_control::{CalibrationEstimate, Singularity, Velocity};
use singletrack_core::config::{ConfigError, TuningRule};
use singletrack_pilot::{Arming, PilotRequest, Tuning};
use singletrack_record::Digest;
use singletrack_settings::{check, section};

use crate::{
    tracking::TrackingError,
    virtual_drive::{VirtualDrive, VirtualDriveError},
    virtual_record::VirtualRecordError,
};

pub use car::{Progress, RunOptions, ScenarioRun, simulate_configured, virtual_drive_config};
pub use scenario::{
    ControlSection, MarkerLoss, PlantKind, PlantSection, RunSection, Scenario, ScenarioError,
    StartSection, SteeringHold,
};
pub use singletrack_sim::integrator::IntegrationError;
pub use summary::{CalibrationLine, HEADER, Row, Summary, trim_zeros, write_csv};

/// A moment of the trajectory, in s.
const MOMENT: core::ops::RangeInclusive<f64> = 0.0..=86_400.0;

/// Why a simulation stopped.
#[derive(Debug, thiserror::Error)]
pub enum SimulateError {
    /// The scenario can't be simulated.
    #[error(transparent)]
    Scenario(#[from] ScenarioError),
    /// On the ideal plant, the law has no solution.
    #[error("at t = {time} s: {source}")]
    Law {
        /// When, in s.
        time: f64,
        /// Why.
        source: Singularity,
    },
    /// The equations of the ideal plant have no solution.
    #[error(
        "{0}; the paper's model needs a car that moves forward, use plant kind \"car\" for one that stops"
    )]
    Integration(#[from] IntegrationError),
    /// The car can't be simulated, or did not start.
    #[error(transparent)]
    Drive(#[from] VirtualDriveError),
    /// The record could not be written.
    #[error(transparent)]
    Record(#[from] VirtualRecordError),
    /// The ideal plant has no pilot from which this could come.
    #[error("there is {0}: plant.kind is \"ideal\", which has no pilot; use \"car\"")]
    NoPilot(&'static str),
}

impl From<ConfigError> for SimulateError {
    fn from(error: ConfigError) -> Self {
        ScenarioError::from(error).into()
    }
}

impl fmt::Display for Simulation {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match (&self.summary, self.tracking_error) {
            (Some(summary), _) => summary.fmt(formatter),
            (None, Some(error)) => error.fmt(formatter),
            (None, None) => Ok(()),
        }
    }
}

/// The result of a scenario.
#[derive(Clone, Debug, Default)]
pub struct Simulation {
    /// The trajectory.
    pub rows: Vec<Row>,
    /// Notes for the user.
    pub notes: Vec<String>,
    /// How far P was from its reference, in the rows in which the car follows it.
    pub tracking_error: Option<TrackingError>,
    /// What the drive came to; none on the ideal plant.
    pub summary: Option<Summary>,
    /// What the drive says about the calibration; empty if `online_calibration.mode` is "off".
    pub estimates: Vec<CalibrationEstimate>,
    /// The digest of the drive, if it was asked for.
    pub digest: Option<Digest>,
}

/// Runs a scenario on the plant that it names.
///
/// # Errors
///
/// The reason why the scenario can't be run.
pub fn simulate(scenario: &Scenario) -> Result<Simulation, SimulateError> {
    simulate_with(scenario, RunOptions::default())
}

/// Like [`simulate`], with options.
///
/// # Errors
///
/// The errors of [`simulate`] and [`simulate_recorded`]; the plant is ideal and a summary is
/// wanted.
pub fn simulate_with(
    scenario: &Scenario,
    options: RunOptions<'_>,
) -> Result<Simulation, SimulateError> {
    match scenario.plant.kind {
        PlantKind::Ideal if options.record.is_some() => {
            Err(SimulateError::NoPilot("nothing to record"))
        }
        PlantKind::Ideal if options.summary => Err(SimulateError::NoPilot("no summary")),
        PlantKind::Ideal if options.digest => Err(SimulateError::NoPilot("no digest")),
        PlantKind::Ideal => {
            let rows = ideal::simulate(scenario)?;
            let distances: Vec<_> = rows.iter().map(Row::distance_from_reference).collect();
            Ok(Simulation {
                rows,
                tracking_error: TrackingError::of(&distances),
                ..Simulation::default()
            })
        }
        PlantKind::Car => {
            let (daemon, simulation) = virtual_drive_config(scenario)?;
            simulate_configured(scenario, &daemon, &simulation, options)
        }
    }
}

/// Like [`simulate`], and writes a record of the drive to `path`.
///
/// # Errors
///
/// The errors of [`simulate`]; the plant is ideal and has no pilot; the file exists or
/// can't be written.
pub fn simulate_recorded(scenario: &Scenario, path: &Path) -> Result<Simulation, SimulateError> {
    let options = RunOptions {
        record: Some(path),
        ..RunOptions::default()
    };
    simulate_with(scenario, options)
}

section! {
    /// A request to tune the pilot, as by `singletrack tune`, any number of times; `[tuning]` must
    /// allow it.
    "tune" => pub TuneSection: Copy;
    [];

    /// When.
    at_s: f64;
    /// Gains along x and y.
    gain_per_s: Option<[f64; 2]> = None;
    /// The distance p.
    point_distance_m: Option<f64> = None;
}

impl TuneSection {
    /// The values.
    pub fn tuning(&self) -> Tuning {
        Tuning {
            gain: self.gain_per_s.map(|[x, y]| Velocity::new(x, y)),
            point_distance: self.point_distance_m,
        }
    }

    /// Refuses a time that does not exist, and values that the daemon would refuse.
    pub(super) fn validate(&self, rule: &TuningRule) -> Result<(), ScenarioError> {
        let at_s = self.at_s;
        check("tune.at_s", &at_s, &MOMENT)?;
        rule.check(&self.tuning(), None)
            .map_err(|error| ScenarioError::tune(at_s, &error))
    }
}

section! {
    /// What the operator does, and what happens to the board's cable. Times, also those of
    /// `[truth]`, count from the first driving tick, or, with `arm = false`, from switching the car
    /// on.
    "operator" => pub OperatorSection: Copy;
    [default];

    /// Time from switching the car on until the daemon reaches the board. The ESC is ready by then,
    /// and the board is not yet configured.
    daemon_after_s: f64 = 2.0, in 0.0..=10.0;
    /// Arms the car once, as soon as it is ready; false: never.
    arm: bool = true;
    /// Requests an emergency stop.
    emergency_stop_at_s: Option<f64> = None, in MOMENT;
    /// Requests to stop and disarm.
    disarm_at_s: Option<f64> = None, in MOMENT;
    /// Requests to arm once more.
    arm_again_at_s: Option<f64> = None, in MOMENT;
    /// Pulls the USB cable: bytes stop in both directions, and the board loses its power unless
    /// `truth.board.own_supply`.
    unplug_at_s: Option<f64> = None, in MOMENT;
    /// Plugs it in again.
    plug_at_s: Option<f64> = None, in MOMENT;
    /// Presses the board's reset: no pulses until its bootloader has ended.
    reset_board_at_s: Option<f64> = None, in MOMENT;
}

/// What an operator does.
#[derive(Clone, Copy, Debug)]
enum Action {
    Ask(PilotRequest),
    Tune(Tuning),
    Connect(bool),
    ResetBoard,
}

/// An operator during a run.
#[derive(Debug)]
pub(super) struct Operator {
    /// What is still to be done, the next last.
    to_do: Vec<(f64, Action)>,
    /// The cable has been pulled.
    pub(super) has_unplugged: bool,
}

impl Operator {
    pub(super) fn new(section: &OperatorSection, tunes: &[TuneSection]) -> Self {
        let arm = PilotRequest::Arm(Arming::Unattended);
        let ask = |at_s: Option<f64>, request| (at_s, Action::Ask(request));
        let actions = [
            ask(section.emergency_stop_at_s, PilotRequest::EmergencyStop),
            ask(section.disarm_at_s, PilotRequest::Disarm),
            ask(section.arm_again_at_s, arm),
            (section.unplug_at_s, Action::Connect(false)),
            (section.plug_at_s, Action::Connect(true)),
            (section.reset_board_at_s, Action::ResetBoard),
        ];
        let actions = actions.into_iter();
        let timed = actions.filter_map(|(at_s, action)| Some((at_s?, action)));
        let tunes = tunes.iter();
        let tunes = tunes.map(|tune| (tune.at_s, Action::Tune(tune.tuning())));
        let mut to_do: Vec<_> = timed.chain(tunes).collect();
        to_do.sort_by(|(a, _), (b, _)| b.total_cmp(a));
        Self {
            to_do,
            has_unplugged: false,
        }
    }

    /// Does what is due at a time of the run, in s.
    pub(super) fn act(&mut self, drive: &mut VirtualDrive, time: f64) -> Result<(), ScenarioError> {
        const BUSY: &str = "leave time between requests";
        let busy = || ScenarioError::value("operator", "busy", BUSY);
        while let Some(&(at_s, action)) = self.to_do.last().filter(|(at, _)| *at <= time + 1e-9) {
            self.to_do.pop();
            match action {
                Action::Ask(request) => drive.request(request).map_err(|_| busy())?,
                Action::Tune(tuning) => drive
                    .host()
                    .tune(tuning)
                    .map_err(|error| ScenarioError::tune(at_s, &error))?,
                Action::Connect(connected) => {
                    self.has_unplugged = !connected;
                    drive.world.set_cable(connected);
                }
                Action::ResetBoard => drive.world.press_reset(),
            }
        }
        Ok(())
    }
}
