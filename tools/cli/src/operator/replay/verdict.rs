//! How replayed outputs compare with recorded ones.

use std::{
    fmt::{self, Write as _},
    path::Path,
};

use singletrack_control::statistics::RootMeanSquare;
use singletrack_figures::figure::{Axis, Column, Curve, Figure, Look, Panel, Symbol};
use singletrack_pilot::{Mode, Output, Reason};
use singletrack_record::{Entry, Meta, TickRecord};

use super::Span;

/// Who makes records, as they name it.
const DAEMON: &str = "singletrackd";

/// The version of everything here.
const VERSION: &str = env!("CARGO_PKG_VERSION");

/// Differences that are printed one by one; of more, their number.
const TOLD: usize = 12;

/// The first tick whose output is not the one recorded, with all its inputs.
pub(super) fn first_difference(
    path: &Path,
    meta: &Meta,
    tick: &TickRecord,
    output: &Output,
    before: &Span,
) -> String {
    let differences = tick.differences(output);
    let mut text = format!(
        "{}: tick {}, {:.3} s into the record, differs; {} ticks before it are the same",
        path.display(),
        tick.index,
        before.seconds_to(tick),
        before.ticks,
    );
    // Writing to a string does not fail.
    for difference in differences.iter().take(TOLD) {
        let _ = write!(text, "\n    {difference}");
    }
    if let Some(more) = differences.len().checked_sub(TOLD).filter(|more| *more > 0) {
        let _ = write!(text, "\n    and {more} fields more");
    }
    let _ = write!(text, "\nThe pilot was told, at {} ns:", tick.pilot_time.0);
    if tick.events.is_empty() {
        text.push_str(" nothing");
    }
    for event in &tick.events {
        let _ = write!(text, "\n    {event:?}");
    }
    let mut json = String::new();
    Entry::Tick(tick.clone()).write_json(&mut json);
    let _ = write!(text, "\nAs recorded:\n{json}");
    let made_by = meta.software.get(DAEMON);
    let made_by = made_by.map_or("no version", String::as_str);
    if made_by != VERSION {
        let _ = write!(
            text,
            "\nThe record was made by {DAEMON} {made_by}, this is {VERSION}: another pilot may \
             decide otherwise."
        );
    }
    text
}

/// What is compared: its name, and where it is found in an output.
type Quantity = (&'static str, &'static str, fn(&Output) -> Option<f64>);

const QUANTITIES: [Quantity; 9] = [
    ("speed", "m/s", |output| Some(output.actuation.speed)),
    ("steering", "rad", |output| Some(output.actuation.steering)),
    ("v_Px", "m/s", |output| Some(output.point_velocity?.x)),
    ("v_Py", "m/s", |output| Some(output.point_velocity?.y)),
    ("estimate x", "m", |output| {
        Some(output.estimate?.position.x)
    }),
    ("estimate y", "m", |output| {
        Some(output.estimate?.position.y)
    }),
    ("estimate yaw", "rad", |output| Some(output.estimate?.yaw)),
    ("estimate yaw rate", "rad/s", |output| {
        Some(output.estimate?.yaw_rate)
    }),
    ("estimate sideslip", "rad", |output| {
        Some(output.estimate?.sideslip)
    }),
];

/// How one quantity deviates over a record.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Deviation {
    /// Replayed minus recorded, in the ticks in which both have it.
    differences: RootMeanSquare,
    /// Ticks in which one has it.
    unmatched: u64,
    /// The largest of them, by amount.
    largest: f64,
    /// When that was, in s from the first tick.
    largest_at: f64,
}

impl Deviation {
    fn add(&mut self, time: f64, recorded: Option<f64>, replayed: Option<f64>) {
        match (recorded, replayed) {
            (Some(recorded), Some(replayed)) => {
                let deviation = replayed - recorded;
                self.differences.add(deviation);
                if deviation.abs() > self.largest.abs() {
                    (self.largest, self.largest_at) = (deviation, time);
                }
            }
            (None, None) => {}
            _ => self.unmatched += 1,
        }
    }
}

/// How the outputs of a pilot with another configuration deviate.
#[derive(Clone, Debug, Default)]
pub(super) struct Deviations {
    quantities: [Deviation; QUANTITIES.len()],
    modes: u64,
    first_mode: Option<(f64, Standing, Standing)>,
    /// Time, then speed and steering as recorded and as replayed.
    series: Vec<[f64; 5]>,
}

type Standing = (Mode, Option<Reason>);

impl Deviations {
    /// Takes in a tick, at this time in s since the first.
    pub(super) fn add(&mut self, time: f64, tick: &TickRecord, output: &Output) {
        for ((_, _, quantity), deviation) in QUANTITIES.iter().zip(&mut self.quantities) {
            deviation.add(time, quantity(&tick.output), quantity(output));
        }
        let standing = |output: &Output| (output.mode, output.reason);
        if tick.output.mode != output.mode {
            self.modes += 1;
            self.first_mode
                .get_or_insert((time, standing(&tick.output), standing(output)));
        }
        let (was, is) = (tick.output.actuation, output.actuation);
        let row = [time, was.speed, is.speed, was.steering, is.steering];
        self.series.push(row);
    }

    /// Speed and steering, replayed over recorded.
    pub(super) fn figure(&self) -> Figure {
        let column =
            |index: usize| -> Column { self.series.iter().map(|row| row[index]).collect() };
        let time = column(0);
        let panel = |axis: Axis, recorded: usize| {
            let curve = |name, look, index| Curve::new(name, look, &time, column(index));
            Panel {
                curves: vec![
                    curve("recorded", Look::Nominal, recorded),
                    curve("replayed", Look::Actual, recorded + 1),
                ],
                ..Panel::new(
                    Axis::new("time in the record", Some(Symbol::new("t", "")), "s"),
                    axis,
                )
            }
        };
        Figure::page(
            "Commands, recorded and replayed",
            "What the pilot commanded, and what it would have commanded at the sight of \
             the same events with another configuration.",
            vec![
                panel(Axis::new("speed", Some(Symbol::new("v", "")), "m/s"), 1),
                panel(Axis::new("steering", Some(Symbol::new("δ", "")), "rad"), 3),
            ],
        )
    }
}

impl fmt::Display for Deviations {
    /// A table for a person.
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(
            out,
            "replayed minus recorded, at the sight of the same events (the car of the record \
             goes its way):"
        )?;
        writeln!(
            out,
            "{:<20} {:>6} {:>12} {:>12} {:>9} {:>10}",
            "", "unit", "rms", "largest", "at s", "one alone"
        )?;
        for ((name, unit, _), deviation) in QUANTITIES.iter().zip(&self.quantities) {
            writeln!(
                out,
                "{name:<20} {unit:>6} {:>12.6} {:>12.6} {:>9.2} {:>10}",
                deviation.differences.value().unwrap_or(0.0),
                deviation.largest,
                deviation.largest_at,
                deviation.unmatched
            )?;
        }
        let told = |(mode, reason): Standing| match reason {
            Some(reason) => format!("{mode} ({reason})"),
            None => mode.to_string(),
        };
        match self.first_mode {
            None => writeln!(out, "the mode is the same in every tick"),
            Some((time, recorded, replayed)) => writeln!(
                out,
                "the mode differs in {} ticks, first at {time:.2} s: recorded {}, replayed {}",
                self.modes,
                told(recorded),
                told(replayed)
            ),
        }
    }
}
