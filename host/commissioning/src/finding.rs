//! The result of a step, or why it has none.

use std::borrow::Cow;

use serde::{Deserialize, Serialize};
use singletrack_core::reasons::Why;
use singletrack_protocol::StopCause;

use crate::{Interrupted, Parameter};

/// The result of a step: what it found, what was expected, and what to do.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Finding {
    /// The step's name, which the procedure fills in.
    pub step: Cow<'static, str>,
    /// The verdict.
    pub verdict: Verdict,
    /// What was found, with numbers.
    pub found: String,
    /// What was expected; where the step leaves it empty, what the procedure says of the step.
    pub expected: String,
    /// What to do; empty if there is nothing.
    pub fix: String,
    /// What was measured.
    pub parameters: Vec<Parameter>,
}

impl Finding {
    pub(crate) fn new(verdict: Verdict, found: impl Into<String>, fix: impl Into<String>) -> Self {
        Self {
            step: "".into(),
            verdict,
            found: found.into(),
            expected: String::new(),
            fix: fix.into(),
            parameters: Vec::new(),
        }
    }

    pub(crate) fn good(found: impl Into<String>) -> Self {
        Self::new(Verdict::Good, found, "")
    }

    pub(crate) fn warning(found: impl Into<String>, fix: impl Into<String>) -> Self {
        Self::new(Verdict::Warning, found, fix)
    }

    /// Good, or a failure, which `fix` removes.
    pub(crate) fn check(is_good: bool, found: impl Into<String>, fix: &str) -> Self {
        match is_good {
            true => Self::good(found),
            false => Self::new(Verdict::Failed, found, fix),
        }
    }

    /// A warning if `has_fault`, which `fix` removes; good otherwise.
    pub(crate) fn warning_if(has_fault: bool, found: impl Into<String>, fix: &str) -> Self {
        match has_fault {
            true => Self::warning(found, fix),
            false => Self::good(found),
        }
    }

    pub(crate) fn with(self, parameters: Vec<Parameter>) -> Self {
        Self { parameters, ..self }
    }
}

/// Why a step is not completed.
#[derive(Debug)]
pub enum Trouble {
    /// The procedure ends.
    Interrupted(Interrupted),
    /// The step fails.
    Failed {
        /// What was found.
        found: String,
        /// What to do.
        fix: String,
    },
    /// The operator skipped a question that the step needs.
    Skipped,
    /// The armed jog ended by itself.
    Ended {
        /// The board's reason.
        cause: StopCause,
        /// The reason for the operator.
        why: String,
    },
}

impl Trouble {
    /// What the step has found with it.
    pub(crate) fn finding(self) -> Result<Finding, Interrupted> {
        Ok(match self {
            Self::Interrupted(interrupted) => return Err(interrupted),
            Self::Failed { found, fix } => Finding::new(Verdict::Failed, found, fix),
            Self::Skipped => Finding::new(Verdict::Skipped, "skipped", ""),
            Self::Ended { cause, why } => {
                let mut found = format!("the jog ended: {why}");
                let mut advice = String::new();
                if cause != StopCause::None {
                    let stop = Why::of_word("board stop", cause.name());
                    found += &format!("; the board: {}", stop.text);
                    advice = stop.advice.unwrap_or_default();
                }
                let fix = format!("{advice} Run the bring-up again.");
                Finding::new(Verdict::Failed, found, fix.trim_start())
            }
        })
    }
}

impl From<Interrupted> for Trouble {
    fn from(interrupted: Interrupted) -> Self {
        Self::Interrupted(interrupted)
    }
}

pub(crate) fn failed(found: impl Into<String>, fix: impl Into<String>) -> Trouble {
    Trouble::Failed {
        found: found.into(),
        fix: fix.into(),
    }
}

/// Nothing, or a failure, which `fix` removes.
pub(crate) fn require(is_good: bool, found: impl Into<String>, fix: &str) -> Result<(), Trouble> {
    match is_good {
        true => Ok(()),
        false => Err(failed(found, fix)),
    }
}

/// What failed because of this word of the host, with its meaning and what to do.
pub(crate) fn stopped(what: &str, word: &str) -> Trouble {
    let why = Why::of_word("host", word);
    let advice = why.advice.unwrap_or_default();
    failed(
        format!("{what}: {}", why.text),
        format!("{advice} Run this step again.").trim_start(),
    )
}

/// The verdict of a finding.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
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
