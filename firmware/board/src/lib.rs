//! The board's firmware without hardware access.
//!
//! [`Board::poll`] is the complete firmware as a function of time, inputs and
//! received bytes. The simulator and the UNO image call the same function; the
//! image adds only pins, timers and interrupts.
//!
//! The board has final authority over the car. It follows a [`Drive`] only after an
//! explicit [`Arm`], only while command and pose are recent enough by its own
//! clock, and only within the limits of its [`Configuration`]. In every other case
//! the motor is in neutral.
//!
//! # For an 8-bit processor
//!
//! No floating point and no text formatting. No division wider than 32 bits;
//! divisions of 32 bits once per control period, not per poll. No checked,
//! saturating or overflowing multiplication of `i32`, which is miscompiled on AVR:
//! [`Configuration::validate`] bounds the factors instead.
//!
//! [`Arm`]: singletrack_protocol::Arm
//! [`Drive`]: singletrack_protocol::Drive
//! [`Configuration`]: singletrack_protocol::Configuration
//! [`Configuration::validate`]: singletrack_protocol::Configuration::validate

#![no_std]

#[cfg(test)]
#[macro_use]
extern crate std;

mod actuators;
mod board;
mod clock;
mod esc;
mod link;
mod odometer;
mod roll_out;
mod safety;
mod speed;
mod steering;

pub use actuators::Actuators;
pub use board::Board;
pub use link::axis_map;

/// Version of this software, which a board reports: major, minor, patch.
pub const VERSION: [u8; 3] = [
    number(env!("CARGO_PKG_VERSION_MAJOR")),
    number(env!("CARGO_PKG_VERSION_MINOR")),
    number(env!("CARGO_PKG_VERSION_PATCH")),
];

const fn number(digits: &str) -> u8 {
    match u8::from_str_radix(digits, 10) {
        Ok(number) => number,
        Err(_) => u8::MAX,
    }
}

/// Motor pulses, counted by an interrupt.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct MotorPulses {
    /// Pulses so far, wrapping.
    pub count: u16,
    /// Board time of the newest pulse, in µs. Undefined until `count` changes for
    /// the first time.
    pub last_edge_us: u32,
}

/// One sample of the inertial measurement unit, along the car's axes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ImuSample {
    /// Board time of the sample, in µs; identifies the sample.
    pub time_us: u32,
    /// See [`singletrack_protocol::Telemetry::linear_acceleration_mm_s2`].
    pub linear_acceleration_mm_s2: [i16; 3],
    /// See [`singletrack_protocol::Telemetry::angular_velocity_mrad_s`].
    pub angular_velocity_mrad_s: [i16; 3],
    /// See [`singletrack_protocol::Telemetry::attitude_q14`].
    pub attitude_q14: [i16; 4],
}

/// Registers of the IMU that say how well it works; see [`singletrack_protocol::Status`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ImuHealth {
    /// `CALIB_STAT`.
    pub calibration: u8,
    /// `ST_RESULT`.
    pub self_test: u8,
    /// `SYS_STATUS`.
    pub status: u8,
    /// `SYS_ERR`.
    pub error: u8,
}

/// Inputs of the board, read shortly before the poll.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Inputs {
    /// Motor pulses; count and time must be consistent.
    pub motor: MotorPulses,
    /// The newest IMU sample. It may be passed once, or in every poll until the
    /// next one.
    pub imu: Option<ImuSample>,
    /// Battery voltage, in mV.
    pub battery_mv: u16,
    /// The processor's supply, in mV.
    pub supply_mv: u16,
    /// The battery's input floats.
    pub battery_open: bool,
    /// Level of the normally-closed stop input; ignored unless configured.
    pub stop_input_open: bool,
    /// Bytes lost by the receiver so far, wrapping.
    pub bytes_overrun: u16,
    /// Errors on the bus to the IMU so far, wrapping.
    pub imu_errors: u16,
    /// The IMU's own opinion of itself.
    pub imu_health: ImuHealth,
    /// Milliseconds with more edges of the motor's sensor than were counted so far,
    /// wrapping.
    pub edges_refused: u16,
}

/// Outputs until the next poll.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Outputs {
    /// Servo pulse, in µs; `None` for no pulses.
    pub servo_us: Option<u16>,
    /// ESC pulse, in µs; `None` for no pulses.
    pub esc_us: Option<u16>,
    /// The ESC's neutral pulse, in µs, for the pulse guard, which must be able to
    /// stop the car without another poll. Not for a silent ESC.
    pub esc_neutral_us: u16,
    /// While driving: board time, in µs, until which the command is in force. If it
    /// passes without another poll, an independent pulse guard (a timer interrupt)
    /// must output the neutral pulse to the ESC.
    pub drive_deadline_us: Option<u32>,
    /// Whether the kill output holds the ESC's supply. The pulse guard must drop it
    /// when the main loop is silent.
    pub power_on: bool,
}
