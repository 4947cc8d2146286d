//! The operator of a scenario: when the car is armed, stopped and tuned.

use singletrack_control::Velocity;
use singletrack_core::config::TuningRule;
use singletrack_pilot::{Arming, PilotRequest, Tuning};
use singletrack_settings::{check, section};

use super::{MOMENT, error::ScenarioError};
use crate::virtual_drive::VirtualDrive;

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
    #[must_use]
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
            .map_err(|source| ScenarioError::Tune { at_s, source })
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

impl OperatorSection {
    const fn actions(&self) -> [(Option<f64>, Action); 6] {
        [
            (
                self.emergency_stop_at_s,
                Action::Ask(PilotRequest::EmergencyStop),
            ),
            (self.disarm_at_s, Action::Ask(PilotRequest::Disarm)),
            (
                self.arm_again_at_s,
                Action::Ask(PilotRequest::Arm(Arming::Unattended)),
            ),
            (self.unplug_at_s, Action::Connect(false)),
            (self.plug_at_s, Action::Connect(true)),
            (self.reset_board_at_s, Action::ResetBoard),
        ]
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
            .filter_map(|(at_s, action)| Some((at_s?, action)))
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
                    drive.world_mut().set_cable(connected);
                }
                Action::ResetBoard => drive.world_mut().press_reset(),
            }
        }
        Ok(())
    }
}
