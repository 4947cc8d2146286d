//! Simulates a scenario and prints the trajectory, as `singletrack simulate` does. It needs a
//! third of the packages, so that builds with other profiles and for other computers show soon
//! whether they simulate the same bits.

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
