//! Steps, one after the other, and what is kept of them.

use crate::{Bench, Finding, Interrupted, Verdict};

/// A step of a procedure.
#[derive(Clone, Copy)]
pub struct Step {
    /// Its name, such as `imu-axes`.
    pub name: &'static str,
    /// What it is, for people.
    pub title: &'static str,
    /// Whether nothing after it makes sense if it fails.
    pub essential: bool,
    /// Runs it. It leaves a car that stands and is disarmed.
    pub run: fn(&mut dyn Bench) -> Result<Finding, Interrupted>,
}

/// Keeps the findings of a procedure from one start to the next.
pub trait Journal {
    /// What this step found before, if that still holds.
    fn found(&self, step: &str) -> Option<Finding>;

    /// Keeps what a step found.
    ///
    /// # Errors
    ///
    /// It could not be kept.
    fn keep(&mut self, finding: &Finding) -> Result<(), Interrupted>;

    /// A step begins, the first is number 1.
    fn begin(&mut self, step: &Step, number: usize, of: usize);
}

/// Runs the steps that have not been done yet, and gives the findings of all. It ends early
/// after an essential step that fails, and leaves the car disarmed in any case.
///
/// # Errors
///
/// The operator interrupts, or the daemon is gone.
pub fn run(
    steps: &[Step],
    bench: &mut dyn Bench,
    journal: &mut dyn Journal,
) -> Result<Vec<Finding>, Interrupted> {
    let mut findings = Vec::new();
    for (index, step) in steps.iter().enumerate() {
        let finding = match journal.found(step.name) {
            Some(finding) => finding,
            None => {
                journal.begin(step, index + 1, steps.len());
                let result = (step.run)(bench);
                if result.is_err() {
                    // The daemon stops the car as well when the connection ends.
                    let _ = bench.disarm();
                }
                let finding = result?;
                journal.keep(&finding)?;
                finding
            }
        };
        let ends = step.essential && finding.verdict == Verdict::Failed;
        findings.push(finding);
        if ends {
            break;
        }
    }
    Ok(findings)
}
