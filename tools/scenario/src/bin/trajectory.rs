//! Simulates a scenario and prints the trajectory, as `singletrack simulate` does. It needs a
//! third of the packages, so that builds with other profiles and for other computers show soon
//! whether they simulate the same bits. A number after the file is the duration, in s.

use std::{
    env,
    error::Error,
    io::{self, BufWriter},
    path::Path,
};

use singletrack_scenario::simulate::{Scenario, simulate, write_csv};

fn main() -> Result<(), Box<dyn Error>> {
    let path = env::args().nth(1).ok_or("give a scenario file")?;
    let mut scenario = Scenario::read(Path::new(&path))?;
    if let Some(seconds) = env::args().nth(2) {
        scenario.run.duration_s = seconds.parse()?;
    }
    let simulation = simulate(&scenario)?;
    write_csv(&simulation.rows, &mut BufWriter::new(io::stdout().lock()))?;
    Ok(())
}
