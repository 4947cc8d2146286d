//! When the car may drive, and when it must stop.

mod config;
mod mode;
mod reason;

use singletrack_control::Time;

use crate::{
    BoardHealth, BoardState, ImuVerdict, LineHealth, LinkState, PoseMissing, RealTimeState,
    Request, words::words,
};

pub use config::SupervisorConfig;
pub use mode::Mode;
pub use reason::Reason;

words! {
    /// What the supervisor asks of the board.
    pub enum BoardRequest {
        /// Arm.
        Arm = "arm",
        /// Disarm.
        Disarm = "disarm",
        /// Stop until reset.
        EmergencyStop = "emergency-stop",
    }
}

/// What the supervisor judges by, at a tick.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Conditions {
    /// The tick's time.
    pub now: Time,
    /// Mid-exposure of the last accepted pose.
    pub pose_time: Option<Time>,
    /// How far the car may have gone since, m.
    pub blind_distance: f64,
    /// Poses accepted so far.
    pub poses: u32,
    /// Poses in a row that were implausible.
    pub implausible: u32,
    /// When the last inertial sample was made.
    pub imu_time: Option<Time>,
    /// What to think of the inertial samples.
    pub imu: ImuVerdict,
    /// Whether the IMU has felt no movement for a while.
    pub imu_still: bool,
    /// Speed of the car, m/s.
    pub speed: f64,
    /// Speed by the motor pulses, m/s.
    pub motor_speed: f64,
    /// Whether motor and cameras tell different speeds.
    pub speed_mismatch: bool,
    /// Whether the car is much faster than it may be.
    pub overspeed: bool,
    /// The speed that the car was last told, m/s.
    pub commanded_speed: f64,
    /// Whether the car is inside the fence and can stop there.
    pub inside_fence: bool,
    /// Whether ticks came too late.
    pub late: bool,
    /// Whether set-points are to come from outside and do not.
    pub setpoint_stale: bool,
    /// Whether the reference has ended.
    pub reference_finished: bool,
}

/// How long a car that is not seen must have been told to stand before the board
/// is disarmed although its wheels still turn, s: a car that coasts needs no
/// commands, and the last pose behind them does not get younger.
const REST: f64 = 0.1;

/// A board that has not told its health for so long is not known to be well, s:
/// five of its reports.
const HEALTH_SILENCE: f64 = 1.0;

/// So many reports in a row make a low battery, 0.6 s: it sags when the car
/// starts off.
const BATTERY_LOW_REPORTS: u32 = 3;

/// So many poses must have come before a car that slows down drives on: one alone
/// may be of anything.
const POSES_TO_GO_ON: u32 = 3;

/// The battery's voltage, in V.
fn volts(health: &BoardHealth) -> f64 {
    f64::from(health.battery_mv) / 1_000.0
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
    /// Since when a stopping car has been told to stand.
    resting: Option<Time>,
    link: LinkState,
    board: Option<BoardState>,
    health: Option<BoardHealth>,
    /// Whether the board has told its health since the last tick, and when it did.
    health_heard: bool,
    health_time: Time,
    /// Reports in a row of a battery too low to drive with.
    battery_low: u32,
    line: Option<LineHealth>,
    real_time: Option<RealTimeState>,
    /// Poses accepted when the car began to slow down.
    poses_before: u32,
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
            resting: None,
            link: LinkState::Down,
            board: None,
            health: None,
            health_heard: false,
            health_time: Time(0),
            battery_low: 0,
            line: None,
            real_time: None,
            poses_before: 0,
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

    /// Other limits, from now on. What it knows of the world and why the last
    /// drive ended stays.
    pub const fn reconfigure(&mut self, config: SupervisorConfig) {
        self.config = config;
    }

    /// Takes note of the link.
    pub const fn handle_link(&mut self, link: LinkState) {
        self.link = link;
        if !matches!(link, LinkState::Ready) {
            // What it said may have been another board's.
            self.board = None;
            self.health = None;
            self.line = None;
        }
    }

    /// Takes note of what the board says of itself.
    pub fn handle_health(&mut self, health: BoardHealth) {
        self.health = Some(health);
        self.health_heard = true;
        self.battery_low = if volts(&health) < self.config.min_battery {
            self.battery_low.saturating_add(1)
        } else {
            0
        };
    }

    /// Takes note of how well frames cross the line.
    pub const fn handle_line(&mut self, line: LineHealth) {
        self.line = Some(line);
    }

    /// Takes note of what the system granted.
    pub const fn handle_real_time(&mut self, state: RealTimeState) {
        self.real_time = Some(state);
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
        if core::mem::take(&mut self.health_heard) {
            self.health_time = now;
        }

        if emergency {
            // Even without a link: it is repeated until the board confirms it.
            self.latched = false;
            self.enter(Mode::Fault, Some(Reason::EmergencyStop), now);
            return Some(BoardRequest::EmergencyStop);
        }
        if self.mode == Mode::Fault {
            return self.faulted(stop, now);
        }
        let unlinked = match self.link {
            LinkState::Down => Some(Reason::LinkDown),
            LinkState::VersionDiffers => Some(Reason::VersionDiffers),
            LinkState::ConfigurationRefused => Some(Reason::ConfigurationRefused),
            LinkState::EmergencyStopped => Some(Reason::EmergencyStop),
            LinkState::Ready => None,
        };
        if unlinked.is_some() {
            self.enter(Mode::Disconnected, unlinked, now);
            return None;
        }
        match self.mode {
            Mode::Disconnected | Mode::Idle | Mode::Ready => self.wait(arm, stop, conditions),
            Mode::Arming => self.arming(stop, refused, conditions),
            Mode::Driving | Mode::Slowing => self.driving(stop, conditions),
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
            self.latched = false;
            self.enter(Mode::Idle, self.reason, now);
            return stop.then_some(BoardRequest::Disarm);
        }
        None
    }

    /// Stops at once: the controller has no answer.
    pub fn fault(&mut self, reason: Reason, now: Time) -> BoardRequest {
        self.latched = false;
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
                    Reason::Moving
                        | Reason::ImuNotStill
                        | Reason::EstimateUnsettled
                        | Reason::BoardArmed
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
        let standing = conditions.motor_speed.abs() < self.config.standing_speed
            && conditions.speed.abs() < self.config.standing_speed;
        self.unfit_to_start(conditions.now)
            .or_else(|| self.senseless(conditions))
            .or_else(|| self.unseen(conditions, self.config.fresh))
            .or_else(|| {
                let unsettled = conditions.poses < self.config.settling_poses;
                unsettled.then_some(Reason::EstimateUnsettled)
            })
            .or_else(|| (!standing).then_some(Reason::Moving))
            .or_else(|| (!conditions.imu_still).then_some(Reason::ImuNotStill))
            .or_else(|| self.astray(conditions))
    }

    /// What board, line and computer lack for a drive to begin.
    fn unfit_to_start(&self, now: Time) -> Option<Reason> {
        let low = |health: BoardHealth| volts(&health) < self.config.arm_battery;
        self.unfit(now).or_else(|| {
            let low = self.health.is_some_and(low);
            low.then_some(Reason::BatteryLow)
        })
    }

    /// What they lack for a drive to go on.
    fn unfit(&self, now: Time) -> Option<Reason> {
        let config = &self.config;
        let heard = now.seconds_since(self.health_time) <= HEALTH_SILENCE;
        let Some(health) = self.health.filter(|_| heard) else {
            return Some(Reason::BatteryUnknown);
        };
        if health.stop_input_open {
            return Some(Reason::StopInputOpen);
        }
        if self.battery_low >= BATTERY_LOW_REPORTS {
            return Some(Reason::BatteryLow);
        }
        match self.real_time {
            None => return Some(Reason::RealTimeUnknown),
            Some(granted) if !(granted.fifo && granted.memory_locked) => {
                if config.require_real_time {
                    return Some(Reason::RealTimeRefused);
                }
            }
            Some(_) => {}
        }
        self.line
            .is_some_and(|line| line.worst() > config.max_damaged)
            .then_some(Reason::LineNoisy)
    }

    /// What the IMU lacks.
    fn senseless(&self, conditions: &Conditions) -> Option<Reason> {
        let heard = conditions
            .imu_time
            .is_some_and(|time| conditions.now.seconds_since(time) <= self.config.imu_silence);
        match conditions.imu {
            _ if !heard => Some(Reason::ImuSilent),
            ImuVerdict::Stuck => Some(Reason::ImuStuck),
            ImuVerdict::Implausible => Some(Reason::ImuImplausible),
            ImuVerdict::Good => None,
        }
    }

    /// What the cameras lack, with poses no older than `pose_limit` seconds.
    fn unseen(&self, conditions: &Conditions, pose_limit: f64) -> Option<Reason> {
        if self.untrustworthy || conditions.implausible >= self.config.max_implausible {
            return Some(Reason::PoseImplausible);
        }
        match conditions.pose_time {
            None => Some(Reason::NoPose),
            Some(time) if conditions.now.seconds_since(time) > pose_limit => {
                Some(Reason::PoseTooOld)
            }
            Some(_) => None,
        }
    }

    /// Where the car should not be, and what nobody tells it.
    fn astray(&self, conditions: &Conditions) -> Option<Reason> {
        if !conditions.inside_fence {
            Some(Reason::OutsideFence)
        } else if conditions.late {
            Some(Reason::DeadlineMissed)
        } else if conditions.setpoint_stale {
            Some(Reason::SetpointStale)
        } else {
            None
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
        let missing = self
            .unfit_to_start(now)
            .or_else(|| self.senseless(conditions))
            .or_else(|| self.unseen(conditions, self.config.fresh))
            .or_else(|| self.astray(conditions));
        if let Some(reason) = missing {
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
            self.unfit(now)
                .or_else(|| self.senseless(conditions))
                .or_else(|| self.unseen(conditions, self.config.blind))
                .or_else(|| self.astray(conditions))
                .or(match conditions {
                    _ if conditions.speed_mismatch => Some(Reason::MotorSpeedMismatch),
                    _ if conditions.overspeed => Some(Reason::Overspeed),
                    _ => None,
                })
        };
        let too_far = conditions.blind_distance > self.config.blind_distance;
        match reason.or(too_far.then_some(Reason::BlindTooFar)) {
            Some(reason) => self.enter(Mode::Stopping, Some(reason), now),
            None => match self.blind(conditions) {
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

    /// Whether the car has not been seen for longer, or farther, than a pose may
    /// be held. A car that has begun to slow down wants fresh ones.
    fn blind(&self, conditions: &Conditions) -> Option<Reason> {
        let slowing = self.mode == Mode::Slowing;
        let limit = if slowing {
            self.config.fresh
        } else {
            self.config.hold
        };
        let too_far = conditions.blind_distance > self.config.hold_distance;
        // An estimate that began anew counts from zero.
        let since = conditions.poses.checked_sub(self.poses_before);
        let returned = since.unwrap_or(conditions.poses) >= POSES_TO_GO_ON;
        self.unseen(conditions, limit)
            .or(too_far.then_some(Reason::BlindTooFar))
            .or(self.reason.filter(|_| slowing && !returned))
    }

    fn stopping(&mut self, conditions: &Conditions) -> Option<BoardRequest> {
        let now = conditions.now;
        if let Some(request) = self.board_stopped(now) {
            return request;
        }
        if conditions.commanded_speed != 0.0 {
            self.resting = None;
        }
        let resting = *self.resting.get_or_insert(now);
        let unseen = self.unseen(conditions, self.config.fresh).is_some();
        let stands = conditions.commanded_speed == 0.0
            && (conditions.motor_speed.abs() < self.config.standing_speed
                || (unseen && now.seconds_since(resting) >= REST));
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
            Mode::Arming | Mode::Driving | Mode::Slowing | Mode::Stopping | Mode::Fault
        );
        if (was_underway && !matches!(mode, Mode::Driving | Mode::Slowing)) || mode == Mode::Fault {
            self.ended = reason.or(self.ended);
        }
        if self.mode != mode {
            self.mode = mode;
            self.since = now;
            self.resting = None;
        }
        self.reason = reason;
    }
}
