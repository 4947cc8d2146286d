//! When the car may drive, and when it must stop.
//!
//! [`Supervisor::step`] runs once per tick, after the events of the tick. It is the
//! only code that changes the mode. The module `checks` holds the checks that the table
//! names; [`SupervisorConfig`] holds their limits.
//!
//! | from | to | when | request to the board |
//! |---|---|---|---|
//! | any | `Fault` | an emergency stop is requested, also without a link | `EmergencyStop` |
//! | `Driving` | `Fault` | the law is singular ([`Supervisor::fault`]) | `Disarm` |
//! | any | `Fault` | the car does not slow down at the end of a drive ([`Supervisor::stop_not_obeyed`]) | `EmergencyStop` |
//! | any but `Fault` | `Disconnected` | the link is not ready | |
//! | `Disconnected`, `Idle`, `Ready` | `Idle` | the arming check fails | `Disarm`, if one is requested and the board is armed |
//! | `Disconnected`, `Idle`, `Ready` | `Ready` | the arming check passes | |
//! | `Disconnected`, `Idle`, `Ready` | `Arming` | it passes in the tick that has an arm request | `Arm` |
//! | `Disconnected`, `Idle`, `Ready` | `Arming` | the check for jogging passes in the tick that has a request to jog | `Arm` |
//! | `Arming` | `Driving` | the board reports that it is armed | |
//! | `Arming` | `Jogging` | the same, after a request to jog | |
//! | `Jogging` | `Idle` | a disarm request, a failed check for jogging, or [`JOG_TIMEOUT`] without pulses | `Disarm` |
//! | `Arming` | `Idle` | a disarm request, a refusal, a failed check, or `arm_timeout` | `Disarm` |
//! | `Driving` | `Slowing` | the last pose is older than `hold` or `hold_distance` | |
//! | `Slowing` | `Driving` | three fresh poses have come | |
//! | `Driving`, `Slowing` | `Stopping` | a disarm request, the end of the reference, a failed driving check, or a pose beyond `blind` or `blind_distance` | |
//! | `Stopping` | `Idle` | the car stands, or `stop_timeout` | `Disarm` |
//! | `Driving`, `Slowing`, `Stopping` | `Idle` | the last pose is older than `disarm_age` | `Disarm` |
//! | `Driving`, `Slowing`, `Stopping` | `Idle` | the operator's dead-man switch is lost (`Halt`) | `Disarm` |
//! | `Driving`, `Slowing`, `Stopping`, `Jogging` | `Idle` | the board has stopped the car by itself | |
//! | `Arming`, `Driving`, `Slowing`, `Stopping`, `Jogging` | `Fault` | the board has latched an emergency stop | |
//! | `Fault` | `Idle` | a disarm request while the board is not latched | `Disarm` |
//! | `Fault` | `Idle` | the board was latched and has been reset | |
//!
//! A stop that was not obeyed is cleared by a disarm request after the car stands, and by
//! nothing else.
//!
//! `Arming` is reached by an explicit request only. The request is judged in its tick
//! and not kept. A disarm in the same tick wins over an arm.

mod checks;
mod reason;

pub use checks::{BoardRequest, Conditions, Mode, SupervisorConfig};
pub use reason::Reason;

use singletrack_control::Time;

use crate::event::{Arming, BoardState, Event, PilotRequest, PoseMissing};
use checks::LatestState;

/// The time between the command to stand and the disarm of a car that the cameras do
/// not see, s. Its wheels may still turn: a motor at neutral needs no commands, and the
/// pose behind them only grows older.
pub const REST: f64 = 0.1;

/// Time, in s, that a board with a kill output takes from its answer to armed: the ESC
/// starts at neutral, for 2 s.
const POWER_UP: f64 = 2.5;

/// The number of poses after which a slowing car drives on: a single one may be of
/// another body.
const POSES_TO_GO_ON: u32 = 3;

/// The longest time between two renewals of a held drive, s.
const HOLD_TIMEOUT: f64 = 0.5;

/// The longest time between two pulses of the operator while jogging, s. Nothing else
/// renews it: the last pulses must not outlive the hand that gave them.
pub const JOG_TIMEOUT: f64 = 0.25;

/// The state machine of the modes.
#[derive(Clone, Debug, PartialEq)]
pub struct Supervisor {
    mode: Mode,
    reason: Option<Reason>,
    /// Why the last drive, or the last attempt to arm, ended.
    ended: Option<Reason>,
    /// Why an arm request would be refused now.
    preflight: Option<Reason>,
    /// A contradiction that nobody has acknowledged yet.
    unacknowledged: Option<Reason>,
    /// When the mode began.
    since: Time,
    /// Since when a stopping car has been commanded to stand.
    resting: Option<Time>,
    latest: LatestState,
    /// The number of accepted poses when the car began to slow down.
    poses_before: u32,
    /// Whether the board has reported a latched emergency stop since the fault began.
    latched: bool,
    heard: Heard,
    /// Whether the board is armed to jog, and not to drive.
    jogs: bool,
    /// The tick that saw the last renewal; `None` unless the drive is held.
    held: Option<Time>,
}

/// What was asked and answered since the last step.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Heard {
    arm: Option<Arming>,
    stop: Option<Reason>,
    emergency: bool,
    /// Whether the stop is to be at neutral at once.
    halt: bool,
    /// Whether the board refused to arm.
    refused: bool,
    /// Whether the operator has renewed the drive.
    hold: bool,
    /// Whether the operator has given pulses.
    jog: bool,
}

impl Supervisor {
    /// A supervisor in [`Mode::Disconnected`], before any event.
    pub fn new(config: SupervisorConfig) -> Self {
        Self {
            mode: Mode::Disconnected,
            reason: Some(Reason::LinkDown),
            ended: None,
            preflight: Some(Reason::LinkDown),
            unacknowledged: None,
            since: Time(0),
            resting: None,
            latest: LatestState::new(config),
            poses_before: 0,
            latched: false,
            heard: Heard::default(),
            jogs: false,
            held: None,
        }
    }

    /// The mode after the last step.
    pub const fn mode(&self) -> Mode {
        self.mode
    }

    /// Why the car does not drive; after a drive, why it stopped.
    pub const fn reason(&self) -> Option<Reason> {
        self.reason
    }

    /// Why an arm request would be refused now; `None` if it would not, or while a drive is
    /// underway.
    pub const fn preflight(&self) -> Option<Reason> {
        self.preflight
    }

    /// Whether the board runs the host's configuration.
    pub(crate) const fn is_linked(&self) -> bool {
        self.latest.check_link().is_none()
    }

    /// Whether a contradiction waits for its acknowledgement.
    pub const fn is_contradicted(&self) -> bool {
        self.unacknowledged.is_some()
    }

    /// The tick at which the mode began.
    pub const fn since(&self) -> Time {
        self.since
    }

    /// Replaces the limits from the next step on. The state of board and line and the
    /// reason why the last drive ended are kept.
    pub const fn reconfigure(&mut self, config: SupervisorConfig) {
        self.latest.config = config;
    }

    /// Takes what an event says of board, line and system, or what it asks for; all requests are
    /// judged in the next step. Telemetry and poses count as judged by the caller, see
    /// [`Self::handle_board`] and [`Self::handle_pose`].
    pub fn handle(&mut self, event: &Event) {
        let latest = &mut self.latest;
        match event {
            // Unless it is ready, the state of board and line is forgotten: the next board may be
            // another one.
            Event::Link(link) => latest.set_link(*link),
            Event::Health(health) => latest.set_health(*health),
            Event::Line(line) => latest.line = Some(*line),
            Event::RealTime(state) => latest.real_time = Some(*state),
            // It holds until the next accepted pose.
            Event::PoseMissing(PoseMissing::Untrustworthy) => latest.untrustworthy = true,
            // It counts only in `Mode::Arming`.
            Event::ArmRefused => self.heard.refused = true,
            Event::Request(request) => self.handle_request(*request),
            // It is too late to arm the car.
            Event::Begin(_) if !matches!(self.mode, Mode::Driving | Mode::Slowing) => {
                self.request_stop(Reason::BoardTimeout);
            }
            Event::Jog(_) => self.heard.jog = true,
            _ => {}
        }
    }

    /// Telemetry shows the state of the board's safety machine.
    pub const fn handle_board(&mut self, board: BoardState) {
        self.latest.board = Some(board);
    }

    /// The estimator accepted a pose.
    pub const fn handle_pose(&mut self) {
        self.latest.untrustworthy = false;
    }

    const fn handle_request(&mut self, request: PilotRequest) {
        match request {
            PilotRequest::Arm(arming) => self.heard.arm = Some(arming),
            PilotRequest::Hold => self.heard.hold = true,
            PilotRequest::Disarm | PilotRequest::Carried => self.request_stop(Reason::Requested),
            PilotRequest::OperatorGone => self.request_stop(Reason::OperatorGone),
            PilotRequest::TimeUp => self.request_stop(Reason::TimeUp),
            PilotRequest::Halt => {
                self.request_stop(Reason::OperatorGone);
                self.heard.halt = true;
            }
            PilotRequest::EmergencyStop => self.heard.emergency = true,
        }
    }

    const fn request_stop(&mut self, reason: Reason) {
        // Of several, an explicit disarm counts: only that acknowledges a fault.
        if !matches!(self.heard.stop, Some(Reason::Requested)) {
            self.heard.stop = Some(reason);
        }
        // A stop revokes an arm before it.
        self.heard.arm = None;
    }

    /// Runs the checks, changes the mode by the table of the module, and returns what to
    /// ask of the board.
    pub fn step(&mut self, conditions: &Conditions) -> Option<BoardRequest> {
        let heard = core::mem::take(&mut self.heard);
        let mut stop = heard.stop;
        let now = conditions.now;
        self.latest.begin_tick(now);
        let jogging = self.mode == Mode::Jogging;
        if self.held.is_some() && (heard.jog || (heard.hold && !jogging)) {
            self.held = Some(now);
        }
        let longest = if jogging { JOG_TIMEOUT } else { HOLD_TIMEOUT };
        if let Some(held) = self.held
            && now.seconds_since(held) > longest
        {
            stop = stop.or(Some(Reason::OperatorGone));
        }

        if heard.emergency {
            // Also without a link: the session repeats it until the board confirms it.
            self.latched = false;
            // A stop that was not obeyed is worse.
            let worse = self
                .reason
                .filter(|&reason| self.mode == Mode::Fault && reason == Reason::StopNotObeyed);
            self.enter(Mode::Fault, worse.or(Some(Reason::EmergencyStop)), now);
            return Some(BoardRequest::EmergencyStop);
        }
        if self.mode == Mode::Fault {
            return self.fault_step(stop == Some(Reason::Requested), conditions);
        }
        let unlinked = self.latest.check_link();
        if unlinked.is_some() {
            self.enter(Mode::Disconnected, unlinked, now);
            return None;
        }
        if heard.halt && self.mode.commands() {
            if self.follow_stopped_board(now) {
                return None;
            }
            return self.disarm(stop.or(Some(Reason::OperatorGone)), now);
        }
        match self.mode {
            Mode::Disconnected | Mode::Idle | Mode::Ready => {
                self.standing_step(heard.arm, stop, conditions)
            }
            Mode::Arming => self.arming_step(stop, heard.refused, conditions),
            Mode::Driving | Mode::Slowing => self.driving_step(stop, conditions),
            Mode::Stopping => self.stopping_step(conditions),
            Mode::Jogging => self.jogging_step(stop, conditions),
            Mode::Fault => None,
        }
    }

    /// Enters [`Mode::Fault`] at once, because the controller has no command for this
    /// state. Returns the request to the board.
    pub fn fault(&mut self, reason: Reason, now: Time) -> BoardRequest {
        self.latched = false;
        self.enter(Mode::Fault, Some(reason), now);
        BoardRequest::Disarm
    }

    /// Enters [`Mode::Fault`], because the car does not slow down at neutral. Returns the
    /// request to the board.
    pub fn stop_not_obeyed(&mut self, now: Time) -> BoardRequest {
        self.latched = false;
        self.enter(Mode::Fault, Some(Reason::StopNotObeyed), now);
        BoardRequest::EmergencyStop
    }

    /// Follows a car that something else drives, from here on; true if a drive begins.
    pub fn observe(&mut self, drives: bool, now: Time) -> bool {
        let begins = drives && self.mode != Mode::Driving;
        let mode = if drives { Mode::Driving } else { Mode::Idle };
        self.enter(mode, None, now);
        begins
    }

    /// What would end the observed drive; none outside one.
    #[must_use]
    pub fn observed(&mut self, conditions: &Conditions) -> Option<Reason> {
        self.latest.begin_tick(conditions.now);
        let drives = self.mode == Mode::Driving;
        let reason = drives.then(|| self.latest.check_while_observed(conditions));
        let too_far = drives && conditions.blind_distance > self.latest.config.blind_distance;
        reason.flatten().or(too_far.then_some(Reason::BlindTooFar))
    }

    fn fault_step(&mut self, stop: bool, conditions: &Conditions) -> Option<BoardRequest> {
        let now = conditions.now;
        if self.reason == Some(Reason::StopNotObeyed) {
            // A reset of the board does not clear it: the car may still run.
            let cleared = stop && conditions.stands;
            if cleared {
                self.enter(Mode::Idle, self.reason, now);
            }
            return cleared.then_some(BoardRequest::Disarm);
        }
        let board = self.latest.board;
        let latched = self.latest.latched().is_some();
        self.latched |= latched;
        let board_was_reset =
            self.latched && matches!(board, Some(BoardState::Booting | BoardState::Neutral));
        if (stop && !latched) || board_was_reset {
            self.latched = false;
            self.enter(Mode::Idle, self.reason, now);
            return stop.then_some(BoardRequest::Disarm);
        }
        None
    }

    fn standing_step(
        &mut self,
        arm: Option<Arming>,
        stop: Option<Reason>,
        conditions: &Conditions,
    ) -> Option<BoardRequest> {
        let now = conditions.now;
        let board = self.latest.board;
        if stop == Some(Reason::Requested) {
            self.unacknowledged = None;
        }
        let armed = board.is_some_and(BoardState::is_armed);
        let request = (stop.is_some() && armed).then_some(BoardRequest::Disarm);
        let check = self
            .unacknowledged
            .or_else(|| self.latest.arming_check(conditions));
        if arm == Some(Arming::Jog) {
            let refused = self
                .unacknowledged
                .or_else(|| self.latest.jogging_check(conditions));
            if refused.is_none() {
                return Some(self.begin_arming(Arming::Jog, now));
            }
            // No request to drive: what forbids that is in `preflight` alone.
            self.enter(Mode::Idle, refused, now);
            self.preflight = check;
            return request;
        }
        let Some(failed) = check else {
            if let Some(arming) = arm {
                return Some(self.begin_arming(arming, now));
            }
            self.enter(Mode::Ready, self.ended, now);
            return None;
        };
        // While the car only settles, the reason why the last drive ended stays
        // in place, except in the tick of a refused arm request.
        let settling = matches!(
            failed,
            Reason::Moving | Reason::ImuNotStill | Reason::EstimateUnsettled | Reason::BoardArmed
        );
        let ended = self.ended.filter(|_| settling && arm.is_none());
        self.enter(Mode::Idle, ended.or(check), now);
        self.preflight = check;
        request
    }

    fn begin_arming(&mut self, arming: Arming, now: Time) -> BoardRequest {
        self.ended = None;
        self.enter(Mode::Arming, None, now);
        self.held = (arming != Arming::Unattended).then_some(now);
        self.jogs = arming == Arming::Jog;
        BoardRequest::Arm
    }

    fn arming_step(
        &mut self,
        stop: Option<Reason>,
        refused: bool,
        conditions: &Conditions,
    ) -> Option<BoardRequest> {
        let now = conditions.now;
        let latched = self.latest.latched();
        if stop.is_none() && latched.is_some() {
            self.enter(Mode::Fault, latched, now);
            return None;
        }
        let check = || match self.jogs {
            true => self.latest.check_while_arming_to_jog(conditions),
            false => self.latest.check_while_arming(conditions),
        };
        let failed = stop
            .or(refused.then_some(Reason::BoardRefused))
            .or_else(check);
        let armed = self.latest.board == Some(BoardState::Armed);
        let late = !armed && now.seconds_since(self.since) > self.arm_timeout();
        let failed = failed.or(late.then_some(Reason::BoardTimeout));
        if failed.is_some() {
            return self.disarm(failed, now);
        }
        if armed && self.jogs {
            self.held = Some(now);
            self.enter(Mode::Jogging, None, now);
        } else if armed {
            self.enter(Mode::Driving, None, now);
        }
        None
    }

    /// The longest time that the board may take, s: longer once it switches the supply on.
    fn arm_timeout(&self) -> f64 {
        let powering_up = self.latest.board == Some(BoardState::PoweringUp);
        self.latest.config.arm_timeout + if powering_up { POWER_UP } else { 0.0 }
    }

    fn disarm(&mut self, reason: Option<Reason>, now: Time) -> Option<BoardRequest> {
        self.enter(Mode::Idle, reason, now);
        Some(BoardRequest::Disarm)
    }

    fn driving_step(
        &mut self,
        stop: Option<Reason>,
        conditions: &Conditions,
    ) -> Option<BoardRequest> {
        let now = conditions.now;
        if self.follow_stopped_board(now) {
            return None;
        }
        let reason = if stop.is_some() {
            stop
        } else if conditions.reference_finished {
            Some(Reason::ReferenceFinished)
        } else {
            self.latest.check_while_driving(conditions)
        };
        let contradicts = |reason: &Reason| reason.contradicts_proof();
        self.unacknowledged = conditions
            .contradiction
            .or(conditions.implausible_motion.filter(contradicts))
            .or(self.unacknowledged);
        if self.must_disarm(conditions) {
            return self.disarm(reason.or(Some(Reason::PoseTooOld)), now);
        }
        let too_far = conditions.blind_distance > self.latest.config.blind_distance;
        match reason.or(too_far.then_some(Reason::BlindTooFar)) {
            Some(reason) => self.enter(Mode::Stopping, Some(reason), now),
            None => match self.check_hold(conditions) {
                Some(reason) => {
                    if self.mode != Mode::Slowing {
                        self.poses_before = conditions.poses;
                    }
                    self.enter(Mode::Slowing, Some(reason), now);
                }
                None => self.enter(Mode::Driving, None, now),
            },
        }
        None
    }

    /// Why the car must slow down, or go on to slow down: the last pose is beyond `hold`
    /// or `hold_distance`, or a slowing car has not had [`POSES_TO_GO_ON`] fresh poses
    /// yet.
    fn check_hold(&self, conditions: &Conditions) -> Option<Reason> {
        let slowing = self.mode == Mode::Slowing;
        let max_age = if slowing {
            self.latest.config.fresh
        } else {
            self.latest.config.hold
        };
        let too_far = conditions.blind_distance > self.latest.config.hold_distance;
        // An estimate that was reset counts from zero.
        let since = conditions.poses.checked_sub(self.poses_before);
        let returned = since.unwrap_or(conditions.poses) >= POSES_TO_GO_ON;
        self.latest
            .check_pose(conditions, max_age)
            .or(too_far.then_some(Reason::BlindTooFar))
            .or(self.reason.filter(|_| slowing && !returned))
    }

    fn stopping_step(&mut self, conditions: &Conditions) -> Option<BoardRequest> {
        let now = conditions.now;
        if self.follow_stopped_board(now) {
            return None;
        }
        if conditions.commanded_speed != 0.0 {
            self.resting = None;
        }
        let resting = *self.resting.get_or_insert(now);
        let blind = self
            .latest
            .check_pose(conditions, self.latest.config.fresh)
            .is_some();
        let standing_speed = self.latest.config.standing_speed;
        let seen = conditions.camera_speed.unwrap_or(0.0);
        let stands = conditions.motor_speed.abs() < standing_speed && seen < standing_speed;
        let stands = conditions.commanded_speed == 0.0
            && (stands || (blind && now.seconds_since(resting) >= REST));
        let late = now.seconds_since(self.since) > self.latest.config.stop_timeout;
        if stands || late || self.must_disarm(conditions) {
            return self.disarm(self.reason, now);
        }
        None
    }

    /// There is no ramp: the motor goes to neutral at once.
    fn jogging_step(
        &mut self,
        stop: Option<Reason>,
        conditions: &Conditions,
    ) -> Option<BoardRequest> {
        let now = conditions.now;
        if self.follow_stopped_board(now) {
            return None;
        }
        let reason = stop.or_else(|| self.latest.check_while_jogging(conditions))?;
        self.disarm(Some(reason), now)
    }

    /// Whether the last pose is so old that the board would soon stop the car by itself.
    fn must_disarm(&self, conditions: &Conditions) -> bool {
        conditions
            .pose_time
            .is_some_and(|time| conditions.now.seconds_since(time) >= self.latest.config.disarm_age)
    }

    /// Leaves the drive if the board is no longer armed; true if so. There is nothing to
    /// ask of the board then.
    fn follow_stopped_board(&mut self, now: Time) -> bool {
        let follows = [BoardState::Armed, BoardState::Driving, BoardState::Jogging];
        if (self.latest.board).is_some_and(|board| follows.contains(&board)) {
            return false;
        }
        let (mode, reason) = match self.latest.latched() {
            Some(reason) => (Mode::Fault, reason),
            None => (Mode::Idle, Reason::BoardFailsafe),
        };
        self.enter(mode, Some(reason), now);
        true
    }

    fn enter(&mut self, mode: Mode, reason: Option<Reason>, now: Time) {
        let was_underway = self.mode.is_underway() || self.mode == Mode::Fault;
        let goes_on = matches!(mode, Mode::Driving | Mode::Slowing | Mode::Jogging);
        if (was_underway && !goes_on) || mode == Mode::Fault {
            self.ended = reason.or(self.ended);
        }
        if self.mode != mode {
            self.mode = mode;
            self.since = now;
            self.resting = None;
        }
        if !mode.is_underway() {
            self.held = None;
        }
        // The arming check of the next tick says what is left of it.
        self.preflight = reason.filter(|_| !mode.is_underway() && mode != Mode::Ready);
        self.reason = reason;
    }
}
