//! The contents of a section of the report, independent of its format.

use singletrack_figures::figure::Figure;
use singletrack_scenario::{
    csv_text::csv_text,
    simulate::{HEADER, Row},
};

use super::{
    Setup,
    claims::{Judged, Measurements},
    drive::{DriveError, Experiment, Run},
    text,
};

/// A section of the report, with everything that was computed for it.
#[derive(Clone, Debug, Default)]
pub struct Section {
    /// Its number, from 1.
    pub number: usize,
    /// Its title.
    pub title: &'static str,
    /// Its text, by paragraphs.
    pub intro: Vec<String>,
    /// Its figures.
    pub plates: Vec<Plate>,
    /// The data behind them.
    pub tables: Vec<Table>,
    /// Numbers for the claims.
    pub measurements: Measurements,
    /// Notes for the reader: what failed, and why.
    pub notes: Vec<String>,
}

impl Section {
    /// The result, or a note on its error.
    pub(super) fn or_note<T, E: std::fmt::Display>(
        &mut self,
        what: &str,
        result: Result<T, E>,
    ) -> Option<T> {
        match result {
            Ok(value) => Some(value),
            Err(error) => {
                self.notes.push(format!("{what}: {error}"));
                None
            }
        }
    }

    /// The drive on the simulated car, unless that can't represent the car.
    pub(super) fn drive_car(
        &mut self,
        setup: &Setup,
        what: &str,
        experiment: &Experiment,
    ) -> Option<Run> {
        setup
            .fits_simulated_car()
            .then(|| self.keep(&format!("car, {what}"), experiment.car(setup)))
            .flatten()
    }

    /// The drive, or a note on its failure. A drive that ended early has a note too.
    pub(super) fn keep(&mut self, what: &str, drive: Result<Run, DriveError>) -> Option<Run> {
        match drive {
            Ok(run) => {
                if let Some(ended) = &run.ended {
                    self.notes.push(format!("{what}: {ended}"));
                }
                Some(run)
            }
            Err(error) => {
                self.notes.push(format!("{what}: not driven: {error}"));
                None
            }
        }
    }
}

/// All results of a reproduction.
#[derive(Clone, Debug)]
pub struct Reproduction {
    /// The car.
    pub setup: Setup,
    /// The sections of the report, in order.
    pub sections: Vec<Section>,
    /// The claims with their verdicts.
    pub claims: Vec<Judged>,
}

/// Pictures that belong together, beside the paper's.
#[derive(Clone, Debug)]
pub struct Plate {
    /// Their subject, in a few words.
    pub title: String,
    /// What the paper's figure shows, in a sentence.
    pub paper: String,
    /// What ours shows, in a sentence, with its numbers.
    pub ours: String,
    /// The pictures.
    pub pictures: Vec<Picture>,
}

/// One picture and its file.
#[derive(Clone, Debug)]
pub struct Picture {
    /// The name of its file, without the ending.
    pub name: String,
    /// What distinguishes it from the others of its plate.
    pub label: String,
    /// The picture.
    pub figure: Figure,
}

impl Picture {
    /// A picture for a plate.
    pub fn new(name: impl Into<String>, label: impl Into<String>, figure: Figure) -> Self {
        Self {
            name: name.into(),
            label: label.into(),
            figure,
        }
    }
}

/// A file of data.
#[derive(Clone, Debug)]
pub struct Table {
    /// The name of its file, without the ending.
    pub name: String,
    /// The names of its columns, separated by commas, with their units.
    pub header: String,
    /// Its rows.
    pub rows: Vec<Vec<f64>>,
}

impl Table {
    /// The trajectory of a drive.
    pub fn of_rows(name: impl Into<String>, rows: &[Row]) -> Self {
        Self {
            name: name.into(),
            header: HEADER.to_owned(),
            rows: rows.iter().map(|row| row.values().to_vec()).collect(),
        }
    }

    /// As CSV: numbers with every significant digit; an empty cell for one that is missing.
    #[must_use]
    pub fn to_csv(&self) -> String {
        let cell = |value: &f64| {
            if value.is_nan() {
                String::new()
            } else {
                value.to_string()
            }
        };
        let header: Vec<String> = self.header.split(',').map(ToOwned::to_owned).collect();
        let rows = self.rows.iter().map(|row| row.iter().map(cell).collect());
        csv_text([header].into_iter().chain(rows))
    }
}

/// A number in a sentence; a plant that could not be driven has none.
pub(super) fn or_note(value: Option<f64>, unit: &str) -> String {
    value.map_or_else(
        || "(not driven)".to_owned(),
        |value| format!("{} {unit}", text::with_digits(value, 4)),
    )
}
