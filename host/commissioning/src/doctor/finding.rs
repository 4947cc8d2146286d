//! Combines the checks of a step into one finding.

use super::gather::reset_if_stopped;
use crate::{Bench, Finding, Interrupted, Parameter, Refused, Trouble, Verdict, parameter::keys};

/// The checks of a step.
#[derive(Debug, Default)]
pub(super) struct Checks {
    verdict: Option<Verdict>,
    found: Vec<String>,
    expected: Vec<String>,
    fixes: Vec<String>,
    parameters: Vec<Parameter>,
}

impl Checks {
    /// A check that passed.
    pub(super) fn good(&mut self, found: impl Into<String>, expected: impl Into<String>) {
        self.add(Verdict::Good, found, expected, "");
    }

    /// A check that the operator skipped.
    pub(super) fn skipped(&mut self, what: &str) {
        self.add(Verdict::Skipped, format!("{what}: skipped"), "", "");
    }

    /// A check of something that works, but could be better. There is nothing left to fix if the
    /// doctor has corrected it.
    pub(super) fn warning(
        &mut self,
        found: impl Into<String>,
        expected: impl Into<String>,
        fix: impl Into<String>,
    ) {
        self.add(Verdict::Warning, found, expected, fix);
    }

    /// A check that failed.
    pub(super) fn failed(
        &mut self,
        found: impl Into<String>,
        expected: impl Into<String>,
        fix: impl Into<String>,
    ) {
        self.add(Verdict::Failed, found, expected, fix);
    }

    /// A check that passed or failed.
    pub(super) fn check(
        &mut self,
        is_good: bool,
        found: impl Into<String>,
        expected: impl Into<String>,
        fix: impl Into<String>,
    ) {
        if is_good {
            self.good(found, expected);
        } else {
            self.failed(found, expected, fix);
        }
    }

    /// A check that passed, or of something that could be better.
    pub(super) fn prefer(
        &mut self,
        is_good: bool,
        found: impl Into<String>,
        expected: impl Into<String>,
        fix: impl Into<String>,
    ) {
        if is_good {
            self.good(found, expected);
        } else {
            self.warning(found, expected, fix);
        }
    }

    /// The board has latched, because it mistook wheels that a hand rolled for a running motor.
    pub(super) fn latched(&mut self) {
        let found = "the board stopped: it mistook the rolled wheels for a running motor";
        let expected = "at most 1 m or 3 s of rolling without a pause";
        self.warning(found, expected, "press the reset button of the board");
    }

    pub(super) fn measured(&mut self, parameter: Parameter) {
        self.parameters.push(parameter);
    }

    pub(super) fn has_failed(&self) -> bool {
        self.verdict == Some(Verdict::Failed)
    }

    fn add(
        &mut self,
        verdict: Verdict,
        found: impl Into<String>,
        expected: impl Into<String>,
        fix: impl Into<String>,
    ) {
        self.verdict = Some(match (self.verdict, verdict) {
            // A partly checked step does not count as skipped.
            (Some(Verdict::Skipped), Verdict::Good) => Verdict::Good,
            (Some(Verdict::Good), Verdict::Skipped) => Verdict::Good,
            (Some(before), now) => before.max(now),
            (None, now) => now,
        });
        for (list, text) in [
            (&mut self.found, found.into()),
            (&mut self.expected, expected.into()),
            (&mut self.fixes, fix.into()),
        ] {
            if !text.is_empty() {
                list.push(text);
            }
        }
    }

    /// The finding of a step. Values that were measured are put into the configuration, unless
    /// the step failed.
    ///
    /// # Errors
    ///
    /// The operator interrupts, or the daemon is gone.
    pub(super) fn finding(mut self, bench: &mut dyn Bench) -> Result<Finding, Trouble> {
        let values = keys(&self.parameters);
        if !values.is_empty()
            && !self.has_failed()
            && let Err(refused) = put_in_force(bench, &values)?
        {
            let found = format!("the measured values are not in force: {refused}");
            let fix = "correct the value that the daemon refuses, and run this step again";
            self.failed(found, "in force", fix);
        }
        if self.has_failed() {
            // A value that is not in force must not count as written.
            for parameter in &mut self.parameters {
                parameter.key = None;
            }
        }
        Ok(Finding {
            expected: self.expected.join("; "),
            parameters: self.parameters,
            ..Finding::new(
                self.verdict.unwrap_or(Verdict::Skipped),
                self.found.join("; "),
                self.fixes.join("; "),
            )
        })
    }
}

/// Puts values in force. A stopped board accepts no configuration: it is reset first.
///
/// # Errors
///
/// The operator interrupts, or the daemon is gone.
pub(super) fn put_in_force(
    bench: &mut dyn Bench,
    values: &[(&str, toml_edit::Value)],
) -> Result<Result<(), Refused>, Interrupted> {
    if !reset_if_stopped(bench)? {
        let reason = "the board is stopped: it accepts no configuration before its reset";
        return Ok(Err(Refused(reason.to_owned())));
    }
    Ok(bench.change(values))
}
