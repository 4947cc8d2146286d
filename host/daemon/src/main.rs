//! `singletrackd`: drives the car.

use std::{env, process::ExitCode};

fn main() -> ExitCode {
    singletrackd::program::main(env::args_os())
}
