//! When the car may drive, and when it must stop.

use core::fmt;

use crate::{BoardState, LinkState, PoseMissing, Request, Time};

/// What the pilot is doing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Mode {
    /// There is no board to talk to.
    Disconnected,
    /// Something is missing for a drive; the reason says what.
    Idle,
    /// Everything is there; waiting to be armed.
    Ready,
    /// Waiting for the board to arm.
    Arming,
    /// Following the reference.
    Driving,
    /// Slowing down to a stop, wheels held.
    Stopping,
    /// An emergency stop, or a state that can't be. A disarm request clears it;
    /// after an emergency stop so does a board that was reset.
    Fault,
}

impl Mode {
    /// The name of the mode in status, log and record.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Disconnected => "disconnected",
            Self::Idle => "idle",
            Self::Ready => "ready",
            Self::Arming => "arming",
            Self::Driving => "driving",
            Self::Stopping => "stopping",
            Self::Fault => "fault",
        }
    }
}

impl fmt::Display for Mode {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(self.name())
    }
}

/// Why the car does not drive, or stopped. One word in status, log and record.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Reason {
    /// No board answers, or it has another protocol, or refused the configuration.
    LinkDown,
    /// The board is starting up.
    BoardBooting,
    /// The board is still armed from before.
    BoardArmed,
    /// The board stopped the car by itself.
    BoardFailsafe,
    /// An emergency stop is latched until the board is reset.
    EmergencyStop,
    /// The board refused to arm.
    BoardRefused,
    /// The board did not answer in time.
    BoardTimeout,
    /// No inertial sample for too long.
    ImuSilent,
    /// No pose yet.
    NoPose,
    /// The last accepted pose is too old.
    PoseTooOld,
    /// Too many poses in a row were implausible.
    PoseImplausible,
    /// The estimate has not settled.
    EstimateUnsettled,
    /// The car moves before it was armed.
    Moving,
    /// The reference has come to its end.
    ReferenceFinished,
    /// Someone asked.
    Requested,
    /// The law has no answer at this state.
    LawSingular,
}

impl Reason {
    /// The name of the reason in status, log and record.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::LinkDown => "link-down",
            Self::BoardBooting => "board-booting",
            Self::BoardArmed => "board-armed",
            Self::BoardFailsafe => "board-failsafe",
            Self::EmergencyStop => "emergency-stop",
            Self::BoardRefused => "board-refused",
            Self::BoardTimeout => "board-timeout",
            Self::ImuSilent => "imu-silent",
            Self::NoPose => "no-pose",
            Self::PoseTooOld => "pose-too-old",
            Self::PoseImplausible => "pose-implausible",
            Self::EstimateUnsettled => "estimate-unsettled",
            Self::Moving => "moving",
            Self::ReferenceFinished => "reference-finished",
            Self::Requested => "requested",
            Self::LawSingular => "law-singular",
        }
    }
}

impl fmt::Display for Reason {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(self.name())
    }
}

/// The supervisor's time limits, in s.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SupervisorConfig {
    /// A pose older than this stops the car.
    pub hold: f64,
    /// A pose must be younger than this to arm.
    pub fresh: f64,
    /// No inertial sample for this long stops the car.
    pub imu_silence: f64,
    /// How long the board may take to arm.
    pub arm_timeout: f64,
    /// Poses that the estimate needs to settle.
    pub settling_poses: u32,
    /// This many implausible poses in a row stop the car.
    pub max_implausible: u32,
    /// Slowing down may take this long; then the board is disarmed anyway.
    pub stop_timeout: f64,
    /// Below this speed the car stands, m/s.
    pub standing_speed: f64,
}

impl SupervisorConfig {
    /// For the paper's car.
    #[must_use]
    pub const fn paper() -> Self {
        Self {
            hold: 0.3,
            fresh: 0.05,
            imu_silence: 0.1,
            arm_timeout: 0.5,
            settling_poses: 50,
            max_implausible: 20,
            stop_timeout: 1.5,
            standing_speed: 0.03,
        }
    }
}

/// What the supervisor asks of the board.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BoardRequest {
    /// Arm.
    Arm,
    /// Disarm.
    Disarm,
    /// Stop until reset.
    EmergencyStop,
}

/// What the supervisor judges by, at a tick.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Conditions {
    /// The tick's time.
    pub now: Time,
    /// Mid-exposure of the last accepted pose.
    pub pose_time: Option<Time>,
    /// Poses accepted so far.
    pub poses: u32,
    /// Poses in a row that were implausible.
    pub implausible: u32,
    /// When the last inertial sample was made.
    pub imu_time: Option<Time>,
    /// Speed of the car, m/s.
    pub speed: f64,
    /// Speed by the motor pulses, m/s.
    pub motor_speed: f64,
    /// The speed that the car was last told, m/s.
    pub commanded_speed: f64,
    /// Whether the reference has ended.
    pub reference_finished: bool,
}

/// The pilot's modes.
#[derive(Clone, Debug, PartialEq)]
pub struct Supervisor {
    config: SupervisorConfig,
    mode: Mode,
    reason: Option<Reason>,
    /// Why the last drive, or the attempt at one, ended.
    ended: Option<Reason>,
    since: Time,
    link: LinkState,
    board: Option<BoardState>,
    untrustworthy: bool,
    /// The board has been seen to latch the emergency stop.
    latched: bool,
    arm_requested: bool,
    stop_requested: bool,
    emergency_requested: bool,
    arm_refused: bool,
}

impl Supervisor {
    /// A supervisor without a board.
    #[must_use]
    pub const fn new(config: SupervisorConfig) -> Self {
        Self {
            config,
            mode: Mode::Disconnected,
            reason: Some(Reason::LinkDown),
            ended: None,
            since: Time(0),
            link: LinkState::Down,
            board: None,
            untrustworthy: false,
            latched: false,
            arm_requested: false,
            stop_requested: false,
            emergency_requested: false,
            arm_refused: false,
        }
    }

    /// The mode.
    #[must_use]
    pub const fn mode(&self) -> Mode {
        self.mode
    }

    /// Why the car does not drive; after a drive, why it stopped.
    #[must_use]
    pub const fn reason(&self) -> Option<Reason> {
        self.reason
    }

    /// When the mode began.
    #[must_use]
    pub const fn since(&self) -> Time {
        self.since
    }

    /// Takes note of the link.
    pub const fn handle_link(&mut self, link: LinkState) {
        self.link = link;
        if matches!(link, LinkState::Down) {
            self.board = None;
        }
    }

    /// Takes note of the board's state.
    pub const fn handle_board(&mut self, board: BoardState) {
        self.board = Some(board);
    }

    /// Takes note of the board's refusal to arm.
    pub const fn handle_arm_refused(&mut self) {
        self.arm_refused = true;
    }

    /// Takes note of a frame without a pose.
    pub const fn handle_pose_missing(&mut self, missing: PoseMissing) {
        if matches!(missing, PoseMissing::Untrustworthy) {
            self.untrustworthy = true;
        }
    }

    /// Takes note of a good pose.
    pub const fn handle_pose(&mut self) {
        self.untrustworthy = false;
    }

    /// Takes note of a request.
    pub const fn handle_request(&mut self, request: Request) {
        match request {
            Request::Arm => self.arm_requested = true,
            Request::Disarm => {
                self.stop_requested = true;
                // Whoever says stop last is obeyed.
                self.arm_requested = false;
            }
            Request::EmergencyStop => self.emergency_requested = true,
        }
    }

    /// Judges the tick's conditions and moves between modes.
    pub fn step(&mut self, conditions: &Conditions) -> Option<BoardRequest> {
        let arm = core::mem::take(&mut self.arm_requested);
        let stop = core::mem::take(&mut self.stop_requested);
        let emergency = core::mem::take(&mut self.emergency_requested);
        let refused = core::mem::take(&mut self.arm_refused);
        let now = conditions.now;

        if emergency {
            // Even without a link: it is repeated until the board confirms it.
            self.latched = false;
            self.enter(Mode::Fault, Some(Reason::EmergencyStop), now);
            return Some(BoardRequest::EmergencyStop);
        }
        if self.mode == Mode::Fault {
            return self.faulted(stop, now);
        }
        if self.link == LinkState::Down {
            self.enter(Mode::Disconnected, Some(Reason::LinkDown), now);
            return None;
        }
        match self.mode {
            Mode::Disconnected | Mode::Idle | Mode::Ready => self.wait(arm, stop, conditions),
            Mode::Arming => self.arming(stop, refused, conditions),
            Mode::Driving => self.driving(stop, conditions),
            Mode::Stopping => self.stopping(conditions),
            Mode::Fault => None,
        }
    }

    /// Stays stopped until somebody clears it.
    fn faulted(&mut self, stop: bool, now: Time) -> Option<BoardRequest> {
        let latched = self.board == Some(BoardState::EmergencyStopped);
        self.latched |= latched;
        let board_was_reset =
            self.latched && matches!(self.board, Some(BoardState::Booting | BoardState::Neutral));
        if (stop && !latched) || board_was_reset {
            self.enter(Mode::Idle, self.reason, now);
            return stop.then_some(BoardRequest::Disarm);
        }
        None
    }

    /// Stops at once: the controller has no answer.
    pub fn fault(&mut self, reason: Reason, now: Time) -> BoardRequest {
        self.enter(Mode::Fault, Some(reason), now);
        BoardRequest::Disarm
    }

    fn wait(&mut self, arm: bool, stop: bool, conditions: &Conditions) -> Option<BoardRequest> {
        let now = conditions.now;
        let armed = matches!(self.board, Some(BoardState::Armed | BoardState::Driving));
        match self.missing(conditions) {
            Some(missing) => {
                // What ended a drive stays told while the car comes to rest,
                // until something else is wrong.
                let settling = matches!(
                    missing,
                    Reason::Moving | Reason::EstimateUnsettled | Reason::BoardArmed
                );
                let told = self.ended.filter(|_| settling && !arm);
                self.enter(Mode::Idle, told.or(Some(missing)), now);
                (stop && armed).then_some(BoardRequest::Disarm)
            }
            None if arm => {
                self.ended = None;
                self.enter(Mode::Arming, None, now);
                Some(BoardRequest::Arm)
            }
            None => {
                self.enter(Mode::Ready, self.ended, now);
                None
            }
        }
    }

    /// The first thing that is missing for a drive.
    fn missing(&self, conditions: &Conditions) -> Option<Reason> {
        match self.board {
            None | Some(BoardState::Booting) => return Some(Reason::BoardBooting),
            Some(BoardState::EmergencyStopped) => return Some(Reason::EmergencyStop),
            Some(BoardState::Armed | BoardState::Driving) => return Some(Reason::BoardArmed),
            Some(BoardState::Neutral | BoardState::Failsafe) => {}
        }
        if let Some(reason) = self.blind(conditions, self.config.fresh) {
            return Some(reason);
        }
        if conditions.poses < self.config.settling_poses {
            return Some(Reason::EstimateUnsettled);
        }
        let standing = conditions.motor_speed.abs() < self.config.standing_speed
            && conditions.speed.abs() < self.config.standing_speed;
        if !standing {
            return Some(Reason::Moving);
        }
        None
    }

    /// What the senses lack, with poses no older than `pose_limit` seconds.
    fn blind(&self, conditions: &Conditions, pose_limit: f64) -> Option<Reason> {
        let age = |time: Time| conditions.now.seconds_since(time);
        if !conditions
            .imu_time
            .is_some_and(|time| age(time) <= self.config.imu_silence)
        {
            return Some(Reason::ImuSilent);
        }
        if self.untrustworthy || conditions.implausible >= self.config.max_implausible {
            return Some(Reason::PoseImplausible);
        }
        match conditions.pose_time {
            None => Some(Reason::NoPose),
            Some(time) if age(time) > pose_limit => Some(Reason::PoseTooOld),
            Some(_) => None,
        }
    }

    fn arming(
        &mut self,
        stop: bool,
        refused: bool,
        conditions: &Conditions,
    ) -> Option<BoardRequest> {
        let now = conditions.now;
        if stop {
            return self.give_up(Reason::Requested, now);
        }
        if self.board == Some(BoardState::EmergencyStopped) {
            self.enter(Mode::Fault, Some(Reason::EmergencyStop), now);
            return None;
        }
        if refused {
            return self.give_up(Reason::BoardRefused, now);
        }
        if let Some(reason) = self.blind(conditions, self.config.fresh) {
            return self.give_up(reason, now);
        }
        if self.board == Some(BoardState::Armed) {
            self.enter(Mode::Driving, None, now);
        } else if now.seconds_since(self.since) > self.config.arm_timeout {
            return self.give_up(Reason::BoardTimeout, now);
        }
        None
    }

    fn give_up(&mut self, reason: Reason, now: Time) -> Option<BoardRequest> {
        self.enter(Mode::Idle, Some(reason), now);
        Some(BoardRequest::Disarm)
    }

    fn driving(&mut self, stop: bool, conditions: &Conditions) -> Option<BoardRequest> {
        let now = conditions.now;
        if let Some(request) = self.board_stopped(now) {
            return request;
        }
        let reason = if stop {
            Some(Reason::Requested)
        } else if conditions.reference_finished {
            Some(Reason::ReferenceFinished)
        } else {
            self.blind(conditions, self.config.hold)
        };
        if let Some(reason) = reason {
            self.enter(Mode::Stopping, Some(reason), now);
        }
        None
    }

    fn stopping(&mut self, conditions: &Conditions) -> Option<BoardRequest> {
        let now = conditions.now;
        if let Some(request) = self.board_stopped(now) {
            return request;
        }
        let stands = conditions.commanded_speed == 0.0
            && conditions.motor_speed.abs() < self.config.standing_speed;
        if stands || now.seconds_since(self.since) > self.config.stop_timeout {
            self.enter(Mode::Idle, self.reason, now);
            return Some(BoardRequest::Disarm);
        }
        None
    }

    /// Follows a board that has stopped the car: nothing to ask of it then.
    fn board_stopped(&mut self, now: Time) -> Option<Option<BoardRequest>> {
        let reason = match self.board {
            Some(BoardState::Armed | BoardState::Driving) => return None,
            Some(BoardState::EmergencyStopped) => Reason::EmergencyStop,
            None | Some(BoardState::Booting | BoardState::Neutral | BoardState::Failsafe) => {
                Reason::BoardFailsafe
            }
        };
        let mode = if reason == Reason::EmergencyStop {
            Mode::Fault
        } else {
            Mode::Idle
        };
        self.enter(mode, Some(reason), now);
        Some(None)
    }

    fn enter(&mut self, mode: Mode, reason: Option<Reason>, now: Time) {
        let was_underway = matches!(
            self.mode,
            Mode::Arming | Mode::Driving | Mode::Stopping | Mode::Fault
        );
        if was_underway || mode == Mode::Fault {
            self.ended = reason.or(self.ended);
        }
        if self.mode != mode {
            self.mode = mode;
            self.since = now;
        }
        self.reason = reason;
    }
}
