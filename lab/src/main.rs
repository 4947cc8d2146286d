//! `singletrack-lab`, whose commands `singletrack` passes on.

use std::process::ExitCode;

fn main() -> ExitCode {
    singletrack_lab::program::main()
}
