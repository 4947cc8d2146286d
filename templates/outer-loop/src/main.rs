//! The programs of Singletrack, with this loop.

use std::process::ExitCode;

use my_loop::MyLoop;
use singletrack_core::config::OwnLoopKind;

fn main() -> ExitCode {
    singletrack_lab::program::main_with([OwnLoopKind::of::<MyLoop>()])
}
