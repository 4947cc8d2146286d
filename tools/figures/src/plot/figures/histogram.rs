//! How punctual the controller was.

use singletrack_control::statistics::Distribution;

use crate::{
    figure::{Axis, Bar, Figure, Panel, Rule},
    plot::drive::Drive,
};

/// Bars in a linear histogram.
const BARS: usize = 50;
/// Bars in every decade of a logarithmic one.
const BARS_A_DECADE: i32 = 8;
/// What a histogram counts.
const PART: Axis = Axis::new("part of the ticks", None, "%");
/// Lateness below this is in the first bar, in µs.
const LEAST_LATENESS: f64 = 1.0;

pub(super) fn latency(drive: &Drive) -> Figure {
    let values = drive.ticks.iter().map(|tick| tick.latency * 1000.0);
    let latency = Distribution::of(values);
    let mut panel = Panel::new(Axis::new("mid-exposure to command", None, "ms"), PART);
    let mut beyond = 0;
    if let (Some(least), Some(p99), Some(most)) =
        (latency.min(), latency.quantile(0.99), latency.max())
    {
        // A single outlier must not press all others into one bar.
        let end = if most > p99 + 2.0 * (p99 - least).max(0.1) {
            p99 + (p99 - least).max(0.1)
        } else {
            most
        };
        let (bars, outside) = linear(&latency, least.floor(), end.ceil());
        (panel.bars, beyond) = (bars, outside);
        panel.rules = rules(&latency, "ms", 1);
    }
    let beyond = match beyond {
        0 => String::new(),
        count => format!("; {count} more are beyond the axis"),
    };
    Figure::column(
        "Latency from capture to command",
        format!(
            "From the middle of the cameras' exposure to the drive command that rests on it \
             leaving for the board, in ticks with a new pose{beyond}."
        ),
        vec![panel],
    )
}

pub(super) fn lateness(drive: &Drive) -> Figure {
    let values = drive.ticks.iter().map(|tick| tick.lateness * 1e6);
    let lateness = Distribution::of(values);
    let axis = Axis::new("lateness of a tick", None, "µs").including(LEAST_LATENESS);
    let mut panel = Panel::new(axis.logarithmic(), PART);
    panel.bars = logarithmic(&lateness);
    panel.rules = rules(&lateness, "µs", 0);
    for rule in &mut panel.rules {
        rule.value = rule.value.max(LEAST_LATENESS);
    }
    Figure::column(
        "Lateness of the control ticks",
        "How much later than scheduled the control thread woke up, on a logarithmic \
         axis; what is below 1 µs is in the first bar.",
        vec![panel],
    )
}

fn rules(distribution: &Distribution, unit: &str, decimals: usize) -> Vec<Rule> {
    [("median", 0.5), ("99 %", 0.99)]
        .into_iter()
        .filter_map(|(name, part)| {
            let value = distribution.quantile(part)?;
            Some(Rule {
                name: format!("{name}: {value:.decimals$} {unit}"),
                value,
            })
        })
        .collect()
}

/// Bars of equal width from `low` to `high`, in % of all values, and how many
/// values are outside.
fn linear(values: &Distribution, low: f64, high: f64) -> (Vec<Bar>, usize) {
    let high = high.max(low + 1.0);
    let edge = |index: usize| low + (high - low) * index as f64 / BARS as f64;
    let edges: Vec<f64> = (0..=BARS).map(edge).collect();
    let bars = bars(values, &edges);
    let beyond = values.count() - values.count_up_to(high);
    (bars, beyond)
}

/// Bars of equal width on a logarithmic axis from [`LEAST_LATENESS`] on, in % of
/// all values; those below it are in the first.
fn logarithmic(values: &Distribution) -> Vec<Bar> {
    let Some(most) = values.max() else {
        return Vec::new();
    };
    let decades = (most.max(10.0 * LEAST_LATENESS).log10().ceil()) as i32;
    let edge = |index: i32| 10_f64.powf(f64::from(index) / f64::from(BARS_A_DECADE));
    let edges: Vec<f64> = (0..=decades * BARS_A_DECADE).map(edge).collect();
    bars(values, &edges)
}

/// The bars of the values from one edge up to the next, which the last bar includes; the first
/// bar holds all values below it as well.
fn bars(values: &Distribution, edges: &[f64]) -> Vec<Bar> {
    let mut below = 0;
    let bars = edges.windows(2).enumerate().map(|(index, ends)| {
        let end = if index + 2 == edges.len() {
            values.count_up_to(ends[1])
        } else {
            values.count_below(ends[1])
        };
        let count = end - std::mem::replace(&mut below, end);
        Bar {
            span: [ends[0], ends[1]],
            height: 100.0 * count as f64 / values.count().max(1) as f64,
        }
    });
    bars.collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bars_hold_all_values_once() {
        let values = Distribution::of((0..1000).map(|index| 8.0 + f64::from(index) * 0.004));
        let (bars, beyond) = linear(&values, 8.0, 12.0);
        let all: f64 = bars.iter().map(|bar| bar.height).sum();
        assert!((all - 100.0).abs() < 1e-9 && beyond == 0, "{all} {beyond}");
        let (bars, beyond) = linear(&values, 8.0, 10.0);
        let all: f64 = bars.iter().map(|bar| bar.height).sum();
        assert!(
            (all + 0.1 * beyond as f64 - 100.0).abs() < 1e-9,
            "{all} {beyond}"
        );
    }

    #[test]
    fn lateness_of_nothing_is_in_the_first_bar() {
        let bars = logarithmic(&Distribution::of([-3.0, 0.0, 0.5, 1000.0]));
        assert_eq!(bars[0].height, 75.0);
        assert_eq!(bars[bars.len() - 1].height, 25.0);
        assert_eq!(bars[bars.len() - 1].span[1], 1000.0);
    }
}
