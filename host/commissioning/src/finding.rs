//! What a step found.

use crate::Parameter;

/// What a step found, what it should be, and what to do about it.
#[derive(Clone, Debug)]
pub struct Finding {
    /// The step's name.
    pub step: &'static str,
    /// What it comes to.
    pub verdict: Verdict,
    /// What was found, with numbers.
    pub found: String,
    /// What it should be.
    pub expected: String,
    /// What to do; empty if there is nothing.
    pub fix: String,
    /// What was measured.
    pub parameters: Vec<Parameter>,
}

/// What a finding comes to.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Verdict {
    /// As it should be.
    Good,
    /// Not checked: the operator skipped it, or the car has no such part.
    Skipped,
    /// It works, and could be better.
    Warning,
    /// The car must not go on to the next procedure.
    Failed,
}

impl Verdict {
    /// Its word.
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
