//! What is analysed, over which range of values, and why an analysis fails.

use std::{io, str::FromStr};

use clap::ValueEnum;
use serde::Serialize;
use serde_json::{Value, json};
use singletrack_analysis::stability::{
    Belief, ClosedLoop, HopfPoint, Law, StabilityError, hopf_points,
};
use singletrack_control::VehicleParameters;
use singletrack_figures::output::print;

use crate::Table;

/// A car, its P and its law.
#[derive(Clone, Copy, Debug)]
pub struct Subject {
    /// The car.
    pub vehicle: VehicleParameters,
    /// The law.
    pub law: Law,
    /// The parameter of the law that is wrong by the deviation.
    pub belief: Belief,
    /// The distance p, in m.
    pub point_distance: f64,
}

impl Subject {
    /// Its steady motion at a speed (m/s), with the law's centre of mass `deviation`
    /// (m) behind the true one.
    ///
    /// # Errors
    ///
    /// Parameters without a steady motion.
    pub fn at(&self, speed: f64, deviation: f64) -> Result<ClosedLoop, StabilityError> {
        Ok(ClosedLoop::new(
            self.vehicle,
            self.law,
            self.point_distance,
            speed,
            deviation,
        )?
        .believing(self.belief))
    }

    /// Its Hopf points at a speed (m/s), over all deviations.
    ///
    /// # Errors
    ///
    /// Parameters without a steady motion.
    pub fn hopf_points(&self, speed: f64) -> Result<Vec<HopfPoint>, StabilityError> {
        hopf_points(
            self.vehicle,
            self.law,
            self.belief,
            self.point_distance,
            speed,
        )
    }

    /// The deviations of the paper: all meaningful ones, and for the
    /// front-point law as far down as its bifurcations lie.
    pub fn usual_deviations(&self) -> Grid {
        let [from, to] = ClosedLoop::meaningful_deviations(&self.vehicle);
        let from = match self.law {
            Law::FrontPoint => {
                -(self.vehicle.wheelbase_m() + self.point_distance) - 0.3 * from.abs()
            }
            Law::VelocityPoint => from,
        };
        Grid::spanning([from, to], 121)
    }
}

/// The largest number of points.
const MOST_POINTS: f64 = 100_000.0;

/// Evenly spaced values, `A:B:STEP` with both ends, or a list such as `1.0,1.5`.
///
/// Values have no more decimals than what was written, so that they print as a person
/// would write them.
#[derive(Clone, Debug, PartialEq)]
pub struct Grid(Vec<f64>);

impl Grid {
    /// `count` values from `from` to `to`, both included.
    pub fn spanning([from, to]: [f64; 2], count: usize) -> Self {
        let last = count.saturating_sub(1).max(1) as f64;
        Self(
            (0..count)
                .map(|index| from + (to - from) * index as f64 / last)
                .collect(),
        )
    }

    /// The values, ascending; never empty if written on the command line.
    pub fn values(&self) -> &[f64] {
        &self.0
    }

    /// Each value with all of `other`.
    pub(super) fn with<'a>(&'a self, other: &'a Self) -> impl Iterator<Item = (f64, f64)> + 'a {
        let all = |one: &'a f64| other.0.iter().map(|other| (*one, *other));
        self.0.iter().flat_map(all)
    }
}

impl FromStr for Grid {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let number = |text: &str| {
            let number = text.trim().parse::<f64>().ok();
            number.filter(|number| number.is_finite()).ok_or_else(|| {
                format!("{text:?} is not a number; write A:B:STEP, such as 0.1:8:0.1")
            })
        };
        let parts: Vec<&str> = text.split(':').collect();
        let (from, to, step) = match parts[..] {
            [list] => {
                let mut values: Vec<f64> = list.split(',').map(number).collect::<Result<_, _>>()?;
                values.sort_by(f64::total_cmp);
                return Ok(Self(values));
            }
            [from, to, step] => (number(from)?, number(to)?, number(step)?),
            _ => {
                return Err(
                    "write A:B:STEP, such as 0.1:8:0.1, or a list, such as 1.0,1.5".to_owned(),
                );
            }
        };
        if step <= 0.0 {
            return Err(format!("the step is {step}: it must be above zero"));
        }
        if to < from {
            return Err(format!(
                "it ends at {to}, before it begins at {from}; write the smaller value first"
            ));
        }
        // A last value that misses B by roundings alone is meant.
        let steps = ((to - from) / step + 1e-9).floor();
        if steps >= MOST_POINTS {
            return Err(format!(
                "it has {} values, more than {MOST_POINTS}; take a larger step",
                steps + 1.0
            ));
        }
        let decimals = parts.iter().map(|part| decimals(part)).max().unwrap_or(0);
        Ok(Self(
            (0..=steps as u32)
                .map(|index| rounded(from + f64::from(index) * step, decimals))
                .collect(),
        ))
    }
}

/// How many decimals a number is written with.
fn decimals(text: &str) -> usize {
    let text = text.trim().to_ascii_lowercase();
    let (mantissa, exponent) = text.split_once('e').unwrap_or((&text, "0"));
    let written = mantissa.split_once('.');
    let written = written.map_or(0, |(_, decimals)| decimals.len() as i64);
    let shift: i64 = exponent.parse().unwrap_or(0);
    usize::try_from(written.saturating_sub(shift)).unwrap_or(0)
}

/// The value rounded to a number of decimals.
fn rounded(value: f64, decimals: usize) -> f64 {
    // Beyond that, rounding to decimals changes nothing.
    if decimals > 15 {
        return value;
    }
    let rounded = format!("{value:.decimals$}").parse().unwrap_or(value);
    // No minus zero.
    if rounded == 0.0 { 0.0 } else { rounded }
}

/// How a result is written.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(super) enum Format {
    /// A header and a row for each point
    Csv,
    /// One document, with the car and all values of each point
    Json,
}

/// Writes rows as a table, or as `points` of a document.
pub(super) fn write(
    format: Format,
    subject: &Subject,
    table: &Table,
    points: &impl Serialize,
) -> io::Result<()> {
    match format {
        Format::Csv => print(&table.to_csv()),
        Format::Json => write_json(subject, points),
    }
}

/// Writes rows of numbers with the names of their columns, separated by commas; what is not a number
/// is missing.
pub(super) fn write_numbers(
    format: Format,
    subject: &Subject,
    header: &str,
    rows: Vec<Vec<f64>>,
) -> io::Result<()> {
    let header = header.to_owned();
    let table = Table { header, rows };
    write(format, subject, &table, &table.to_json())
}

/// Writes a document: car, law and `points`.
pub(super) fn write_json(subject: &Subject, points: &impl Serialize) -> io::Result<()> {
    let document = json!({
        "law": subject.law.name(),
        "wrong": subject.belief.name(),
        "point_distance_m": subject.point_distance,
        "meaningful_dl_m": ClosedLoop::meaningful_deviations(&subject.vehicle),
        "vehicle": subject.vehicle,
        "points": serde_json::to_value(points).unwrap_or(Value::Null),
    });
    print(&format!("{document:#}\n"))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn values(text: &str) -> Vec<f64> {
        text.parse::<Grid>().unwrap().values().to_vec()
    }

    #[test]
    fn both_ends_belong_to_it_and_values_are_those_one_would_write() {
        assert_eq!(values("0.1:0.5:0.1"), [0.1, 0.2, 0.3, 0.4, 0.5]);
        assert_eq!(values("-0.1:0.1:0.05"), [-0.1, -0.05, 0.0, 0.05, 0.1]);
        assert_eq!(values("0:1:0.4"), [0.0, 0.4, 0.8]);
        assert_eq!(values("1e-1:3e-1:1e-1"), [0.1, 0.2, 0.3]);
        assert_eq!(values("2"), [2.0]);
        assert_eq!(values("1.5,1.0"), [1.0, 1.5]);
        assert_eq!(values("0.1:8:0.05").len(), 159);
        assert_eq!(values("0.1:8:0.1").len(), 80);
        assert_eq!(values("-0.6:0.6:0.01").len(), 121);
    }

    #[test]
    fn what_is_no_range_is_refused_with_its_fix() {
        for (text, words) in [
            ("1:2", "A:B:STEP"),
            ("1:2:3:4", "A:B:STEP"),
            ("a:2:1", "\"a\""),
            ("1:2:nan", "\"nan\""),
            ("1:2:0", "above zero"),
            ("2:1:0.1", "smaller value first"),
            ("0:1:1e-9", "larger step"),
            ("", "\"\""),
        ] {
            let error = text.parse::<Grid>().unwrap_err();
            assert!(error.contains(words), "{text}: {error}");
        }
    }

    #[test]
    fn a_span_has_its_count_of_values_and_both_ends() {
        assert_eq!(
            Grid::spanning([-1.0, 1.0], 5).values(),
            [-1.0, -0.5, 0.0, 0.5, 1.0]
        );
        assert_eq!(Grid::spanning([2.0, 3.0], 1).values(), [2.0]);
    }
}
