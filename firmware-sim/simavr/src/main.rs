//! Runs the UNO's image in simavr for the simulator. See the library of this
//! package for what is said over the standard input and output.

mod uno;

use std::fs::File;
use std::io::{self, BufReader, BufWriter, ErrorKind, Read, Write};
use std::os::fd::AsFd;
use std::path::PathBuf;
use std::process::ExitCode;

use singletrack_simavr::{PipeError, Request, receive, send};
use uno::{Board, Image, ImageError};

const USAGE: &str = "\
Runs the UNO's image in simavr, instruction by instruction.

Usage: singletrack-simavr IMAGE.elf

The simulator starts this by itself (singletrack-sim --board uno). It speaks a
binary protocol over standard input and output.
";

#[derive(Debug, thiserror::Error)]
enum Error {
    #[error("one argument, the image (--help tells more)")]
    Arguments,
    #[error(transparent)]
    Image(#[from] ImageError),
    #[error("this simavr doesn't know the ATmega328P")]
    Processor,
    #[error(transparent)]
    Pipe(#[from] PipeError),
    #[error("the standard output: {0}")]
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
    uno::silence_stdout();
    let image = Image::read(&path)?;
    let mut board = Board::new(&image).ok_or(Error::Processor)?;
    let mut input = BufReader::new(io::stdin().lock());
    let mut output = BufWriter::new(File::from(output));
    match converse(&mut board, &mut input, &mut output) {
        // The simulator has ended, perhaps in the middle of a message: so do we.
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
