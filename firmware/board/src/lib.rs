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
mod imu;
mod io;
mod link;
mod odometer;
mod roll_out;
mod safety;
mod slew;
mod speed;
mod steering;

pub use actuators::Actuators;
pub use board::Board;
pub use imu::axis_map;
pub use io::{ImuHealth, ImuSample, Inputs, MotorPulses, Outputs};

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
