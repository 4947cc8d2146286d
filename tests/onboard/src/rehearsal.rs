//! The procedures in virtual time, before the same car goes through them in real time.

use singletrack_commissioning::{
    Finding, Question, Verdict,
    edit::{Edit, EditError},
    run,
};
use toml_edit::Value;

use crate::{
    bench::{BenchError, VirtualBench},
    campaign::{NoJournal, procedures},
    car::OnboardCar,
};

/// What a step came to.
#[derive(Clone, Debug)]
pub struct RehearsedStep {
    /// Its procedure.
    pub procedure: &'static str,
    /// What it found.
    pub finding: Finding,
    /// What it wrote into the configuration.
    pub changes: Vec<(String, Value)>,
}

/// All steps of a car, and all questions.
#[derive(Clone, Debug)]
pub struct Rehearsal {
    /// The steps in their order.
    pub steps: Vec<RehearsedStep>,
    /// The questions, each once.
    pub questions: Vec<Question>,
    /// The configuration at the end.
    pub file: String,
}

/// Why a car did not come to the end.
#[derive(Debug, thiserror::Error)]
pub enum RehearsalError {
    /// There is no such car.
    #[error(transparent)]
    Bench(#[from] BenchError),
    /// A step failed.
    #[error("{step}: {found}")]
    Step {
        /// The step.
        step: String,
        /// What it found.
        found: String,
    },
    /// A value does not fit.
    #[error(transparent)]
    Edit(#[from] EditError),
}

impl Rehearsal {
    /// Takes the car through all procedures.
    ///
    /// # Errors
    ///
    /// A step fails.
    pub fn of(car: &OnboardCar) -> Result<Self, RehearsalError> {
        let mut bench = VirtualBench::new(car)?;
        let mut steps = Vec::new();
        for procedure in procedures() {
            for step in &procedure.steps {
                let before = bench.changes().len();
                let error = |found: String| RehearsalError::Step {
                    step: format!("{} {}", procedure.name, step.name),
                    found,
                };
                let findings = run(core::slice::from_ref(step), &mut bench, &mut NoJournal)
                    .map_err(|interrupted| error(interrupted.to_string()))?;
                for finding in findings {
                    if finding.verdict == Verdict::Failed {
                        return Err(error(finding.found));
                    }
                    steps.push(RehearsedStep {
                        procedure: procedure.name,
                        finding,
                        changes: bench.changes().get(before..).unwrap_or_default().to_vec(),
                    });
                }
            }
            bench.end_procedure();
        }
        Ok(Self {
            steps,
            questions: bench.questions().to_vec(),
            file: bench.file().to_owned(),
        })
    }

    /// Writes what these steps of a procedure wrote into a configuration.
    ///
    /// # Errors
    ///
    /// A value does not fit.
    pub fn apply(
        &self,
        procedure: &str,
        is_done: impl Fn(&str) -> bool,
        file: &mut Edit,
    ) -> Result<(), EditError> {
        let steps = self.steps.iter();
        for step in steps.filter(|step| step.procedure == procedure && is_done(&step.finding.step))
        {
            for (key, value) in &step.changes {
                file.set(key, value)?;
            }
        }
        Ok(())
    }

    /// The question whose text this is, but for its numbers.
    #[must_use]
    pub fn question(&self, text: &str) -> Option<&Question> {
        let without_numbers = |text: &str| text.replace(|c: char| c.is_ascii_digit(), "");
        let wanted = without_numbers(text);
        let mut questions = self.questions.iter();
        questions.find(|question| without_numbers(&question.text) == wanted)
    }
}
