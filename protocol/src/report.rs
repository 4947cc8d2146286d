//! What the board tells the host.

use serde::{Deserialize, Serialize};

use crate::{Sequence, fixint_array};

/// The state of the board's safety machine.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum BoardMode {
    /// ESC at neutral for its own arming, for two seconds: after a start, and
    /// after a change of the neutral pulse.
    Boot,
    /// ESC neutral; ready to be configured and armed.
    Neutral,
    /// Armed; no [`crate::Drive`] accepted yet, ESC neutral.
    Armed,
    /// Obeying [`crate::Drive`] commands.
    Driving,
    /// Stopped by the board itself; only an explicit [`crate::Arm`] leaves it.
    Failsafe,
    /// Stopped by an emergency stop; only a reset leaves it.
    EmergencyStopped,
}

/// Why the board last went to neutral.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum StopCause {
    /// It has not, since it started.
    None,
    /// The host asked by [`crate::Disarm`].
    Disarmed,
    /// No command in force: the last one outlived its time to live.
    CommandTimeout,
    /// The pose behind the commands outlived the configured limit.
    PoseTooOld,
    /// Driven above the deadband and no motor pulse came.
    MotorSensor,
    /// The stop switch opened.
    StopInput,
    /// The host asked by [`crate::EmergencyStop`].
    EmergencyStop,
    /// The host started anew (a [`crate::Hello`] while armed).
    HostRestarted,
}

/// Why the board does not do what it was asked.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum RefusalReason {
    /// Nothing has been refused.
    None,
    /// The board has no configuration.
    NotConfigured,
    /// The configuration on the board is not the one that the host named.
    ConfigurationDiffers,
    /// A value of the configuration is outside what the board can do.
    InvalidConfiguration,
    /// Not while armed or driving.
    Busy,
    /// The ESC has not been held at neutral for long enough.
    NotYetNeutral,
    /// The wheels are turning.
    Moving,
    /// The stop switch is open.
    StopInputOpen,
    /// An emergency stop is latched until reset.
    EmergencyStopLatched,
    /// The command is older than its time to live, or from the future.
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

/// Which kind of request an answer is about.
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

/// The board has done what it was asked.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Acknowledgement {
    /// The kind of request.
    pub request: Request,
    /// The number that the request carried.
    pub sequence: Sequence,
    /// Hash of the configuration in force; zero for none.
    #[serde(with = "postcard::fixint::le")]
    pub configuration_hash: u32,
}

/// The board does not do what it was asked.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Refusal {
    /// The kind of request.
    pub request: Request,
    /// The number that the request carried.
    pub sequence: Sequence,
    /// Why not.
    pub reason: RefusalReason,
}

/// The inertial measurement unit, as the board sees it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum ImuState {
    /// No sample yet, or none for 50 ms; the values are the last ones.
    Silent,
    /// This record carries a sample that no record before it carried.
    Fresh,
    /// The same sample as in the record before.
    Repeated,
}

/// What control needs, at 100 Hz.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Telemetry {
    /// Board time at which this record was made, in µs, wrapping.
    #[serde(with = "postcard::fixint::le")]
    pub board_time_us: u32,
    /// The safety machine.
    pub mode: BoardMode,
    /// Why it last went to neutral.
    pub stop_cause: StopCause,
    /// The last [`crate::Drive`] that was accepted.
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

/// Why the board last started.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum ResetCause {
    /// The supply came up.
    PowerOn,
    /// The reset pin: the button, or the host opened the port.
    External,
    /// The supply dipped.
    BrownOut,
    /// The watchdog bit.
    Watchdog,
    /// Nothing that the board can tell.
    Unknown,
}

/// What a person wants to know, at 5 Hz. Counters wrap.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Status {
    /// Board time at which this record was made, in µs, wrapping.
    #[serde(with = "postcard::fixint::le")]
    pub board_time_us: u32,
    /// Hash of the configuration in force; zero for none.
    #[serde(with = "postcard::fixint::le")]
    pub configuration_hash: u32,
    /// Why the board last started.
    pub reset_cause: ResetCause,
    /// Whether the stop switch is open, if one is configured.
    pub stop_input_open: bool,
    /// Battery voltage, in mV.
    #[serde(with = "postcard::fixint::le")]
    pub battery_mv: u16,
    /// Good frames received.
    #[serde(with = "postcard::fixint::le")]
    pub frames_received: u16,
    /// Frames refused for CRC, COBS or length.
    #[serde(with = "postcard::fixint::le")]
    pub frames_damaged: u16,
    /// [`crate::Drive`] commands refused.
    #[serde(with = "postcard::fixint::le")]
    pub drives_refused: u16,
    /// The reason of the last such refusal; [`RefusalReason::None`] so far.
    pub last_refusal: RefusalReason,
    /// Frames dropped because the line was full.
    #[serde(with = "postcard::fixint::le")]
    pub frames_dropped: u16,
    /// Bytes lost by the receiver.
    #[serde(with = "postcard::fixint::le")]
    pub bytes_overrun: u16,
    /// Errors on the bus to the IMU.
    #[serde(with = "postcard::fixint::le")]
    pub imu_errors: u16,
}
