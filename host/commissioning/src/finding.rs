//! The result of a step.

use crate::Parameter;

/// The result of a step: what it found, what was expected, and what to do.
#[derive(Clone, Debug)]
pub struct Finding {
    /// The step's name.
    pub step: &'static str,
    /// The verdict.
    pub verdict: Verdict,
    /// What was found, with numbers.
    pub found: String,
    /// What was expected.
    pub expected: String,
    /// What to do; empty if there is nothing.
    pub fix: String,
    /// What was measured.
    pub parameters: Vec<Parameter>,
}

/// The verdict of a finding.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Verdict {
    /// As it should be.
    Good,
    /// Not checked: the operator skipped it, or the car has no such part.
    Skipped,
    /// It works, but could be better.
    Warning,
    /// The next procedure must not begin.
    Failed,
}

impl Verdict {
    /// Its name in reports.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Good => "good",
            Self::Skipped => "skipped",
            Self::Warning => "warning",
            Self::Failed => "failed",
        }
    }
}
