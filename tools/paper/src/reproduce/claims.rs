//! Claims, measurements and verdicts.
//!
//! A claim is data: a quantity, and the criterion by which a number agrees with the
//! paper. Only [`judge`] gives verdicts.

use std::{collections::BTreeMap, fmt};

use serde::Serialize;

use super::text::number;

/// The measured numbers, by name.
#[derive(Clone, Debug, Default)]
pub struct Measurements(BTreeMap<String, f64>);

impl Measurements {
    /// Adds a number. One that is not finite counts as not measured.
    pub fn add(&mut self, name: impl Into<String>, value: f64) {
        if value.is_finite() {
            self.0.insert(name.into(), value);
        }
    }

    /// Adds all numbers of another.
    pub fn extend(&mut self, other: Self) {
        self.0.extend(other.0);
    }

    /// The number of this name, if it was measured.
    #[must_use]
    pub fn get(&self, name: &str) -> Option<f64> {
        self.0.get(name).copied()
    }
}

/// The condition under which a number agrees. A number that is not finite never does.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Criterion {
    /// Within a tolerance of a value.
    Near {
        /// The value.
        value: f64,
        /// The largest difference.
        tolerance: f64,
    },
    /// Below a bound.
    Below(f64),
    /// Above a bound.
    Above(f64),
}

impl Criterion {
    /// Whether the number meets the condition.
    #[must_use]
    pub fn holds(self, measured: f64) -> bool {
        if !measured.is_finite() {
            return false;
        }
        match self {
            Self::Near { value, tolerance } => (measured - value).abs() <= tolerance,
            Self::Below(bound) => measured < bound,
            Self::Above(bound) => measured > bound,
        }
    }
}

impl fmt::Display for Criterion {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::Near {
                value,
                tolerance: 0.0,
            } => {
                write!(formatter, "{}", number(value))
            }
            Self::Near { value, tolerance } => {
                write!(formatter, "{} ± {}", number(value), number(tolerance))
            }
            Self::Below(bound) => write!(formatter, "below {}", number(bound)),
            Self::Above(bound) => write!(formatter, "above {}", number(bound)),
        }
    }
}

/// A number that a claim is about.
#[derive(Clone, Debug)]
pub struct Quantity {
    /// What distinguishes it, such as the plant; empty if the claim has one number only.
    pub label: &'static str,
    /// Its name among the [`Measurements`].
    pub name: String,
    /// The condition for agreement with the paper.
    pub agrees: Criterion,
    /// The correct value, where the paper has an error.
    pub instead: Option<Criterion>,
    /// Whether it comes from the simulated car, with tolerances for the paper's car; it is
    /// left out for other cars.
    pub of_paper_car: bool,
}

/// The cars that a claim is about.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Scope {
    /// It follows from the equations and holds for every car.
    AnyCar,
    /// The number holds for the paper's car.
    PaperCar,
    /// The paper is too vague for a comparison of numbers.
    Nobody,
}

/// A statement of the paper.
#[derive(Clone, Debug)]
pub struct Claim {
    /// A short, permanent name.
    pub id: &'static str,
    /// The number of the section that measures it.
    pub section: usize,
    /// The claim.
    pub claim: String,
    /// The paper's words.
    pub paper: String,
    /// The numbers that decide it. All must agree.
    pub quantities: Vec<Quantity>,
    /// Their unit.
    pub unit: &'static str,
    /// The cars that have a verdict.
    pub scope: Scope,
    /// Why it agrees, or does not.
    pub why: String,
}

impl Claim {
    /// Whether it is a known error of the paper.
    #[must_use]
    pub fn is_slip(&self) -> bool {
        self.quantities
            .iter()
            .any(|quantity| quantity.instead.is_some())
    }
}

/// Whether the measurements agree with the paper.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Verdict {
    /// They agree.
    Agrees,
    /// They do not agree.
    Differs,
    /// The paper's number belongs to another car, or is not defined.
    NotComparable,
    /// There is nothing to compare.
    NotMeasured,
}

impl Verdict {
    /// Its name in a table.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Agrees => "agrees",
            Self::Differs => "differs",
            Self::NotComparable => "n/a",
            Self::NotMeasured => "not measured",
        }
    }
}

/// A claim with its verdict.
#[derive(Clone, Debug)]
pub struct Judged {
    /// The claim.
    pub claim: Claim,
    /// The number of each of its quantities.
    pub measured: Vec<Option<f64>>,
    /// The verdict.
    pub verdict: Verdict,
    /// Why the verdict is not the expected one; `None` if it is.
    pub surprise: Option<String>,
}

/// Compares claims with measurements; `paper_car` if these are of the paper's car.
#[must_use]
pub fn judge(claims: Vec<Claim>, measurements: &Measurements, paper_car: bool) -> Vec<Judged> {
    claims
        .into_iter()
        .map(|claim| judge_one(claim, measurements, paper_car))
        .collect()
}

fn judge_one(mut claim: Claim, measurements: &Measurements, paper_car: bool) -> Judged {
    claim
        .quantities
        .retain(|quantity| paper_car || !quantity.of_paper_car);
    let measured: Vec<Option<f64>> = claim
        .quantities
        .iter()
        .map(|quantity| measurements.get(&quantity.name))
        .collect();
    let comparable = match claim.scope {
        Scope::AnyCar => true,
        Scope::PaperCar => paper_car,
        Scope::Nobody => false,
    };
    let pairs = || claim.quantities.iter().zip(&measured);
    let lacking = pairs().find(|(_, value)| value.is_none());
    let verdict = match (comparable, &lacking) {
        (false, _) => Verdict::NotComparable,
        (true, Some(_)) => Verdict::NotMeasured,
        (true, None) if pairs().all(|(quantity, value)| holds(quantity.agrees, *value)) => {
            Verdict::Agrees
        }
        (true, None) => Verdict::Differs,
    };
    let surprise = if let Some((quantity, _)) = lacking {
        // Another car may not be able to run every experiment of the paper's car.
        (paper_car || claim.scope == Scope::AnyCar).then(|| {
            format!(
                "{} was not measured: see the notes of section {}",
                quantity.name, claim.section
            )
        })
    } else if comparable {
        pairs().find_map(|(quantity, value)| unexpected(quantity, *value, claim.unit))
    } else {
        None
    };
    Judged {
        measured,
        verdict,
        surprise,
        claim,
    }
}

fn holds(criterion: Criterion, measured: Option<f64>) -> bool {
    measured.is_some_and(|measured| criterion.holds(measured))
}

/// Why a number does not have the expected value: that of the paper, or the correct one.
fn unexpected(quantity: &Quantity, measured: Option<f64>, unit: &str) -> Option<String> {
    let wanted = quantity.instead.unwrap_or(quantity.agrees);
    if !holds(wanted, measured) {
        let measured = measured.map_or_else(|| "nothing".to_owned(), number);
        return Some(
            format!(
                "{} {measured} {unit} should be {wanted} {unit}",
                quantity.label
            )
            .trim()
            .to_owned(),
        );
    }
    None
}

/// The number of unexpected verdicts.
#[must_use]
pub fn surprises(judged: &[Judged]) -> usize {
    judged
        .iter()
        .filter(|judged| judged.surprise.is_some())
        .count()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn claim(agrees: Criterion, instead: Option<Criterion>, scope: Scope) -> Claim {
        Claim {
            id: "amplitude",
            section: 3,
            claim: "The amplitude".to_owned(),
            paper: "1 m".to_owned(),
            quantities: vec![Quantity {
                label: "ideal",
                name: "amplitude".to_owned(),
                agrees,
                instead,
                of_paper_car: false,
            }],
            unit: "m",
            scope,
            why: String::new(),
        }
    }

    fn verdict(claim: Claim, measured: Option<f64>, paper_car: bool) -> (Verdict, bool) {
        let mut measurements = Measurements::default();
        if let Some(value) = measured {
            measurements.add("amplitude", value);
        }
        let judged = judge(vec![claim], &measurements, paper_car);
        (judged[0].verdict, judged[0].surprise.is_some())
    }

    const ONE: Criterion = Criterion::Near {
        value: 1.0,
        tolerance: 0.01,
    };
    const LESS: Criterion = Criterion::Near {
        value: 0.894,
        tolerance: 0.001,
    };

    #[test]
    fn a_number_within_the_tolerance_agrees_and_one_outside_differs() {
        let of = |measured| verdict(claim(ONE, None, Scope::AnyCar), Some(measured), true);
        assert_eq!(of(1.009), (Verdict::Agrees, false));
        assert_eq!(of(0.991), (Verdict::Agrees, false));
        assert_eq!(of(1.011), (Verdict::Differs, true));
        assert_eq!(of(f64::NAN), (Verdict::NotMeasured, true));
        assert_eq!(of(f64::INFINITY), (Verdict::NotMeasured, true));
    }

    #[test]
    fn a_slip_is_no_surprise_unless_the_number_is_not_what_it_should_be_instead() {
        let of = |measured| verdict(claim(ONE, Some(LESS), Scope::AnyCar), Some(measured), true);
        assert_eq!(of(0.8944), (Verdict::Differs, false));
        assert_eq!(of(0.7), (Verdict::Differs, true));
        assert_eq!(of(1.0), (Verdict::Agrees, true));
    }

    #[test]
    fn bounds_are_strict() {
        assert!(Criterion::Below(90.0).holds(89.9) && !Criterion::Below(90.0).holds(90.0));
        assert!(Criterion::Above(0.0).holds(1e-9) && !Criterion::Above(0.0).holds(0.0));
        assert!(!Criterion::Below(0.0).holds(f64::NAN) && !Criterion::Above(0.0).holds(f64::NAN));
    }

    #[test]
    fn the_papers_numbers_are_not_compared_with_another_car() {
        let of = |scope| verdict(claim(ONE, None, scope), Some(5.0), false);
        assert_eq!(of(Scope::PaperCar), (Verdict::NotComparable, false));
        assert_eq!(of(Scope::AnyCar), (Verdict::Differs, true));
    }

    #[test]
    fn a_number_that_the_paper_does_not_define_is_never_compared() {
        let of = |measured| verdict(claim(ONE, None, Scope::Nobody), measured, true);
        assert_eq!(of(Some(0.1)), (Verdict::NotComparable, false));
        // The number must still be measured.
        assert_eq!(of(None), (Verdict::NotComparable, true));
    }

    #[test]
    fn what_was_not_measured_is_a_surprise_that_names_it() {
        let claims = vec![claim(ONE, None, Scope::PaperCar)];
        let judged = judge(claims, &Measurements::default(), true);
        assert_eq!(judged[0].verdict, Verdict::NotMeasured);
        let surprise = judged[0].surprise.as_deref().unwrap();
        assert!(surprise.starts_with("amplitude was not"), "{surprise}");
        assert_eq!(surprises(&judged), 1);
    }

    #[test]
    fn what_is_of_the_simulated_car_is_left_out_for_another() {
        let mut both = claim(ONE, None, Scope::AnyCar);
        both.quantities.push(Quantity {
            name: "car".to_owned(),
            of_paper_car: true,
            ..both.quantities[0].clone()
        });
        let mut measurements = Measurements::default();
        measurements.add("amplitude", 1.0);
        let of = |paper_car| judge(vec![both.clone()], &measurements, paper_car);
        assert_eq!(of(false)[0].verdict, Verdict::Agrees);
        assert_eq!(of(false)[0].measured, [Some(1.0)]);
        assert_eq!(of(true)[0].verdict, Verdict::NotMeasured);
    }

    #[test]
    fn one_quantity_that_differs_is_enough() {
        let mut both = claim(ONE, None, Scope::AnyCar);
        both.quantities.push(Quantity {
            label: "car",
            name: "car".to_owned(),
            ..both.quantities[0].clone()
        });
        let mut measurements = Measurements::default();
        measurements.add("amplitude", 1.0);
        measurements.add("car", 0.5);
        let judged = judge(vec![both], &measurements, true);
        assert_eq!(judged[0].verdict, Verdict::Differs);
        let surprise = judged[0].surprise.as_deref().unwrap();
        assert!(surprise.contains("car 0.5 m"), "{surprise}");
    }
}
