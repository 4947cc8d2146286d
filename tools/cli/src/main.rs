//! The command line of Singletrack.

use std::process::ExitCode;

fn main() -> ExitCode {
    singletrack::program::main()
}
