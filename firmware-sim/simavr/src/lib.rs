//! The UNO's image, instruction by instruction, in a process of its own.
//!
//! `singletrack-simavr IMAGE.elf` runs the image in simavr and is told over its
//! standard input what happens to the board: bytes on its line, pulses of the
//! motor, samples of the IMU. It answers over its standard output with what the
//! board does. The simulator starts it and lets it run in step with the car.
//! That program alone links libsimavr (which is under the GPL 3); this library is
//! what both sides share and needs nothing but Rust. `--features simavr` builds
//! the program, with Debian's `libsimavr-dev`.
//!
//! simavr runs the instructions; UART, two-wire interface, timer 1 and watchdog
//! are modelled in this package after the ATmega328P's data sheet, to the cycle.
//!
//! # Time
//!
//! Everything is dated in cycles of the board's oscillator (16 MHz) since the
//! process started. They count on while the processor is held in reset, as it is
//! at first.
//!
//! # The board
//!
//! | Pin       | What is there                                                   |
//! |-----------|-----------------------------------------------------------------|
//! | D0, D1    | The line to the host; what arrives during a reset is lost       |
//! | D2, INT0  | The motor's sensor, high for 50 us from each rising edge        |
//! | D4        | The stop switch to ground; open, the pin is left to its pull-up |
//! | D9, OC1A  | The servo's pulses; a resistor pulls the floating pin low       |
//! | D10, OC1B | The ESC's, likewise                                             |
//! | A0        | Half of the battery's voltage, against AVcc = 5 V               |
//! | A4, A5    | SDA and SCL with pull-ups, and the [`Bno055`] at 0x28           |

mod bno055;
mod message;
mod pipe;

pub use bno055::{Bno055, Motion};
pub use message::{
    BusFault, CYCLES_PER_US, Figures, Hang, Interrupt, Pin, Pulse, Reply, Report, Request,
    ResetFlags, Run,
};
pub use pipe::{PipeError, receive, send};
