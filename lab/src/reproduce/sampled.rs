//! The real loop, which the paper leaves out: in ticks, with delay and marker losses.

use indicatif::ProgressBar;
use singletrack_analysis::stability::{ClosedLoop, Law};

use super::{
    Setup,
    claims::{below, near},
    largest,
    section::Section,
    stability::subject,
    text::number,
};
use crate::stability::{Grid, TimingArgs, first_unstable, sampled_map, sampled_table};

/// The largest speed of the maps, for the paper's car, in m/s.
const FASTEST: f64 = 5.0;

pub(super) fn section(setup: &Setup, section: &mut Section, progress: &ProgressBar) {
    // The paper's 100 Hz, and a tick from measurement to command.
    let timing = TimingArgs::default();
    section.fact("period", number(timing.period_ms));
    section.fact("delay", number(timing.delay_ms));
    progress.set_message("the sampled loop");
    let range = ClosedLoop::meaningful_deviations(&setup.vehicle);
    let (columns, rows): (u32, usize) = if setup.quick { (5, 5) } else { (20, 21) };
    let fastest = FASTEST * setup.scale();
    let speeds = Grid::spanning([fastest / f64::from(columns), fastest], columns as usize);
    let deviations = Grid::spanning(range, rows);
    let subject = subject(setup, Law::FrontPoint);
    let map = sampled_map(&subject, &speeds, &deviations, timing, || {});
    let map = section.or_note("the sampled loop", map).unwrap_or_default();
    let largest = largest(map.iter().map(|row| row.spectral_radius));
    let first = first_unstable(
        &subject,
        TimingArgs::simulated_car(),
        Grid::spanning(range, 9).values(),
        subject.point_distance,
    );
    let first = section.or_note("the first unstable speed", first).flatten();
    section
        .claim("sampled-stable")
        .number("largest radius", largest, below(1.0));
    section
        .claim("sampled-servo")
        .number("up to", first, near(2.90, 0.01));
    section.table("sampled-front-point", sampled_table(&map));
}
