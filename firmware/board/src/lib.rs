//! What the Arduino does, without the Arduino.
//!
//! [`Board::poll`] is the whole firmware as one function of time, inputs and
//! received bytes. The simulator and the image for the Arduino UNO call the same
//! one; around it the image has nothing but pins, timers and interrupts.
//!
//! The board has the last word on the car. It obeys a [`Drive`] only after an
//! explicit [`Arm`], only while command and pose are young enough by its own
//! clock, and only within the limits of its [`Configuration`]; in every other
//! case the motor is in neutral.
//!
//! # For an 8-bit processor
//!
//! No floating point; nothing formats text. No division of more than 32 bits,
//! and those of 32 bits once per control period, not per poll. No checked,
//! saturating or overflowing multiplication of `i32`, which is miscompiled on
//! AVR: factors are bounded by [`Configuration::validate`] instead.
//!
//! [`Arm`]: singletrack_protocol::Arm
//! [`Drive`]: singletrack_protocol::Drive
//! [`Configuration`]: singletrack_protocol::Configuration
//! [`Configuration::validate`]: singletrack_protocol::Configuration::validate

#![no_std]

#[cfg(test)]
#[macro_use]
extern crate std;

mod board;
mod clock;
mod esc;
mod imu;
mod io;
mod link;
mod odometer;
mod safety;
mod slew;
mod speed;
mod steering;

pub use board::Board;
pub use io::{ImuSample, Inputs, MotorPulses, Outputs};
