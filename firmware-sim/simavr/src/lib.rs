//! What the simulator and the process that runs the UNO image say to each other.
//!
//! `singletrack-simavr IMAGE.elf` runs the image instruction by instruction.
//! Requests on its standard input carry the inputs of the board: bytes on its line,
//! pulses of the motor, samples of the IMU. Replies on its standard output carry
//! the outputs. The simulator starts it and runs it in step with the car. Only that
//! program links libsimavr (under the GPL 3), and is a package of its own; this library
//! needs no C library.
//!
//! simavr runs the instructions; the process models UART, two-wire interface,
//! timer 1 and watchdog after the ATmega328P's data sheet, to the cycle.
//!
//! # Time
//!
//! All times are cycles of the board's oscillator (16 MHz) since the start of the
//! process. They advance even while the processor is held in reset, as it is
//! initially.
//!
//! # The board
//!
//! | Pin       | Connection                                                      |
//! |-----------|-----------------------------------------------------------------|
//! | D0, D1    | Line to the host; bytes that arrive during a reset are lost     |
//! | D2, INT0  | Motor sensor, high for 50 us from each rising edge              |
//! | D4        | Stop switch to ground; if open, the pin follows its pull-up     |
//! | D9, OC1A  | Servo pulses; a resistor pulls the floating pin low             |
//! | D10, OC1B | ESC pulses, likewise                                            |
//! | D7        | The kill output; a pull-down holds the floating pin low         |
//! | A0        | Half of the battery's voltage, against AVcc; or open            |
//! | A4, A5    | SDA and SCL with pull-ups, and the [`Bno055`] at 0x28           |

mod bno055;
mod message;
mod motion;

pub use bno055::{Bno055, ImuRegisters};
pub use message::{
    BusFault, CYCLES_PER_US, Figures, Hang, Interrupt, Pin, PipeError, Pulse, Reply, Report,
    Request, ResetFlags, Run, receive, send,
};
pub use motion::Motion;
