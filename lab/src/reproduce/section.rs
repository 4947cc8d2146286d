//! The contents of a section of the report, independent of its format.

use singletrack_figures::{figure::Figure, template::fill_by};
use singletrack_scenario::simulate::PlantKind;

use super::{
    Setup,
    claims::{Claim, Measurements},
    drive::{DriveError, Experiment, Run},
    text,
};
use crate::table::Table;

/// A section of the report, with everything that was computed for it.
#[derive(Clone, Debug, Default)]
pub struct Section {
    /// Its number, from 1.
    pub number: usize,
    /// Its title.
    pub title: &'static str,
    /// Its text, in HTML.
    pub intro: String,
    /// Its figures.
    pub plates: Vec<Plate>,
    /// The data behind them, each with the name of its file, without the ending.
    pub tables: Vec<(String, Table)>,
    /// Numbers for the claims.
    pub measurements: Measurements,
    /// Notes for the reader: what failed, and why.
    pub notes: Vec<String>,
}

impl Section {
    /// Without contents.
    pub(super) fn new(number: usize, title: &'static str) -> Self {
        Self {
            number,
            title,
            ..Self::default()
        }
    }

    /// Adds a file of data.
    pub(super) fn table(&mut self, name: impl Into<String>, table: Table) {
        self.tables.push((name.into(), table));
    }

    /// Adds a plate. In `ours` a `{name}` stands for one of the words, and a `{name unit}` for a
    /// measurement.
    pub(super) fn plate(
        &mut self,
        title: impl Into<String>,
        paper: &str,
        ours: &str,
        words: &[(&str, String)],
        pictures: Vec<Picture>,
    ) {
        let ours = fill_by(ours, |place| {
            let word = words.iter().find(|(name, _)| *name == place);
            Some(word.map_or_else(
                || {
                    let (name, unit) = place.split_once(' ').unwrap_or((place, ""));
                    or_note(self.measurements.get(name), unit)
                },
                |(_, word)| word.clone(),
            ))
        });
        self.plates.push(Plate {
            title: title.into(),
            paper: paper.to_owned(),
            ours,
            pictures,
        });
    }

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

    /// The drive on a plant, unless the simulated car can't represent the car.
    pub(super) fn drive(
        &mut self,
        setup: &Setup,
        plant: PlantKind,
        what: &str,
        experiment: &Experiment,
    ) -> Option<Run> {
        match plant {
            PlantKind::Ideal => self.keep(what, experiment.ideal(setup)),
            PlantKind::Car if setup.fits_simulated_car() => self.keep(what, experiment.car(setup)),
            PlantKind::Car => None,
        }
    }

    /// The drive, or a note on its failure. A drive that ended early has a note too.
    pub(super) fn keep(&mut self, what: &str, drive: Result<Run, DriveError>) -> Option<Run> {
        let drive = drive.map_err(|error| format!("not driven: {error}"));
        let run = self.or_note(what, drive)?;
        if let Some(ended) = &run.ended {
            self.notes.push(format!("{what}: {ended}"));
        }
        Some(run)
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
    pub claims: Vec<Claim>,
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

/// A number in a sentence; a plant that could not be driven has none.
pub(super) fn or_note(value: Option<f64>, unit: &str) -> String {
    value.map_or_else(
        || "(not driven)".to_owned(),
        |value| format!("{} {unit}", text::with_digits(value, 4)),
    )
}
