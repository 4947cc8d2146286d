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
mod figures;
mod machine;
mod timers;
mod twi;
mod uart;

use std::{
    fs::File,
    io::{self, BufReader, BufWriter, ErrorKind, Read, Write},
    os::fd::AsFd,
    path::PathBuf,
    process::ExitCode,
};

use singletrack_simavr::{PipeError, Request, receive, send};

use crate::{
    board::Board,
    elf::{Image, ImageError},
};

const USAGE: &str = "\
Run the UNO image in simavr, instruction by instruction.

Usage: singletrack-simavr IMAGE.elf

Started by the simulator (singletrack-sim --board uno), with which it exchanges
binary messages over standard input and output.
";

#[derive(Debug, thiserror::Error)]
enum Error {
    #[error("expected one argument, the image (see --help)")]
    Arguments,
    #[error(transparent)]
    Image(#[from] ImageError),
    #[error("this simavr does not support the ATmega328P")]
    Processor,
    #[error(transparent)]
    Pipe(#[from] PipeError),
    #[error("standard output: {0}")]
    Output(#[source] io::Error),
}

fn main() -> ExitCode {
    match run() {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("singletrack-simavr: {error}");
            ExitCode::FAILURE
        }
    }
}

fn run() -> Result<(), Error> {
    let mut arguments = std::env::args_os().skip(1);
    let path = match (arguments.next(), arguments.next()) {
        (Some(argument), None) if argument == "--help" || argument == "-h" => {
            print!("{USAGE}");
            return Ok(());
        }
        (Some(argument), None) => PathBuf::from(argument),
        _ => return Err(Error::Arguments),
    };
    let output = io::stdout()
        .as_fd()
        .try_clone_to_owned()
        .map_err(Error::Output)?;
    machine::silence_stdout();
    let image = Image::read(&path)?;
    let mut board = Board::new(&image).ok_or(Error::Processor)?;
    let mut input = BufReader::new(io::stdin().lock());
    let mut output = BufWriter::new(File::from(output));
    match converse(&mut board, &mut input, &mut output) {
        // The simulator has ended, possibly within a message.
        Err(PipeError::Io(error))
            if matches!(
                error.kind(),
                ErrorKind::BrokenPipe | ErrorKind::UnexpectedEof
            ) =>
        {
            Ok(())
        }
        result => Ok(result?),
    }
}

fn converse(
    board: &mut Board,
    input: &mut impl Read,
    output: &mut impl Write,
) -> Result<(), PipeError> {
    while let Some(request) = receive::<Request>(input)? {
        send(output, &board.answer(request))?;
    }
    Ok(())
}
