//! The real loop, which the paper leaves out: in ticks, with delay and marker losses.

use indicatif::ProgressBar;
use singletrack_analysis::stability::{ClosedLoop, Law, MarginLimits};

use super::{
    Setup, largest,
    section::{Below, Near, Picture, Scope, Section, number, with_digits},
    stability::{scene, subject},
};
use crate::stability::{Grid, TimingArgs, figures, first_unstable, sampled_map, sampled_table};

/// A time in ms, in words; `None` is beyond the searched range.
fn ms(time: Option<f64>, limit: f64) -> String {
    time.map_or_else(
        || format!("more than {} ms", number(limit * 1000.0)),
        |time| format!("{} ms", with_digits(time * 1000.0, 3)),
    )
}

/// The speeds whose margins the text names, for the paper's car, in m/s.
const MARGIN_SPEEDS: [f64; 4] = [0.5, 1.0, 1.5, 3.0];

/// The largest speed of the maps, for the paper's car, in m/s.
const FASTEST: f64 = 5.0;

pub(super) fn section(setup: &Setup, progress: &ProgressBar) -> Section {
    // The paper's 100 Hz, and a tick from measurement to command.
    let timing = TimingArgs::default();
    let intro = format!(
        "The paper analyses the law in continuous time, and runs it at 100 Hz. Here it runs every \
         {} ms, its command acts {} ms after the measurement, and the pose may be seen at every \
         n-th tick only and held in between.",
        number(timing.period_ms),
        number(timing.delay_ms)
    );
    let mut section = Section::new(8, "The loop as it runs: what the paper leaves out", intro);
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
        .claim(
            ("sampled-stable", Scope::PaperCar, ""),
            "The motion is as stable in ticks of 10 ms, a tick late",
            "the controller has \"a rate of 100 Hz\", the analysis is in continuous time: \
             spectral radius below 1 over the meaningful range",
            "up to 5 m/s, with a pose at every tick and wheels that follow at once; the paper \
             leaves this out",
        )
        .number("largest radius", largest, Below(1.0));
    section
        .claim(
            ("sampled-servo", Scope::Nobody, "m/s"),
            "The motion is stable with a steering servo",
            "the analysis has none; δ is an input of the model",
            "with the servo of the simulated car, 40 ms of lag, 9 ms from tick to wheels, a \
             pulse every 20 ms and a yaw rate 15 ms old, over the whole meaningful range; with \
             the pilot's compensation up to 7.6 m/s",
        )
        .number("up to", first, Near(2.90, 0.01));
    if map.is_empty() {
        return section;
    }
    section.table("sampled-front-point", sampled_table(&map));
    let limits = MarginLimits::default();
    let mut margins = Vec::new();
    for speed in MARGIN_SPEEDS.map(|speed| speed * setup.scale()) {
        let at = Grid::spanning([speed, speed], 1);
        let right = sampled_map(&subject, &at, &Grid::spanning([0.0, 0.0], 1), timing, || {});
        if let Some([row]) = section.or_note("margins", right).as_deref() {
            margins.push(format!(
                "{} m/s: {} and {}",
                number(speed),
                ms(row.delay_margin_s, limits.delay),
                ms(
                    row.longest_constant_interval_s,
                    f64::from(limits.marker_interval) * timing.period_ms * 1e-3
                )
            ));
        }
    }
    let mut pictures = Vec::new();
    if let Some(scene) = scene(&subject, setup, &mut section) {
        let labels = [
            "spectral radius",
            "delay margin",
            "longest survivable constant marker interval",
        ];
        let drawn = figures::sampled(&scene, timing, &map);
        let drawn = section.or_note("the sampled loop", drawn);
        let drawn = drawn.into_iter().flatten().zip(labels);
        pictures.extend(
            drawn.map(|((name, figure), label)| {
                Picture::new(format!("sampled-{name}"), label, figure)
            }),
        );
    }
    section.plate(
        "Spectral radius, delay margin and constant marker interval",
        "Nothing: the analysis has neither sampling nor delay.",
        format!(
            "Between {} and {} m/s the sampled loop has a spectral radius of at most {} over the \
             whole meaningful range of dl. With dl = 0, the delay that makes it unstable and the \
             longest interval between poses are, at {}.",
            number(fastest / f64::from(columns)),
            number(fastest),
            with_digits(largest, 6),
            margins.join("; ")
        ),
        pictures,
    );
    section
}
