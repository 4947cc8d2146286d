//! The outcome of a step, and the questions that it asks.

use singletrack_protocol::StopCause;

use crate::{Answer, Bench, Finding, Interrupted, Parameter, Question, Refused, Step, Verdict};

/// Why a step is not completed.
#[derive(Debug)]
pub(super) enum Trouble {
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
    /// The jog ended by itself.
    Ended {
        /// The board's reason.
        cause: StopCause,
        /// The reason for the operator.
        why: String,
    },
}

impl From<Interrupted> for Trouble {
    fn from(interrupted: Interrupted) -> Self {
        Self::Interrupted(interrupted)
    }
}

pub(super) fn failed(found: impl Into<String>, fix: impl Into<String>) -> Trouble {
    Trouble::Failed {
        found: found.into(),
        fix: fix.into(),
    }
}

/// The result of a completed step.
#[derive(Debug)]
pub(super) struct Outcome {
    pub(super) verdict: Verdict,
    pub(super) found: String,
    pub(super) fix: String,
    pub(super) parameters: Vec<Parameter>,
}

impl Outcome {
    pub(super) fn good(found: impl Into<String>) -> Self {
        Self {
            verdict: Verdict::Good,
            found: found.into(),
            fix: String::new(),
            parameters: Vec::new(),
        }
    }

    pub(super) fn warning(found: impl Into<String>, fix: impl Into<String>) -> Self {
        Self {
            verdict: Verdict::Warning,
            fix: fix.into(),
            ..Self::good(found)
        }
    }

    pub(super) fn with(mut self, parameters: Vec<Parameter>) -> Self {
        self.parameters = parameters;
        self
    }
}

/// A step. Each relies on the ones before it, so all are essential.
pub(super) const fn step(
    name: &'static str,
    title: &'static str,
    run: fn(&mut dyn Bench) -> Result<Finding, Interrupted>,
) -> Step {
    Step {
        name,
        title,
        essential: true,
        run,
    }
}

/// Makes a finding of the outcome of a step, and disarms the car after any trouble.
pub(super) fn conclude(
    bench: &mut dyn Bench,
    step: &Step,
    expected: &str,
    find: impl FnOnce(&mut dyn Bench) -> Result<Outcome, Trouble>,
) -> Result<Finding, Interrupted> {
    let outcome = match find(bench) {
        Ok(outcome) => outcome,
        Err(trouble) => {
            // Refused where there is nothing to disarm.
            let _ = bench.disarm();
            let (verdict, found, fix) = match trouble {
                Trouble::Interrupted(interrupted) => return Err(interrupted),
                Trouble::Failed { found, fix } => (Verdict::Failed, found, fix),
                Trouble::Skipped => (Verdict::Skipped, "skipped".into(), String::new()),
                Trouble::Ended { why, .. } => (
                    Verdict::Failed,
                    format!("the jog ended: {why}"),
                    "See docs/reasons.md for the word, and run the bring-up again.".into(),
                ),
            };
            Outcome {
                verdict,
                found,
                fix,
                parameters: Vec::new(),
            }
        }
    };
    Ok(Finding {
        step: step.name,
        verdict: outcome.verdict,
        found: outcome.found,
        expected: expected.into(),
        fix: outcome.fix,
        parameters: outcome.parameters,
    })
}

/// Puts values in force.
pub(super) fn change(
    bench: &mut dyn Bench,
    values: &[(&str, toml_edit::Value)],
) -> Result<(), Trouble> {
    bench.change(values).map_err(|Refused(why)| {
        let keys: Vec<_> = values.iter().map(|(key, _)| *key).collect();
        failed(
            format!("{} can't be changed: {why}", keys.join(", ")),
            "Correct the configuration file as the message says, and run the bring-up again.",
        )
    })
}

/// Asks a question that must not be skipped.
pub(super) fn ask(bench: &mut dyn Bench, question: &Question) -> Result<Answer, Trouble> {
    match bench.ask(question)? {
        Answer::Skip => Err(Trouble::Skipped),
        answer => Ok(answer),
    }
}

/// Asks for yes or no.
pub(super) fn ask_yes(bench: &mut dyn Bench, question: &Question) -> Result<bool, Trouble> {
    Ok(ask(bench, question)? == Answer::YesNo(true))
}

/// Asks for one of several words.
pub(super) fn ask_word<'a>(
    bench: &mut dyn Bench,
    question: &Question,
    words: &[&'a str],
) -> Result<&'a str, Trouble> {
    match ask(bench, question)? {
        Answer::Choice(index) => words.get(index).copied().ok_or(Trouble::Skipped),
        _ => Err(Trouble::Skipped),
    }
}

/// Asks for a number.
pub(super) fn ask_number(bench: &mut dyn Bench, question: &Question) -> Result<f64, Trouble> {
    match ask(bench, question)? {
        Answer::Number(number) => Ok(number),
        _ => Err(Trouble::Skipped),
    }
}
