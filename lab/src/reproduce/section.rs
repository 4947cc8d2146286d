//! A section of the report, which its experiments and analyses write.

use std::{collections::BTreeMap, fmt::Display};

use serde::Deserialize;
use singletrack_figures::figure::Figure;
use singletrack_scenario::simulate::PlantKind;

use super::{
    Setup,
    claims::{Claim, ClaimWords, Verdict},
    drive::{Drives, Experiment, Run},
    text::told,
};
use crate::{Result, table::Table};

/// A number of a drive: its name, how it is measured, and its unit.
pub(super) type Measure = (&'static str, fn(&Run) -> Option<f64>, &'static str);

/// The words of the report, by section.
pub(super) type Words = BTreeMap<String, SectionWords>;

/// The words of a section; a name in braces stands for one of its facts.
#[derive(Clone, Debug, Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct SectionWords {
    pub(super) title: String,
    /// Its text, in HTML.
    pub(super) intro: String,
    pub(super) claims: BTreeMap<String, ClaimWords>,
    #[serde(default)]
    pub(super) plates: BTreeMap<String, PlateWords>,
}

/// The words beside pictures that belong together.
#[derive(Clone, Debug, Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct PlateWords {
    /// Their subject.
    pub(super) title: String,
    /// What the paper's figure shows, in HTML.
    pub(super) paper: String,
    /// What ours shows, in HTML.
    pub(super) ours: String,
}

/// The words of the report, without facts.
///
/// # Errors
///
/// Words that are not of this form.
pub(super) fn words() -> Result<Words> {
    Ok(toml::from_str(include_str!("report/words.toml"))?)
}

/// A section of the report, with everything that was computed for it.
#[derive(Clone, Debug, Default)]
pub(super) struct Section {
    /// Its number, from 1.
    pub(super) number: usize,
    pub(super) words: SectionWords,
    /// What was computed for its words, by name.
    facts: BTreeMap<String, String>,
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
    pub(super) words: PlateWords,
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
    /// With these words and without content.
    pub(super) fn new(number: usize, words: SectionWords) -> Self {
        Self {
            number,
            words,
            ..Self::default()
        }
    }

    /// Notes a fact for the words that are said after it.
    pub(super) fn fact(&mut self, name: impl Into<String>, value: impl Into<String>) {
        self.facts.insert(name.into(), value.into());
    }

    /// Notes facts.
    pub(super) fn facts<const N: usize>(&mut self, facts: [(&str, String); N]) {
        for (name, fact) in facts {
            self.fact(name, fact);
        }
    }

    /// Notes the numbers of these cases and kinds of drives as facts, by names such as `lag outside car`.
    pub(super) fn measured(
        &mut self,
        drives: &Drives,
        (cases, kinds): (&[&str], &[&str]),
        measures: &[Measure],
    ) {
        for case in cases {
            for kind in kinds {
                for (name, measure, unit) in measures {
                    let value = drives.get(case, kind).and_then(measure);
                    self.fact(format!("{name} {case} {kind}"), told(value, unit));
                }
            }
        }
    }

    /// The text with the facts in the places of their names.
    pub(super) fn with_facts(&self, text: &str) -> String {
        let facts = self.facts.iter();
        facts.fold(text.to_owned(), |text, (name, fact)| {
            text.replace(&format!("{{{name}}}"), fact)
        })
    }

    /// Adds the claim with this name, without numbers yet.
    pub(super) fn claim(&mut self, id: &'static str) -> &mut Claim {
        let mut words = self.words.claims.remove(id).unwrap_or_default();
        for text in [&mut words.claim, &mut words.paper, &mut words.why] {
            *text = self.with_facts(text);
        }
        self.claims.push(Claim {
            id,
            section: self.number,
            words,
            quantities: Vec::new(),
            verdict: Verdict::NotMeasured,
            surprise: None,
        });
        let last = self.claims.len() - 1;
        &mut self.claims[last]
    }

    /// Adds a file of data.
    pub(super) fn table(&mut self, name: impl Into<String>, table: Table) {
        self.tables.push((name.into(), table));
    }

    /// Adds the plate with this name.
    pub(super) fn plate(&mut self, name: &str, pictures: Vec<Picture>) {
        let mut words = self.words.plates.remove(name).unwrap_or_default();
        words.ours = self.with_facts(&words.ours);
        self.plates.push(Plate { words, pictures });
    }

    /// The result, or a note on its error.
    pub(super) fn or_note<T, E: Display>(&mut self, what: &str, result: Result<T, E>) -> Option<T> {
        result
            .map_err(|error| self.notes.push(format!("{what}: {error}")))
            .ok()
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
    pub(super) fn keep(&mut self, what: &str, drive: Result<Run>) -> Option<Run> {
        let drive = drive.map_err(|error| format!("not driven: {error}"));
        let run = self.or_note(what, drive)?;
        if let Some(ended) = &run.ended {
            self.notes.push(format!("{what}: {ended}"));
        }
        Some(run)
    }
}

#[cfg(test)]
impl Section {
    /// With the words of a claim of the name `claim`, about these cars, in m.
    pub(super) fn with_claim(number: usize, scope: super::claims::Scope, claim: &str) -> Self {
        let words = ClaimWords {
            scope,
            claim: claim.to_owned(),
            paper: "none".to_owned(),
            unit: "m".to_owned(),
            why: "it is so".to_owned(),
        };
        let words = SectionWords {
            claims: [("claim".to_owned(), words)].into(),
            ..SectionWords::default()
        };
        Self::new(number, words)
    }
}
