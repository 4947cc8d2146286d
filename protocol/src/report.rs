//! Answers and records of the board.

use serde::{Deserialize, Serialize};

use crate::{Sequence, fixint_array};

/// State of the board's safety state machine.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum BoardMode {
    /// ESC held at neutral for two seconds so that it arms, after a start and after
    /// a change of the neutral pulse.
    Boot,
    /// ESC neutral; ready to be configured and armed.
    Neutral,
    /// Armed, no [`crate::Drive`] accepted yet; ESC neutral.
    Armed,
    /// Following [`crate::Drive`] commands.
    Driving,
    /// Stopped by the board itself until an explicit [`crate::Arm`].
    Failsafe,
    /// Stopped by an emergency stop until a reset.
    EmergencyStopped,
}

/// Cause of the last stop.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum StopCause {
    /// No stop since the start.
    None,
    /// The host sent [`crate::Disarm`].
    Disarmed,
    /// The last command exceeded its time to live.
    CommandTimeout,
    /// The pose behind the commands exceeded the configured age.
    PoseTooOld,
    /// No motor pulse while driven beyond the deadband.
    MotorSensor,
    /// The stop switch opened.
    StopInput,
    /// The host sent [`crate::EmergencyStop`].
    EmergencyStop,
    /// The host restarted (a [`crate::Hello`] while armed).
    HostRestarted,
}

/// Reason for refusing a request or a command.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum RefusalReason {
    /// No refusal so far.
    None,
    /// The board has no configuration.
    NotConfigured,
    /// The configuration on the board differs from the one in the request.
    ConfigurationDiffers,
    /// A value of the configuration is outside its limits.
    InvalidConfiguration,
    /// Not possible while armed or driving.
    Busy,
    /// The ESC has not been at neutral for long enough.
    NotYetNeutral,
    /// The wheels are turning.
    Moving,
    /// The stop switch is open.
    StopInputOpen,
    /// An emergency stop is latched until a reset.
    EmergencyStopLatched,
    /// The command exceeds its time to live, or lies in the future.
    Stale,
    /// The sequence number is not newer than the last one accepted.
    OutOfSequence,
    /// The pose behind the command is older than configured.
    PoseTooOld,
    /// The board is not armed.
    NotArmed,
    /// Reverse is not enabled.
    ReverseDisabled,
    /// The last [`crate::Hello`] named another [`crate::VERSION`].
    VersionDiffers,
}

/// Kind of request in an answer.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Request {
    /// [`crate::Configure`].
    Configure,
    /// [`crate::Arm`].
    Arm,
    /// [`crate::Disarm`].
    Disarm,
    /// [`crate::EmergencyStop`].
    EmergencyStop,
}

/// The board has executed a request.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Acknowledgement {
    /// The kind of request.
    pub request: Request,
    /// Number of the request.
    pub sequence: Sequence,
    /// Hash of the configuration in force; zero for none.
    #[serde(with = "postcard::fixint::le")]
    pub configuration_hash: u32,
}

/// The board refuses a request.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Refusal {
    /// The kind of request.
    pub request: Request,
    /// Number of the request.
    pub sequence: Sequence,
    /// Reason of the refusal.
    pub reason: RefusalReason,
}

/// State of the IMU's samples.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum ImuState {
    /// No sample yet, or none for 50 ms; the values are those of the last one.
    Silent,
    /// A new sample.
    Fresh,
    /// The same sample as in the record before.
    Repeated,
}

/// Measurements for control, at 100 Hz.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Telemetry {
    /// Board time of this record, in µs, wrapping.
    #[serde(with = "postcard::fixint::le")]
    pub board_time_us: u32,
    /// State of the safety state machine.
    pub mode: BoardMode,
    /// Cause of the last stop.
    pub stop_cause: StopCause,
    /// The last accepted [`crate::Drive`].
    pub last_sequence: Sequence,
    /// Whether the IMU values are new.
    pub imu: ImuState,
    /// Age of the IMU sample at `board_time_us`, in units of 100 µs, saturating.
    pub imu_age_100us: u8,
    /// Acceleration without gravity along the car's axes (forward, left, up), in mm/s².
    #[serde(with = "fixint_array")]
    pub linear_acceleration_mm_s2: [i16; 3],
    /// Angular velocity about the car's axes (forward, left, up), in mrad/s.
    #[serde(with = "fixint_array")]
    pub angular_velocity_mrad_s: [i16; 3],
    /// Attitude as a unit quaternion w, x, y, z, scaled by 2^14.
    #[serde(with = "fixint_array")]
    pub attitude_q14: [i16; 4],
    /// Speed measured from the motor pulses, in mm/s; signed by the direction driven.
    #[serde(with = "postcard::fixint::le")]
    pub motor_speed_mm_s: i16,
    /// Servo pulse, in µs; zero while the servo is silent.
    #[serde(with = "postcard::fixint::le")]
    pub servo_us: u16,
    /// ESC pulse, in µs.
    #[serde(with = "postcard::fixint::le")]
    pub esc_us: u16,
}

/// Cause of the last reset.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum ResetCause {
    /// Power-on.
    PowerOn,
    /// The reset pin: the button, or the host opening the port.
    External,
    /// Supply voltage too low.
    BrownOut,
    /// Watchdog timeout.
    Watchdog,
    /// Not known to the board.
    Unknown,
}

/// Diagnostics at 5 Hz. Counters wrap.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Status {
    /// Board time of this record, in µs, wrapping.
    #[serde(with = "postcard::fixint::le")]
    pub board_time_us: u32,
    /// Hash of the configuration in force; zero for none.
    #[serde(with = "postcard::fixint::le")]
    pub configuration_hash: u32,
    /// Cause of the last reset.
    pub reset_cause: ResetCause,
    /// Whether the stop switch is open, if one is configured.
    pub stop_input_open: bool,
    /// Battery voltage, in mV.
    #[serde(with = "postcard::fixint::le")]
    pub battery_mv: u16,
    /// Valid frames received.
    #[serde(with = "postcard::fixint::le")]
    pub frames_received: u16,
    /// Frames with an error in CRC, COBS, type, length or contents.
    #[serde(with = "postcard::fixint::le")]
    pub frames_damaged: u16,
    /// [`crate::Drive`] commands refused.
    #[serde(with = "postcard::fixint::le")]
    pub drives_refused: u16,
    /// Reason of the last such refusal; [`RefusalReason::None`] if none.
    pub last_refusal: RefusalReason,
    /// Frames dropped because the line was full.
    #[serde(with = "postcard::fixint::le")]
    pub frames_dropped: u16,
    /// Bytes lost by the board's receiver.
    #[serde(with = "postcard::fixint::le")]
    pub bytes_overrun: u16,
    /// Errors on the bus to the IMU.
    #[serde(with = "postcard::fixint::le")]
    pub imu_errors: u16,
}
