//! The modes, the limits, what is given at a tick and what is asked of the board; the latest state of board,
//! line, computer and cameras, and the checks that refuse or end a drive.
//!
//! Every check returns the first reason against a drive, `None` if there is none. The
//! order of the checks decides which of several reasons status, log and record show.

use singletrack_control::{Time, words};

use super::reason::Reason;
use crate::{
    event::{BoardHealth, BoardState, LineHealth, LinkState, RealTimeState},
    watch::{ImuVerdict, count},
};

words! {
    /// The mode of the pilot. The table of transitions is in `supervisor`.
    #[derive(Default)]
    pub enum Mode {
        /// There is no usable link to a board.
        #[default]
        Disconnected = 1 "disconnected",
        /// The arming check fails; the reason is why, or why the last drive ended.
        Idle = 2 "idle",
        /// The arming check passes; the pilot waits for an arm request.
        Ready = 3 "ready",
        /// The board has been asked to arm.
        Arming = 4 "arming",
        /// The car follows the reference.
        Driving = 5 "driving",
        /// The last pose is too old to drive with: the speed ramps down, the steering is
        /// held. The drive goes on if fresh poses come in time.
        Slowing = 8 "slowing",
        /// The speed ramps down to zero, the steering is held; then the board is disarmed.
        /// The next drive needs an arm request.
        Stopping = 6 "stopping",
        /// An emergency stop, or a state at which the law is singular. A disarm request
        /// clears it, unless the board is still latched. After an emergency stop, a reset of
        /// the board clears it too.
        Fault = 7 "fault",
        /// Servo and ESC get the operator's bare pulses, for as long as they are renewed.
        Jogging = 9 "jogging",
    }
}

impl Mode {
    /// Whether a drive is underway: the car may move, and no configuration is replaced.
    pub const fn is_underway(self) -> bool {
        matches!(
            self,
            Self::Arming | Self::Driving | Self::Slowing | Self::Stopping | Self::Jogging
        )
    }

    /// Whether the pilot sends commands to the board.
    pub const fn commands(self) -> bool {
        matches!(
            self,
            Self::Driving | Self::Slowing | Self::Stopping | Self::Jogging
        )
    }
}

/// The supervisor's limits, in SI units.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SupervisorConfig {
    /// The longest age of a pose to drive with, from its mid-exposure, s. Beyond it the
    /// car slows down.
    pub hold: f64,
    /// The farthest that the car may go without a pose before it slows down, m: at
    /// speed, `hold` alone would let it go too far.
    pub hold_distance: f64,
    /// The age of the last pose at which a slowing car stops for good, s.
    pub blind: f64,
    /// The distance without a pose at which a slowing car stops for good, m.
    pub blind_distance: f64,
    /// The longest age of a pose to arm, and for a slowing car to drive on, s.
    pub fresh: f64,
    /// The longest time without an inertial sample, s.
    pub imu_silence: f64,
    /// To arm, the yaw rate must have been below this for 20 samples, rad/s...
    pub still_yaw_rate: f64,
    /// ...and the acceleration below this, m/s².
    pub still_acceleration: f64,
    /// The longest time that the board may take to arm, s.
    pub arm_timeout: f64,
    /// The number of accepted poses after which the estimate has settled.
    pub settling_poses: u32,
    /// The number of implausible poses in a row that stops the car.
    pub max_implausible: u32,
    /// The longest time for a stop, s; then the board is disarmed in any case.
    pub stop_timeout: f64,
    /// The car stands below this speed, m/s.
    pub standing_speed: f64,
    /// The lowest battery voltage to drive with, V; 0 disables the check.
    pub min_battery: f64,
    /// The lowest battery voltage to arm with, V; 0 disables the check.
    pub arm_battery: f64,
    /// The largest fraction of damaged frames, in either direction, 0 to 1.
    pub max_damaged: f64,
    /// The age of the last pose at which the board is disarmed in any case, s: before the
    /// board stops the car by itself.
    pub disarm_age: f64,
    /// Whether a configuration is proved on the first metre that it drives on a car.
    pub prove: bool,
    /// Whether the car may drive only with real-time scheduling and locked memory.
    pub require_real_time: bool,
}

impl SupervisorConfig {
    /// For the paper's car.
    pub const fn paper() -> Self {
        Self {
            hold: 0.3,
            hold_distance: 0.15,
            blind: 0.6,
            blind_distance: 0.45,
            fresh: 0.05,
            imu_silence: 0.1,
            still_yaw_rate: 0.1,
            still_acceleration: 1.0,
            arm_timeout: 0.5,
            settling_poses: 50,
            max_implausible: 20,
            stop_timeout: 1.5,
            standing_speed: 0.03,
            min_battery: 6.4,
            arm_battery: 6.8,
            max_damaged: 0.5,
            disarm_age: 0.91,
            prove: true,
            require_real_time: false,
        }
    }
}

words! {
    /// What the supervisor asks of the board.
    pub enum BoardRequest {
        /// Take drive commands from now on.
        Arm = 1 "arm",
        /// Put the motor to neutral; an arm request may follow.
        Disarm = 2 "disarm",
        /// Put the motor to neutral until the board is reset.
        EmergencyStop = 3 "emergency-stop",
    }
}

/// The state of car, sensors and reference at a tick.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Conditions {
    /// The tick's time.
    pub now: Time,
    /// Mid-exposure of the last accepted pose.
    pub pose_time: Option<Time>,
    /// The farthest that the car may have gone since then, m.
    pub blind_distance: f64,
    /// The number of poses accepted since the estimate started.
    pub poses: u32,
    /// The number of implausible poses in a row.
    pub implausible: u32,
    /// When the last inertial sample was measured.
    pub imu_time: Option<Time>,
    /// Whether the inertial samples are plausible.
    pub imu: ImuVerdict,
    /// Whether the IMU has measured no movement for a while.
    pub imu_still: bool,
    /// The estimated speed of the car, m/s.
    pub speed: f64,
    /// The speed of the rear axle from the motor pulses, m/s.
    pub motor_speed: f64,
    /// The speed that the cameras alone measure, m/s; `None` without recent poses.
    pub camera_speed: Option<f64>,
    /// Whether the car is known to stand, by every sensor that measures its speed.
    pub stands: bool,
    /// What forbids to arm, besides the checks of the supervisor.
    pub preflight: Option<Reason>,
    /// What forbids to arm and to drive, besides the checks of the supervisor.
    pub doubt: Option<Reason>,
    /// What ends a drive, besides the checks of the supervisor.
    pub implausible_motion: Option<Reason>,
    /// What the sensors of an unproved car contradict each other in. It ends a drive, and
    /// the next one needs an acknowledgement.
    pub contradiction: Option<Reason>,
    /// Whether motor pulses and cameras measure different speeds.
    pub speed_mismatch: bool,
    /// Whether the car is faster than its limit by more than the margin.
    pub overspeed: bool,
    /// The speed of the last drive command, m/s.
    pub commanded_speed: f64,
    /// Why the safety filter ends the drive.
    pub filter: Option<Reason>,
    /// Whether the car is inside the geofence and can stop there.
    pub inside_fence: bool,
    /// What other rigid bodies are in the way, or unknown.
    pub neighbours: Option<Reason>,
    /// Whether ticks come too late.
    pub late: bool,
    /// Whether the reference is external and its last set-point is too old.
    pub setpoint_stale: bool,
    /// Whether the reference has ended.
    pub reference_finished: bool,
}

/// Above this speed a car moves while its board arms, m/s: more than noise and a first
/// pulse.
const MOVES_WHILE_ARMING: f64 = 0.1;

/// The longest time without a status message of the board, s: five of its periods.
/// Beyond it the state of battery and stop switch is unknown.
const HEALTH_SILENCE: f64 = 1.0;

/// The number of low reports in a row that make a low battery, 0.6 s: the voltage sags
/// when the car starts off.
const BATTERY_LOW_REPORTS: u32 = 3;

/// The number of reports in a row of an error of the IMU that end a drive, 0.2 s apart: its registers
/// come over a bus without checksum, and one wrong bit makes "fusion runs" (5) an "error" (1).
const IMU_FAULT_REPORTS: u32 = 2;

/// The battery's voltage, in V.
fn volts(health: &BoardHealth) -> f64 {
    f64::from(health.battery_mv) / 1_000.0
}

/// The latest value of every event that describes a state, and the limits for it.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct LatestState {
    pub(super) config: SupervisorConfig,
    link: LinkState,
    /// The state of the board's safety machine; `None` before the first telemetry.
    pub(super) board: Option<BoardState>,
    health: Option<BoardHealth>,
    /// Whether a status message has come since the last tick.
    health_heard: bool,
    /// The tick that saw the last status message.
    health_time: Time,
    /// Reports in a row of a battery too low to drive with.
    battery_low: u32,
    /// Reports in a row of an error of the IMU.
    imu_fault: u32,
    pub(super) line: Option<LineHealth>,
    pub(super) real_time: Option<RealTimeState>,
    /// Whether the cameras' session has locked the rigid body out.
    pub(super) untrustworthy: bool,
}

impl LatestState {
    pub(super) const fn new(config: SupervisorConfig) -> Self {
        Self {
            config,
            link: LinkState::Down,
            board: None,
            health: None,
            health_heard: false,
            health_time: Time(0),
            battery_low: 0,
            imu_fault: 0,
            line: None,
            real_time: None,
            untrustworthy: false,
        }
    }

    pub(super) const fn set_link(&mut self, link: LinkState) {
        self.link = link;
        if !matches!(link, LinkState::Ready) {
            // The next board may be another one.
            self.board = None;
            self.health = None;
            self.imu_fault = 0;
            self.line = None;
        }
    }

    pub(super) fn set_health(&mut self, health: BoardHealth) {
        self.health = Some(health);
        self.health_heard = true;
        count(
            &mut self.battery_low,
            volts(&health) < self.config.min_battery,
        );
        count(&mut self.imu_fault, health.imu_fault);
    }

    /// Dates a status message that has come since the last tick.
    pub(super) fn begin_tick(&mut self, now: Time) {
        if core::mem::take(&mut self.health_heard) {
            self.health_time = now;
        }
    }

    /// The reason of a stop that the board has latched until it is reset.
    pub(super) const fn latched(&self) -> Option<Reason> {
        match self.board {
            Some(BoardState::EmergencyStopped) => Some(Reason::EmergencyStop),
            Some(BoardState::RunsAtNeutral) => Some(Reason::RunsAtNeutral),
            _ => None,
        }
    }

    /// The link, as a reason for [`Mode::Disconnected`].
    pub(super) const fn check_link(&self) -> Option<Reason> {
        match self.link {
            LinkState::Down => Some(Reason::LinkDown),
            LinkState::VersionDiffers => Some(Reason::VersionDiffers),
            LinkState::ConfigurationRefused => Some(Reason::ConfigurationRefused),
            LinkState::EmergencyStopped => Some(Reason::EmergencyStop),
            LinkState::Ready => None,
        }
    }

    /// Whether the board can be asked to arm.
    const fn check_board(&self) -> Option<Reason> {
        match self.board {
            None | Some(BoardState::Booting) => Some(Reason::BoardBooting),
            Some(board) if board.is_armed() => Some(Reason::BoardArmed),
            Some(_) => self.latched(),
        }
    }

    /// The arming check: everything that must hold before the board is asked to arm.
    pub(super) fn arming_check(&self, conditions: &Conditions) -> Option<Reason> {
        // The estimated speed of a car at rest is noisier than that of the cameras: it follows an
        // accelerometer that is believed to shake. A NaN moves.
        let seen = conditions.camera_speed.unwrap_or(conditions.speed);
        let standing = conditions.motor_speed.abs() < self.config.standing_speed
            && seen.abs() < self.config.standing_speed
            && conditions.speed.abs() <= MOVES_WHILE_ARMING;
        self.check_board()
            .or_else(|| self.check_health_to_arm(conditions.now))
            .or_else(|| self.check_imu_health(1))
            .or_else(|| self.check_imu(conditions))
            .or_else(|| self.check_pose(conditions, self.config.fresh))
            .or_else(|| {
                let unsettled = conditions.poses < self.config.settling_poses;
                unsettled.then_some(Reason::EstimateUnsettled)
            })
            .or_else(|| (!standing).then_some(Reason::Moving))
            .or_else(|| (!conditions.imu_still).then_some(Reason::ImuNotStill))
            .or_else(|| check_fence_and_deadlines(conditions))
            .or(conditions.doubt)
            .or(conditions.preflight)
    }

    /// The arming check for jogging: poses, IMU, geofence and reference do not matter.
    pub(super) fn jogging_check(&self, conditions: &Conditions) -> Option<Reason> {
        // A NaN moves.
        let standing = conditions.motor_speed.abs() < self.config.standing_speed;
        self.check_board()
            .or_else(|| self.check_health_to_arm(conditions.now))
            .or_else(|| (!standing).then_some(Reason::Moving))
            .or_else(|| conditions.late.then_some(Reason::DeadlineMissed))
    }

    /// What must still hold while the board arms for jogging.
    pub(super) fn check_while_arming_to_jog(&self, conditions: &Conditions) -> Option<Reason> {
        let rests = conditions.motor_speed.abs() <= MOVES_WHILE_ARMING;
        self.check_health_to_arm(conditions.now)
            .or_else(|| (!rests).then_some(Reason::Moving))
            .or_else(|| conditions.late.then_some(Reason::DeadlineMissed))
    }

    /// What must hold while jogging; else the motor goes to neutral.
    pub(super) fn check_while_jogging(&self, conditions: &Conditions) -> Option<Reason> {
        self.check_health(conditions.now)
            .or_else(|| conditions.late.then_some(Reason::DeadlineMissed))
    }

    /// What must still hold while the board arms.
    pub(super) fn check_while_arming(&self, conditions: &Conditions) -> Option<Reason> {
        // No command has been given yet: a throttle that is stuck drives at once when a kill
        // output switches the supply on. A NaN moves.
        let rests = conditions.motor_speed.abs() <= MOVES_WHILE_ARMING
            && conditions.speed.abs() <= MOVES_WHILE_ARMING;
        self.check_health_to_arm(conditions.now)
            .or_else(|| self.check_imu_health(1))
            .or_else(|| (!rests).then_some(Reason::Moving))
            .or_else(|| self.check_imu(conditions))
            .or_else(|| self.check_pose(conditions, self.config.fresh))
            .or_else(|| check_fence_and_deadlines(conditions))
            .or(conditions.doubt)
            .or(conditions.preflight)
    }

    /// What must hold while the car drives; else it stops.
    pub(super) fn check_while_driving(&self, conditions: &Conditions) -> Option<Reason> {
        self.check_health(conditions.now)
            .or_else(|| self.check_drive(conditions))
    }

    /// What must hold of a car that something else drives: without the board's status, if there
    /// has never been one.
    pub(super) fn check_while_observed(&self, conditions: &Conditions) -> Option<Reason> {
        let told = self.health.is_some() && self.real_time.is_some();
        let health = told.then(|| self.check_health(conditions.now));
        health.flatten().or_else(|| self.check_drive(conditions))
    }

    fn check_drive(&self, conditions: &Conditions) -> Option<Reason> {
        self.check_imu_health(IMU_FAULT_REPORTS)
            .or_else(|| self.check_imu(conditions))
            .or_else(|| self.check_pose(conditions, self.config.blind))
            .or_else(|| check_fence_and_deadlines(conditions))
            .or(conditions.filter)
            .or(conditions.contradiction)
            .or(conditions.doubt)
            .or(conditions.implausible_motion)
            .or(match conditions {
                _ if conditions.speed_mismatch => Some(Reason::MotorSpeedMismatch),
                _ if conditions.overspeed => Some(Reason::Overspeed),
                _ => None,
            })
    }

    /// [`check_health`](Self::check_health) with the battery limit for arming, which is
    /// higher: the battery must last for a drive.
    fn check_health_to_arm(&self, now: Time) -> Option<Reason> {
        self.check_health(now).or_else(|| {
            let health = self.health?;
            let least = self.config.arm_battery;
            match volts(&health) < least {
                _ if least > 0.0 && health.battery_open => Some(Reason::BatteryOpen),
                low => low.then_some(Reason::BatteryLow),
            }
        })
    }

    /// Stop switch, battery, real-time grants and serial line.
    fn check_health(&self, now: Time) -> Option<Reason> {
        let config = &self.config;
        let heard = now.seconds_since(self.health_time) <= HEALTH_SILENCE;
        let Some(health) = self.health.filter(|_| heard) else {
            return Some(Reason::BatteryUnknown);
        };
        let refused = |granted: RealTimeState| !(granted.fifo && granted.memory_locked);
        let is_refused = self.real_time.is_some_and(refused);
        let is_noisy = (self.line).is_some_and(|line| line.worst() > config.max_damaged);
        if health.stop_input_open {
            Some(Reason::StopInputOpen)
        } else if config.min_battery > 0.0 && health.battery_open {
            Some(Reason::BatteryOpen)
        } else if self.battery_low >= BATTERY_LOW_REPORTS {
            Some(Reason::BatteryLow)
        } else if self.real_time.is_none() {
            Some(Reason::RealTimeUnknown)
        } else if config.require_real_time && is_refused {
            Some(Reason::RealTimeRefused)
        } else {
            is_noisy.then_some(Reason::LineNoisy)
        }
    }

    /// What the IMU reports of itself, in this number of reports in a row.
    fn check_imu_health(&self, reports: u32) -> Option<Reason> {
        (self.imu_fault >= reports).then_some(Reason::ImuFault)
    }

    /// The poses: plausible, and the last accepted one no older than `max_age` (s).
    pub(super) fn check_pose(&self, conditions: &Conditions, max_age: f64) -> Option<Reason> {
        if self.untrustworthy || conditions.implausible >= self.config.max_implausible {
            return Some(Reason::PoseImplausible);
        }
        match conditions.pose_time {
            None => Some(Reason::NoPose),
            Some(time) if conditions.now.seconds_since(time) > max_age => Some(Reason::PoseTooOld),
            Some(_) => None,
        }
    }

    /// The inertial samples: recent and plausible.
    fn check_imu(&self, conditions: &Conditions) -> Option<Reason> {
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
}

/// The geofence, other rigid bodies, the timing of the ticks, and the age of an external set-point.
const fn check_fence_and_deadlines(conditions: &Conditions) -> Option<Reason> {
    if !conditions.inside_fence {
        Some(Reason::OutsideFence)
    } else if conditions.neighbours.is_some() {
        conditions.neighbours
    } else if conditions.late {
        Some(Reason::DeadlineMissed)
    } else if conditions.setpoint_stale {
        Some(Reason::SetpointStale)
    } else {
        None
    }
}
