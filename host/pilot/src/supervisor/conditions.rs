//! What the supervisor is given at a tick, and what it asks of the board.

use singletrack_control::Time;
use singletrack_words::words;

use super::reason::Reason;
use crate::watch::ImuVerdict;

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
