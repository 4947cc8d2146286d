//! The UNO's image, instruction by instruction, in a process of its own.
//!
//! `singletrack-simavr IMAGE.elf` runs the image in simavr and is told over its
//! standard input what happens to the board: bytes on its line, pulses of the
//! motor, samples of the IMU. It answers over its standard output with what the
//! board does. The simulator starts it and lets it run in step with the car.
//! That program alone links libsimavr; this library is what both sides share
//! and needs nothing but Rust.
//!
//! # Time
//!
//! Everything is dated in cycles of the board's oscillator (16 MHz) since the
//! process started. They count on while the processor is held in reset.

mod bno055;
mod message;
mod pipe;

pub use bno055::{Bno055, Motion};
pub use message::{
    BusFault, CYCLES_PER_US, Figures, Hang, Interrupt, Pin, Pulse, Reply, Report, Request,
    ResetFlags, Run,
};
pub use pipe::{PipeError, receive, send};
