//! How closely P follows its reference in scenarios on the simulated car.
//!
//! ```sh
//! cargo run --release -p singletrack-scenario --example tracking -- tools/scenarios/best/*.toml
//! ```
//!
//! Prints for each file the distance of P from its reference from 10 s on, in mm: root mean
//! square and largest, and the root mean square along and across the reference's path.

#![allow(
    clippy::disallowed_methods,
    reason = "an example prints figures of three digits"
)]

use std::{env, error::Error, path::Path};

use singletrack_scenario::simulate::{Scenario, simulate};
use singletrack_statistics::RootMeanSquare;

/// From here on the start no longer counts, in s.
const SETTLED: f64 = 10.0;

fn main() -> Result<(), Box<dyn Error>> {
    println!("rms_mm max_mm along_mm across_mm file");
    for file in env::args().skip(1) {
        let simulation = simulate(&Scenario::read(Path::new(&file))?)?;
        let [mut all, mut along, mut across] = [RootMeanSquare::default(); 3];
        let mut largest: f64 = 0.0;
        for pair in simulation.rows.windows(2) {
            let [row, next] = pair else { continue };
            if row.t < SETTLED {
                continue;
            }
            let (dx, dy) = (row.x_p - row.x_ref, row.y_p - row.y_ref);
            let (tx, ty) = (next.x_ref - row.x_ref, next.y_ref - row.y_ref);
            let length = tx.hypot(ty).max(1e-9);
            all.add_square(dx.powi(2) + dy.powi(2));
            along.add_square(((dx * tx + dy * ty) / length).powi(2));
            across.add_square(((dy * tx - dx * ty) / length).powi(2));
            largest = largest.max(dx.hypot(dy));
        }
        let mm = |mean: &RootMeanSquare| 1e3 * mean.value().unwrap_or(f64::NAN);
        println!(
            "{:6.2} {:6.1} {:8.2} {:9.2} {file}",
            mm(&all),
            1e3 * largest,
            mm(&along),
            mm(&across),
        );
        for note in &simulation.notes {
            println!("       {note}");
        }
    }
    Ok(())
}
