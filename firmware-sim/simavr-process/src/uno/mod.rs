//! An Arduino UNO: the ATmega328P and what is connected to its pins.
//!
//! simavr 1.6 runs the instructions, timers 0 and 2, the ADC, the ports' registers
//! and the interrupt priorities. The modules that it models too loosely for this
//! board are modelled here after the data sheet (Atmel 8271, ATmega328P):
//!
//! | Module   | simavr 1.6                                                          |
//! |----------|---------------------------------------------------------------------|
//! | UART     | 64 bytes of buffer, 11 bits a byte, no overrun                      |
//! | TWI      | 9 us a byte for any TWBR, wrong status after SLA+W                  |
//! | Timer 1  | OCR1x not double-buffered, mode 14 wrong, widths rounded in floats  |
//! | Watchdog | resets the processor without notice                                 |

mod board;
mod devices;
mod elf;
mod figures;
mod machine;
mod timer1;
mod twi;
mod uart;
mod watchdog;

pub(crate) use board::Board;
pub(crate) use elf::{Image, ImageError};
pub(crate) use machine::silence_stdout;
