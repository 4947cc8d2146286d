//! A section of the report, which its experiments and analyses write.

use std::fmt::Display;

use singletrack_figures::figure::Figure;
use singletrack_scenario::simulate::{PlantKind, Scenario};

use super::{
    Setup,
    claims::{Claim, Scope, Verdict},
    drive::{self, Run},
};
use crate::{Result, table::Table};

/// A section of the report, with everything that was computed for it.
#[derive(Clone, Debug)]
pub(super) struct Section {
    /// Its number, from 1.
    pub(super) number: usize,
    pub(super) title: &'static str,
    /// Its text, in HTML.
    pub(super) intro: String,
    pub(super) plates: Vec<Plate>,
    /// The data behind the pictures, each with the name of its file, without the ending.
    pub(super) tables: Vec<(String, Table)>,
    pub(super) claims: Vec<Claim>,
    /// Notes for the reader: what failed, and why.
    pub(super) notes: Vec<String>,
}

/// Pictures that belong together, beside the paper's.
#[derive(Clone, Debug)]
pub(super) struct Plate {
    /// Their subject, in a few words.
    pub(super) title: String,
    /// What the paper's figure shows, in HTML.
    pub(super) paper: String,
    /// What ours shows, in HTML.
    pub(super) ours: String,
    pub(super) pictures: Vec<Picture>,
}

/// One picture and its file.
#[derive(Clone, Debug)]
pub(super) struct Picture {
    /// The name of its file, without the ending.
    pub(super) name: String,
    /// What distinguishes it from the others of its plate.
    pub(super) label: String,
    pub(super) figure: Figure,
}

impl Picture {
    pub(super) fn new(name: impl Into<String>, label: impl Into<String>, figure: Figure) -> Self {
        Self {
            name: name.into(),
            label: label.into(),
            figure,
        }
    }
}

impl Section {
    pub(super) fn new(number: usize, title: &'static str, intro: impl Into<String>) -> Self {
        Self {
            number,
            title,
            intro: intro.into(),
            plates: Vec::new(),
            tables: Vec::new(),
            claims: Vec::new(),
            notes: Vec::new(),
        }
    }

    /// Adds a claim with this name about these cars, without numbers yet, but with their unit: what the
    /// paper says, in its words, and why it is so or not.
    pub(super) fn claim(
        &mut self,
        (id, scope, unit): (&'static str, Scope, &'static str),
        claim: impl Into<String>,
        paper: impl Into<String>,
        why: impl Into<String>,
    ) -> &mut Claim {
        self.claims.push(Claim {
            id,
            section: self.number,
            scope,
            claim: claim.into(),
            paper: paper.into(),
            unit,
            quantities: Vec::new(),
            verdict: Verdict::NotMeasured,
            why: why.into(),
            surprise: None,
        });
        let last = self.claims.len() - 1;
        &mut self.claims[last]
    }

    /// Adds a file of data.
    pub(super) fn table(&mut self, name: impl Into<String>, table: Table) {
        self.tables.push((name.into(), table));
    }

    pub(super) fn plate(
        &mut self,
        title: impl Into<String>,
        paper: &str,
        ours: impl Into<String>,
        pictures: Vec<Picture>,
    ) {
        self.plates.push(Plate {
            title: title.into(),
            paper: paper.to_owned(),
            ours: ours.into(),
            pictures,
        });
    }

    /// The result, or a note on its error.
    pub(super) fn or_note<T, E: Display>(&mut self, what: &str, result: Result<T, E>) -> Option<T> {
        result
            .map_err(|error| self.notes.push(format!("{what}: {error}")))
            .ok()
    }

    /// The drive of an experiment on a plant, unless the simulated car can't represent the car.
    pub(super) fn drive(
        &mut self,
        setup: &Setup,
        plant: PlantKind,
        what: &str,
        experiment: &Scenario,
    ) -> Option<Run> {
        match plant {
            PlantKind::Ideal => self.keep(what, drive::ideal(experiment)),
            PlantKind::Car if setup.fits_simulated_car() => self.keep(what, drive::car(experiment)),
            PlantKind::Car => None,
        }
    }

    /// The drive, or a note on its failure. A drive that ended early has a note too.
    pub(super) fn keep(&mut self, what: &str, drive: Result<Run>) -> Option<Run> {
        let drive = drive.map_err(|error| format!("not driven: {error}"));
        let run = self.or_note(what, drive)?;
        if let Some(ended) = &run.ended {
            self.notes.push(format!("{what}: {ended}"));
        }
        Some(run)
    }
}
