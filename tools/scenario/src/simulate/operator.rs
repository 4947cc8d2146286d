//! Who drives the car of a scenario.

use serde::Deserialize;
use singletrack_pilot::{PilotRequest, Tuning};

use super::{error::ScenarioError, tune::TuneSection};
use crate::virtual_drive::VirtualDrive;

/// What the operator does, and what happens to the board's cable. Times are those of the
/// trajectory, in s: zero is the first driving tick; with `arm = false` it is the start of
/// the run.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct OperatorSection {
    /// The daemon reaches the board so long after the car was switched on, in s: an ESC
    /// is ready by then, and the board is not yet configured.
    pub daemon_after_s: f64,
    /// Arms the car as soon as it is ready.
    pub arm: bool,
    /// Requests an emergency stop.
    pub emergency_stop_at_s: Option<f64>,
    /// Requests to stop and disarm.
    pub disarm_at_s: Option<f64>,
    /// Asks to arm once more.
    pub arm_again_at_s: Option<f64>,
    /// Pulls the serial cable: bytes stop in both directions.
    pub unplug_at_s: Option<f64>,
    /// Plugs it in again.
    pub plug_at_s: Option<f64>,
    /// Presses the board's reset: its pins float until its bootloader has ended.
    pub reset_board_at_s: Option<f64>,
}

impl Default for OperatorSection {
    fn default() -> Self {
        Self {
            daemon_after_s: 2.0,
            arm: true,
            emergency_stop_at_s: None,
            disarm_at_s: None,
            arm_again_at_s: None,
            unplug_at_s: None,
            plug_at_s: None,
            reset_board_at_s: None,
        }
    }
}

/// What an operator does.
#[derive(Clone, Copy, Debug)]
enum Action {
    Ask(PilotRequest),
    Tune(Tuning),
    Connect(bool),
    ResetBoard,
}

impl OperatorSection {
    fn actions(&self) -> [(&'static str, Option<f64>, Action); 6] {
        [
            (
                "operator.emergency_stop_at_s",
                self.emergency_stop_at_s,
                Action::Ask(PilotRequest::EmergencyStop),
            ),
            (
                "operator.disarm_at_s",
                self.disarm_at_s,
                Action::Ask(PilotRequest::Disarm),
            ),
            (
                "operator.arm_again_at_s",
                self.arm_again_at_s,
                Action::Ask(PilotRequest::Arm),
            ),
            (
                "operator.unplug_at_s",
                self.unplug_at_s,
                Action::Connect(false),
            ),
            ("operator.plug_at_s", self.plug_at_s, Action::Connect(true)),
            (
                "operator.reset_board_at_s",
                self.reset_board_at_s,
                Action::ResetBoard,
            ),
        ]
    }

    /// Refuses times that do not exist.
    pub(super) fn validate(&self) -> Result<(), ScenarioError> {
        if !(0.0..=10.0).contains(&self.daemon_after_s) {
            return Err(ScenarioError::value(
                "operator.daemon_after_s",
                self.daemon_after_s,
                "it must lie between 0 and 10",
            ));
        }
        for (key, at_s, _) in self.actions() {
            if let Some(at_s) = at_s
                && !(0.0..=86_400.0).contains(&at_s)
            {
                return Err(ScenarioError::value(
                    key,
                    at_s,
                    "it must lie between 0 and 86400",
                ));
            }
        }
        Ok(())
    }
}

/// An operator during a run.
#[derive(Debug)]
pub(super) struct Operator {
    /// What is still to be done, the next last.
    to_do: Vec<(f64, Action)>,
    /// The cable has been pulled.
    has_unplugged: bool,
}

impl Operator {
    pub(super) fn new(section: &OperatorSection, tunes: &[TuneSection]) -> Self {
        let tunes = tunes
            .iter()
            .map(|tune| (tune.at_s, Action::Tune(tune.tuning())));
        let mut to_do: Vec<_> = section
            .actions()
            .into_iter()
            .filter_map(|(_, at_s, action)| Some((at_s?, action)))
            .chain(tunes)
            .collect();
        to_do.sort_by(|(a, _), (b, _)| b.total_cmp(a));
        Self {
            to_do,
            has_unplugged: false,
        }
    }

    /// Whether the cable has been pulled and not been plugged in again.
    pub(super) const fn has_unplugged(&self) -> bool {
        self.has_unplugged
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
                    .tune(tuning)
                    .map_err(|source| ScenarioError::Tune { at_s, source })?,
                Action::Connect(connected) => {
                    self.has_unplugged = !connected;
                    drive.world_mut().set_wire_connected(connected);
                }
                Action::ResetBoard => drive.world_mut().press_reset(),
            }
        }
        Ok(())
    }
}
