//! The modes of the pilot, the supervisor's limits, what it is given at a tick, and what it asks of the
//! board.

use singletrack_control::Time;
use singletrack_control::words;

use super::reason::Reason;
use crate::watch::ImuVerdict;

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
