//! A section of the report, which its experiments and analyses write: its pictures, its data, and the paper's
//! claims, each with its measured numbers and a verdict on them; and numbers as a reader wants them.

use std::fmt::{self, Display};

use serde::{Serialize, Serializer};
use singletrack_figures::figure::{Figure, minus, superscript};
use singletrack_scenario::simulate::{PlantKind, Scenario, trim_zeros};

use super::{
    Setup,
    drive::{self, Run},
};
use crate::{Result, Table};

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

/// The condition under which a number agrees. A number that is not finite never does.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Criterion {
    /// Near a value: within a tolerance.
    Near(f64, f64),
    /// Below a bound.
    Below(f64),
    /// Above a bound.
    Above(f64),
}

pub(super) use Criterion::{Above, Below, Near};

impl Criterion {
    fn holds(self, measured: f64) -> bool {
        match self {
            Self::Near(value, tolerance) => (measured - value).abs() <= tolerance,
            Self::Below(bound) => measured < bound,
            Self::Above(bound) => measured > bound,
        }
    }
}

impl fmt::Display for Criterion {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::Near(value, tolerance) if tolerance > 0.0 => {
                write!(formatter, "{} ± {}", number(value), number(tolerance))
            }
            Self::Near(value, _) => formatter.write_str(&number(value)),
            Self::Below(bound) => write!(formatter, "below {}", number(bound)),
            Self::Above(bound) => write!(formatter, "above {}", number(bound)),
        }
    }
}

impl Serialize for Criterion {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

/// A number that a claim is about.
#[derive(Clone, Debug, Serialize)]
pub(super) struct Quantity {
    /// What distinguishes it, such as the plant.
    pub(super) label: &'static str,
    /// The measured number; none if it was not measured.
    pub(super) value: Option<f64>,
    /// The condition for agreement with the paper.
    pub(super) agrees_if: Criterion,
    /// The correct value, where the paper has an error.
    pub(super) should_be: Option<Criterion>,
}

impl Quantity {
    fn meets(&self, criterion: Criterion) -> bool {
        self.value.is_some_and(|value| criterion.holds(value))
    }

    /// Why the number does not have the expected value: that of the paper, or only the correct one.
    fn surprise(&self, unit: &str) -> Option<String> {
        let wanted = self.should_be.unwrap_or(self.agrees_if);
        if self.meets(wanted) && (self.should_be.is_none() || !self.meets(self.agrees_if)) {
            return None;
        }
        let measured = self.value.map_or_else(|| "nothing".to_owned(), number);
        let text = format!("{} {measured} {unit} should be {wanted} {unit}", self.label);
        Some(text.trim().to_owned())
    }
}

/// The cars that a claim is about.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Scope {
    /// It follows from the equations and holds for every car.
    AnyCar,
    /// The number holds for the paper's car.
    PaperCar,
    /// It is about the paper's real car, of which there are no data: the simulated one stands in.
    RealCar,
    /// The paper is too vague for a comparison of numbers.
    Nobody,
}

/// A statement of the paper, and the verdict on it once it is judged.
#[derive(Clone, Debug, Serialize)]
pub(super) struct Claim {
    /// A short, permanent name.
    pub(super) id: &'static str,
    /// The number of the section that measures it.
    pub(super) section: usize,
    /// The cars that have a verdict.
    #[serde(skip)]
    pub(super) scope: Scope,
    pub(super) claim: String,
    /// The paper's words.
    pub(super) paper: String,
    /// The unit of its numbers.
    pub(super) unit: &'static str,
    /// The numbers that decide it. All must agree.
    #[serde(rename = "measured")]
    pub(super) quantities: Vec<Quantity>,
    pub(super) verdict: Verdict,
    /// Why it agrees, or does not.
    pub(super) why: String,
    /// Why the verdict is not the expected one; `None` if it is.
    pub(super) surprise: Option<String>,
}

/// Whether the measurements agree with the paper.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub(super) enum Verdict {
    Agrees,
    /// A claim about the real car agrees on the simulated one.
    AgreesInSimulation,
    Differs,
    /// The paper's number belongs to another car, or is not defined.
    NotComparable,
    NotMeasured,
}

impl Verdict {
    /// Its name in a table.
    pub(super) const fn name(self) -> &'static str {
        match self {
            Self::Agrees => "agrees",
            Self::AgreesInSimulation => "agrees in simulation",
            Self::Differs => "differs",
            Self::NotComparable => "n/a",
            Self::NotMeasured => "not measured",
        }
    }
}

impl Claim {
    /// A number, and when it agrees with the paper. One that is not finite counts as not measured.
    pub(super) fn number(
        &mut self,
        label: &'static str,
        value: impl Into<Option<f64>>,
        agrees_if: Criterion,
    ) -> &mut Self {
        self.quantities.push(Quantity {
            label,
            value: value.into().filter(|value| value.is_finite()),
            agrees_if,
            should_be: None,
        });
        self
    }

    /// A number that the paper has wrong, and what it should be.
    pub(super) fn slip(
        &mut self,
        label: &'static str,
        value: impl Into<Option<f64>>,
        agrees_if: Criterion,
        should_be: Criterion,
    ) -> &mut Self {
        self.number(label, value, agrees_if);
        if let Some(quantity) = self.quantities.last_mut() {
            quantity.should_be = Some(should_be);
        }
        self
    }

    /// Gives the verdict on its numbers; `paper_car` if they are of the paper's car.
    pub(super) fn judge(&mut self, paper_car: bool) {
        let comparable = match self.scope {
            Scope::AnyCar => true,
            Scope::PaperCar | Scope::RealCar => paper_car,
            Scope::Nobody => false,
        };
        let mut quantities = self.quantities.iter();
        let lacking = self.quantities.iter().find(|one| one.value.is_none());
        self.verdict = match (comparable, lacking) {
            (false, _) => Verdict::NotComparable,
            (true, Some(_)) => Verdict::NotMeasured,
            (true, None) if quantities.all(|one| one.meets(one.agrees_if)) => match self.scope {
                Scope::RealCar => Verdict::AgreesInSimulation,
                _ => Verdict::Agrees,
            },
            (true, None) => Verdict::Differs,
        };
        self.surprise = match lacking {
            // Another car may not be able to run every experiment of the paper's car.
            Some(_) if !paper_car && self.scope != Scope::AnyCar => None,
            Some(Quantity { label, .. }) => Some(format!(
                "{label} was not measured: see the notes of section {}",
                self.section
            )),
            None if comparable => {
                let mut quantities = self.quantities.iter();
                quantities.find_map(|quantity| quantity.surprise(self.unit))
            }
            None => None,
        };
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

    const ONE: Criterion = Near(1.0, 0.01);
    const LESS: Criterion = Near(0.894, 0.001);

    /// The verdict on a number, and whether it is unexpected.
    fn verdict(
        value: f64,
        should_be: Option<Criterion>,
        scope: Scope,
        paper_car: bool,
    ) -> (Verdict, bool) {
        let mut section = Section::new(3, "", "");
        let name = ("amplitude", scope, "m");
        let claim = section.claim(name, "The amplitude", "1 m", "");
        claim.number("ideal", value, ONE);
        claim.quantities[0].should_be = should_be;
        claim.judge(paper_car);
        (claim.verdict, claim.surprise.is_some())
    }

    #[test]
    fn a_number_within_the_tolerance_agrees_and_one_outside_differs() {
        let of = |measured| verdict(measured, None, Scope::AnyCar, true);
        assert_eq!(of(1.009), (Verdict::Agrees, false));
        assert_eq!(of(0.991), (Verdict::Agrees, false));
        assert_eq!(of(1.011), (Verdict::Differs, true));
        assert_eq!(of(f64::NAN), (Verdict::NotMeasured, true));
        assert_eq!(of(f64::INFINITY), (Verdict::NotMeasured, true));
    }

    #[test]
    fn what_is_said_of_the_real_car_agrees_in_simulation_only() {
        let of = |measured| verdict(measured, None, Scope::RealCar, true);
        assert_eq!(of(1.0), (Verdict::AgreesInSimulation, false));
        assert_eq!(of(2.0), (Verdict::Differs, true));
    }

    #[test]
    fn a_slip_is_no_surprise_unless_the_number_is_not_what_it_should_be_instead() {
        let of = |measured| verdict(measured, Some(LESS), Scope::AnyCar, true);
        assert_eq!(of(0.8944), (Verdict::Differs, false));
        assert_eq!(of(0.7), (Verdict::Differs, true));
        assert_eq!(of(1.0), (Verdict::Agrees, true));
        // It can't be what the paper says as well.
        assert_eq!(
            verdict(1.0, Some(ONE), Scope::AnyCar, true),
            (Verdict::Agrees, true)
        );
    }

    #[test]
    fn bounds_are_strict() {
        assert!(Below(90.0).holds(89.9) && !Below(90.0).holds(90.0));
        assert!(Above(0.0).holds(1e-9) && !Above(0.0).holds(0.0));
        assert!(!Below(0.0).holds(f64::NAN) && !Above(0.0).holds(f64::NAN));
    }

    #[test]
    fn the_papers_numbers_are_not_compared_with_another_car() {
        let of = |scope| verdict(5.0, None, scope, false);
        assert_eq!(of(Scope::PaperCar), (Verdict::NotComparable, false));
        assert_eq!(of(Scope::AnyCar), (Verdict::Differs, true));
    }

    #[test]
    fn a_number_that_the_paper_does_not_define_is_never_compared() {
        let of = |measured| verdict(measured, None, Scope::Nobody, true);
        assert_eq!(of(0.1), (Verdict::NotComparable, false));
        // The number must still be measured.
        assert_eq!(of(f64::NAN), (Verdict::NotComparable, true));
    }

    #[test]
    fn every_number_must_agree_and_a_surprise_names_the_one_that_does_not() {
        for (car, wanted, text) in [
            (Some(0.5), Verdict::Differs, "car 0.5 m should be"),
            (None, Verdict::NotMeasured, "car was not measured"),
        ] {
            let mut section = Section::new(3, "", "");
            let name = ("amplitude", Scope::AnyCar, "m");
            let claim = section.claim(name, "The amplitude", "1 m", "");
            claim.number("ideal", 1.0, ONE).number("car", car, ONE);
            claim.judge(true);
            assert_eq!(claim.verdict, wanted);
            let surprise = claim.surprise.as_deref().unwrap();
            assert!(surprise.starts_with(text), "{surprise}");
        }
    }

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
