//! Simulates a scenario and prints the trajectory, as `singletrack simulate` does. It needs a
//! third of the packages, so that a debug build of it shows soon whether debug and release builds
//! simulate the same bits.
//!
//! ```sh
//! cargo run -p singletrack-scenario --example trajectory -- tools/scenarios/circle.toml
//! ```

use std::{
    env,
    error::Error,
    io::{self, BufWriter},
    path::Path,
};

use singletrack_scenario::simulate::{Scenario, simulate, write_csv};

fn main() -> Result<(), Box<dyn Error>> {
    let path = env::args().nth(1).ok_or("give a scenario file")?;
    let simulation = simulate(&Scenario::read(Path::new(&path))?)?;
    write_csv(&simulation.rows, &mut BufWriter::new(io::stdout().lock()))?;
    Ok(())
}
