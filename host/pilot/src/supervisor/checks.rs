//! The latest state of board, line, computer and cameras, and the checks that refuse
//! or end a drive.
//!
//! Every check returns the first reason against a drive, `None` if there is none. The
//! order of the checks decides which of several reasons status, log and record show.

use singletrack_control::Time;

use super::{
    conditions::{Conditions, SupervisorConfig},
    reason::Reason,
};
use crate::{
    event::{BoardHealth, BoardState, LineHealth, LinkState, RealTimeState},
    watch::{ImuVerdict, count},
};

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

    /// The link, as a reason for [`super::Mode::Disconnected`].
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
