//! Runs the UNO image in simavr for the simulator. The library of this package
//! describes the protocol on standard input and output.
//!
//! The Arduino UNO is the ATmega328P and what is connected to its pins.
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
mod machine;
mod timers;
mod twi;
mod uart;

use std::{
    error::Error,
    fs::File,
    io::{self, BufReader, BufWriter, ErrorKind},
    os::fd::AsFd,
    path::PathBuf,
    process::ExitCode,
};

use singletrack_simavr::{PipeError, Request, receive, send};

use crate::{board::Board, elf::Image};

const USAGE: &str = "\
Run the UNO image in simavr, instruction by instruction.

Usage: singletrack-simavr IMAGE.elf

Started by the simulator (singletrack-sim --board uno), with which it exchanges
binary messages over standard input and output.
";

fn main() -> ExitCode {
    match run() {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("singletrack-simavr: {error}");
            ExitCode::FAILURE
        }
    }
}

fn run() -> Result<(), Box<dyn Error>> {
    let mut arguments = std::env::args_os().skip(1);
    let path = match (arguments.next(), arguments.next()) {
        (Some(argument), None) if argument == "--help" || argument == "-h" => {
            print!("{USAGE}");
            return Ok(());
        }
        (Some(argument), None) => PathBuf::from(argument),
        _ => return Err("expected one argument, the image (see --help)".into()),
    };
    let output = io::stdout()
        .as_fd()
        .try_clone_to_owned()
        .map_err(|error| format!("standard output: {error}"))?;
    machine::silence_stdout();
    let image = Image::read(&path)?;
    let mut board = Board::new(&image).ok_or("this simavr does not support the ATmega328P")?;
    let mut input = BufReader::new(io::stdin().lock());
    let mut output = BufWriter::new(File::from(output));
    let mut converse = || {
        while let Some(request) = receive::<Request>(&mut input)? {
            send(&mut output, &board.answer(request))?;
        }
        Ok(())
    };
    // The simulator has ended, possibly within a message.
    let has_ended =
        |kind: ErrorKind| matches!(kind, ErrorKind::BrokenPipe | ErrorKind::UnexpectedEof);
    match converse() {
        Err(PipeError::Io(error)) if has_ended(error.kind()) => Ok(()),
        result => Ok(result?),
    }
}
