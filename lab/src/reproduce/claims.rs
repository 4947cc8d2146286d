//! Claims, measurements and verdicts.
//!
//! A claim is data: a quantity, and the criterion by which a number agrees with the
//! paper. Only [`judge`] gives verdicts.

use std::{collections::BTreeMap, fmt};

use serde::{Deserialize, Serialize};

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
///
/// As text `< a`, `> a` or `= a ± b`, where a value may be a product: `2 0.26`.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize, Serialize)]
#[serde(try_from = "String", into = "String")]
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

impl TryFrom<String> for Criterion {
    type Error = String;

    fn try_from(text: String) -> Result<Self, String> {
        let product = |factors: &str| {
            let factors = factors.trim().split(' ').map(str::parse::<f64>);
            factors.product::<Result<f64, _>>().ok()
        };
        let criterion = match text.split_at_checked(1) {
            Some(("<", bound)) => product(bound).map(Self::Below),
            Some((">", bound)) => product(bound).map(Self::Above),
            Some(("=", near)) => near.split_once('±').and_then(|(value, tolerance)| {
                Some(Self::Near {
                    value: product(value)?,
                    tolerance: product(tolerance)?,
                })
            }),
            _ => None,
        };
        criterion.ok_or_else(|| format!("{text:?} is no criterion"))
    }
}

impl From<Criterion> for String {
    fn from(criterion: Criterion) -> Self {
        criterion.to_string()
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
#[derive(Clone, Debug, Deserialize, Serialize)]
pub struct Quantity {
    /// What distinguishes it, such as the plant.
    pub label: String,
    /// Its name among the [`Measurements`].
    #[serde(rename = "quantity")]
    pub name: String,
    /// The measured number; none if it was not measured.
    #[serde(skip_deserializing)]
    pub value: Option<f64>,
    /// The condition for agreement with the paper.
    #[serde(rename = "agrees_if")]
    pub agrees: Criterion,
    /// The correct value, where the paper has an error.
    #[serde(default, rename = "should_be")]
    pub instead: Option<Criterion>,
}

impl Quantity {
    /// Whether the number is measured and meets the criterion.
    fn meets(&self, criterion: Criterion) -> bool {
        self.value.is_some_and(|value| criterion.holds(value))
    }

    /// Why the number does not have the expected value: that of the paper, or the correct one.
    fn surprise(&self, unit: &str) -> Option<String> {
        let wanted = self.instead.unwrap_or(self.agrees);
        if self.meets(wanted) {
            return None;
        }
        let measured = self.value.map_or_else(|| "nothing".to_owned(), number);
        let text = format!("{} {measured} {unit} should be {wanted} {unit}", self.label);
        Some(text.trim().to_owned())
    }
}

/// The cars that a claim is about.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Scope {
    /// It follows from the equations and holds for every car.
    #[default]
    AnyCar,
    /// The number holds for the paper's car.
    PaperCar,
    /// The paper is too vague for a comparison of numbers.
    Nobody,
}

/// A statement of the paper, and the verdict on it once it is judged.
#[derive(Clone, Debug, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Claim {
    /// A short, permanent name.
    pub id: String,
    /// The number of the section that measures it.
    pub section: usize,
    /// The cars that have a verdict.
    #[serde(default, skip_serializing)]
    pub scope: Scope,
    /// The claim.
    pub claim: String,
    /// The paper's words.
    pub paper: String,
    /// The unit of its numbers.
    #[serde(default)]
    pub unit: String,
    /// The numbers that decide it. All must agree.
    #[serde(rename(serialize = "measured"))]
    pub quantities: Vec<Quantity>,
    /// The verdict.
    #[serde(skip_deserializing)]
    pub verdict: Verdict,
    /// Why it agrees, or does not.
    pub why: String,
    /// Why the verdict is not the expected one; `None` if it is.
    #[serde(skip_deserializing)]
    pub surprise: Option<String>,
}

/// Whether the measurements agree with the paper.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Verdict {
    /// They agree.
    Agrees,
    /// They do not agree.
    Differs,
    /// The paper's number belongs to another car, or is not defined.
    NotComparable,
    /// There is nothing to compare.
    #[default]
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

/// Gives each claim its numbers and its verdict; `paper_car` if they are of the paper's car.
#[must_use]
pub fn judge(mut claims: Vec<Claim>, measurements: &Measurements, paper_car: bool) -> Vec<Claim> {
    for claim in &mut claims {
        claim.judge(measurements, paper_car);
    }
    claims
}

impl Claim {
    fn judge(&mut self, measurements: &Measurements, paper_car: bool) {
        // The simulated car has tolerances for the paper's car.
        let has_car = paper_car || self.scope == Scope::PaperCar;
        self.quantities
            .retain(|quantity| has_car || !quantity.name.ends_with(".car"));
        for quantity in &mut self.quantities {
            quantity.value = measurements.get(&quantity.name);
        }
        let comparable = match self.scope {
            Scope::AnyCar => true,
            Scope::PaperCar => paper_car,
            Scope::Nobody => false,
        };
        let mut quantities = self.quantities.iter();
        let lacking = self.quantities.iter().find(|one| one.value.is_none());
        self.verdict = match (comparable, lacking) {
            (false, _) => Verdict::NotComparable,
            (true, Some(_)) => Verdict::NotMeasured,
            (true, None) if quantities.all(|one| one.meets(one.agrees)) => Verdict::Agrees,
            (true, None) => Verdict::Differs,
        };
        self.surprise = match lacking {
            // Another car may not be able to run every experiment of the paper's car.
            Some(_) if !paper_car && self.scope != Scope::AnyCar => None,
            Some(Quantity { name, .. }) => Some(format!(
                "{name} was not measured: see the notes of section {}",
                self.section
            )),
            None if comparable => {
                let mut quantities = self.quantities.iter();
                quantities.find_map(|quantity| quantity.surprise(&self.unit))
            }
            None => None,
        };
    }
}

/// The number of unexpected verdicts.
#[must_use]
pub fn surprises(claims: &[Claim]) -> usize {
    let surprising = claims.iter().filter(|claim| claim.surprise.is_some());
    surprising.count()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn claim(agrees: Criterion, instead: Option<Criterion>, scope: Scope) -> Claim {
        Claim {
            id: "amplitude".to_owned(),
            section: 3,
            scope,
            claim: "The amplitude".to_owned(),
            paper: "1 m".to_owned(),
            unit: "m".to_owned(),
            quantities: vec![Quantity {
                label: "ideal".to_owned(),
                name: "amplitude".to_owned(),
                value: None,
                agrees,
                instead,
            }],
            verdict: Verdict::NotMeasured,
            why: String::new(),
            surprise: None,
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
    fn a_criterion_is_read_from_text_and_its_values_may_be_products() {
        let read = |text: &str| Criterion::try_from(text.to_owned());
        assert_eq!(read("< 0"), Ok(Criterion::Below(0.0)));
        assert_eq!(read("> 2 -0.13"), Ok(Criterion::Above(-0.26)));
        let near = Criterion::Near {
            value: 0.5,
            tolerance: 1e-3,
        };
        assert_eq!(read("= 2 0.25 ± 1e-3"), Ok(near));
        for text in ["", "1", "= 1", "< {radius}", "± 1"] {
            let error = read(text).unwrap_err();
            assert!(error.contains(text), "{error}");
        }
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
            name: "amplitude.car".to_owned(),
            ..both.quantities[0].clone()
        });
        let mut measurements = Measurements::default();
        measurements.add("amplitude", 1.0);
        let of = |paper_car| judge(vec![both.clone()], &measurements, paper_car);
        assert_eq!(of(false)[0].verdict, Verdict::Agrees);
        let values: Vec<_> = of(false)[0]
            .quantities
            .iter()
            .map(|one| one.value)
            .collect();
        assert_eq!(values, [Some(1.0)]);
        assert_eq!(of(true)[0].verdict, Verdict::NotMeasured);
    }

    #[test]
    fn one_quantity_that_differs_is_enough() {
        let mut both = claim(ONE, None, Scope::AnyCar);
        both.quantities.push(Quantity {
            label: "car".to_owned(),
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
