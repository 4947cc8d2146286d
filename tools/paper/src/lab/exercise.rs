//! An exercise: its text, what is asked, and how an answer is judged.

use std::fmt;

use super::error::LabError;

/// A number that is asked for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Quantity {
    /// Its key in the file of answers.
    pub key: &'static str,
    /// Its unit.
    pub unit: &'static str,
}

/// What a check found: a value, which must lie in a range.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Finding {
    /// What it is, with its unit in words: `the error in mm`.
    pub(super) what: &'static str,
    pub(super) value: f64,
    pub(super) least: f64,
    pub(super) most: f64,
}

impl Finding {
    /// Whether the value lies in the range.
    pub(super) fn is_right(&self) -> bool {
        (self.least..=self.most).contains(&self.value)
    }
}

type Truth = Box<dyn Fn() -> Result<f64, LabError>>;
type Trial = Box<dyn Fn(&[f64]) -> Result<Vec<Finding>, LabError>>;

/// How an answer is judged.
pub(super) enum Judge {
    /// One number, within `tolerance` of the true one, as a share of it.
    Number { truth: Truth, tolerance: f64 },
    /// A choice of the student, which is tried.
    Choice(Trial),
}

/// An exercise.
pub struct Exercise {
    /// Its number: `1.2`.
    pub id: &'static str,
    /// The points that it is worth.
    pub points: u32,
    /// What is asked, with the student's numbers.
    pub text: String,
    /// The numbers that are asked for.
    pub quantities: Vec<Quantity>,
    /// What helps after a wrong answer.
    pub hint: &'static str,
    pub(super) judge: Judge,
}

impl Exercise {
    /// The share of the true value by which an answer may differ; none for a choice.
    #[must_use]
    pub fn tolerance(&self) -> Option<f64> {
        match self.judge {
            Judge::Number { tolerance, .. } => Some(tolerance),
            Judge::Choice(_) => None,
        }
    }

    /// The true value, by simulation or analysis; none for a choice.
    ///
    /// # Errors
    ///
    /// It can't be computed.
    pub fn truth(&self) -> Result<Option<f64>, LabError> {
        match &self.judge {
            Judge::Number { truth, .. } => truth().map(Some),
            Judge::Choice(_) => Ok(None),
        }
    }
}

impl fmt::Display for Exercise {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let points = if self.points == 1 { "point" } else { "points" };
        writeln!(f, "{} ({} {points})", self.id, self.points)?;
        writeln!(f, "{}", self.text)?;
        let asked: Vec<String> = self
            .quantities
            .iter()
            .map(|quantity| format!("{} in {}", quantity.key, quantity.unit))
            .collect();
        write!(f, "Answer: {}", asked.join(", "))?;
        match self.tolerance() {
            Some(tolerance) => write!(f, ", within {} %", percent(tolerance)),
            None => Ok(()),
        }
    }
}

/// A share as a percentage without needless digits.
pub(super) fn percent(share: f64) -> f64 {
    (share * 1e4).round() / 1e2
}
