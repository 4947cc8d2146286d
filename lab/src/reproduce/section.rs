//! A section of the report, which its experiments and analyses write.

use std::fmt::Display;

use singletrack_figures::figure::{Figure, minus, superscript};
use singletrack_scenario::simulate::{PlantKind, trim_zeros};

use super::{
    Setup,
    claims::{Claim, Scope, Verdict},
    drive::{DriveError, Experiment, Run},
};
use crate::table::Table;

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

    /// Adds a claim about any car, without numbers yet: what the paper says, in its words, and why
    /// it is so or not.
    pub(super) fn claim(
        &mut self,
        id: &'static str,
        unit: &'static str,
        claim: impl Into<String>,
        paper: impl Into<String>,
        why: impl Into<String>,
    ) -> &mut Claim {
        self.claims.push(Claim {
            id,
            section: self.number,
            scope: Scope::AnyCar,
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

/// A number in a sentence, with four significant digits; a plant that could not be driven has none.
pub(super) fn told(value: Option<f64>, unit: &str) -> String {
    let value = value.filter(|value| value.is_finite());
    value.map_or_else(
        || "(not driven)".to_owned(),
        |value| format!("{} {unit}", with_digits(value, 4)),
    )
}

/// A number with about five significant digits, without trailing zeros; very small and very large
/// ones as a power of ten.
pub(super) fn number(value: f64) -> String {
    with_digits(value, 5)
}

/// A number with the given number of significant digits, without trailing zeros; very small and
/// very large ones as a power of ten.
pub(super) fn with_digits(value: f64, digits: i32) -> String {
    if value == 0.0 {
        return "0".to_owned();
    }
    if !value.is_finite() {
        return if value.is_nan() {
            "not a number"
        } else {
            "∞"
        }
        .to_owned();
    }
    let size = value.abs();
    if (1e-3..1e6).contains(&size) {
        let decimals = usize::try_from(digits - 1 - size.log10().floor() as i32).unwrap_or(0);
        return minus(trim_zeros(&format!("{value:.decimals$}")).to_owned());
    }
    let short = usize::try_from(digits.min(3) - 1).unwrap_or(0);
    let text = format!("{value:.short$e}");
    let Some((mantissa, exponent)) = text.split_once('e') else {
        return text;
    };
    let (mantissa, power) = (trim_zeros(mantissa), superscript(exponent));
    minus(format!("{mantissa}×10{power}"))
}

/// A length given in m, in mm.
pub(super) fn mm(metres: f64) -> String {
    format!("{} mm", with_digits(metres * 1000.0, 3))
}

/// A length given in m, in m.
pub(super) fn metres(value: f64) -> String {
    format!("{} m", with_digits(value, 4))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_short_and_keep_their_size() {
        for (value, text) in [
            (0.0, "0"),
            (0.894_427_19, "0.89443"),
            (-0.142_728, "−0.14273"),
            (1.0, "1"),
            (120.0, "120"),
            (9680.0, "9680"),
            (7.1e-11, "7.1×10⁻¹¹"),
            (-2.5e7, "−2.5×10⁷"),
            (0.001_36, "0.00136"),
            (f64::INFINITY, "∞"),
        ] {
            assert_eq!(number(value), text);
        }
        assert_eq!(mm(0.000_135_977), "0.136 mm");
        assert_eq!(metres(0.246_4), "0.2464 m");
    }
}
