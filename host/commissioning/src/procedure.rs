//! Runs the steps of a procedure in their order, and keeps their findings.

use crate::{Bench, Finding, Interrupted, Trouble, Verdict};

/// A step of a procedure.
#[derive(Clone, Copy)]
pub struct Step {
    /// Its name, such as `imu-axes`.
    pub name: &'static str,
    /// Its title, for the operator.
    pub title: &'static str,
    /// Whether nothing after it makes sense if it fails.
    pub essential: bool,
    /// What is expected, if every finding of the step is compared with the same.
    pub expected: &'static str,
    /// Runs it. It leaves a car that stands and is disarmed.
    pub run: fn(&mut dyn Bench) -> Result<Finding, Trouble>,
}

impl Step {
    /// An essential step.
    pub(crate) const fn new(
        name: &'static str,
        title: &'static str,
        run: fn(&mut dyn Bench) -> Result<Finding, Trouble>,
    ) -> Self {
        Self {
            name,
            title,
            essential: true,
            expected: "",
            run,
        }
    }

    /// The step whose every finding is compared with this.
    pub(crate) const fn expecting(self, expected: &'static str) -> Self {
        Self { expected, ..self }
    }

    /// The step, which may fail.
    pub(crate) const fn optional(self) -> Self {
        Self {
            essential: false,
            ..self
        }
    }

    /// Runs it, and disarms the car after any trouble.
    fn find(&self, bench: &mut dyn Bench) -> Result<Finding, Interrupted> {
        let finding = (self.run)(bench).or_else(|trouble| {
            // Refused where there is nothing to disarm; the daemon stops the car as well when the
            // connection ends.
            if !matches!(trouble, Trouble::Found(_)) {
                let _ = bench.disarm();
            }
            trouble.finding()
        })?;
        Ok(Finding {
            step: self.name.into(),
            expected: match finding.expected.is_empty() {
                true => self.expected.to_owned(),
                false => finding.expected,
            },
            ..finding
        })
    }
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
                let finding = step.find(bench)?;
                if let Some(interrupted) = bench.interrupted()
                    && finding.verdict == Verdict::Failed
                {
                    let _ = bench.disarm();
                    return Err(interrupted);
                }
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

#[cfg(test)]
mod tests {
    use std::cell::Cell;

    use singletrack_control::{Position, Velocity};
    use singletrack_core::Config;

    use super::*;
    use crate::{Answer, Attendance, Jog, Observation, Question, Refused};

    thread_local! {
        static RUNS: Cell<[u32; 3]> = const { Cell::new([0; 3]) };
        static FAILS: Cell<Option<usize>> = const { Cell::new(None) };
        static INTERRUPTS: Cell<Option<usize>> = const { Cell::new(None) };
    }

    fn number<const N: usize>(_: &mut dyn Bench) -> Result<Finding, Trouble> {
        let mut runs = RUNS.get();
        runs[N] += 1;
        RUNS.set(runs);
        if INTERRUPTS.get() == Some(N) {
            return Err(Interrupted::ByOperator.into());
        }
        let verdict = if FAILS.get() == Some(N) {
            Verdict::Failed
        } else {
            Verdict::Good
        };
        Ok(Finding::new(verdict, "", ""))
    }

    const STEPS: [Step; 3] = [
        Step::new("first", "", number::<0>),
        Step::new("second", "", number::<1>).optional(),
        Step::new("third", "", number::<2>),
    ];

    #[derive(Default)]
    struct Memory(Vec<Finding>);

    impl Journal for Memory {
        fn found(&self, step: &str) -> Option<Finding> {
            self.0.iter().find(|finding| finding.step == step).cloned()
        }

        fn keep(&mut self, finding: &Finding) -> Result<(), Interrupted> {
            self.0.push(finding.clone());
            Ok(())
        }

        fn begin(&mut self, _: &Step, _: usize, _: usize) {}
    }

    /// Counts what stops the car.
    struct NoCar {
        config: Config,
        disarmed: u32,
        is_interrupted: bool,
    }

    impl NoCar {
        fn new() -> Self {
            let text = include_str!("../../daemon/singletrackd.example.toml");
            Self {
                config: Config::from_toml(text).unwrap(),
                disarmed: 0,
                is_interrupted: false,
            }
        }
    }

    impl Bench for NoCar {
        fn wait(&mut self, _: &mut Vec<Observation>) -> Result<(), Interrupted> {
            Ok(())
        }

        fn ask(&mut self, _: &Question) -> Result<Answer, Interrupted> {
            Ok(Answer::Skip)
        }

        fn interrupted(&self) -> Option<Interrupted> {
            self.is_interrupted.then_some(Interrupted::ByOperator)
        }

        fn show(&mut self, _: &str, _: f64) {}

        fn arm(&mut self, _: Attendance) -> Result<(), Refused> {
            Ok(())
        }

        fn jog(&mut self, _: Jog) -> Result<(), Refused> {
            Ok(())
        }

        fn drive(&mut self, _: Velocity, _: Option<Position>) -> Result<(), Refused> {
            Ok(())
        }

        fn disarm(&mut self) -> Result<(), Refused> {
            self.disarmed += 1;
            Ok(())
        }

        fn emergency_stop(&mut self) -> Result<(), Refused> {
            Ok(())
        }

        fn configuration(&self) -> &Config {
            &self.config
        }

        fn change(&mut self, _: &[(&str, toml_edit::Value)]) -> Result<(), Refused> {
            Ok(())
        }
    }

    #[test]
    fn an_interrupted_procedure_disarms_and_resumes_where_it_was() {
        let (mut car, mut journal) = (NoCar::new(), Memory::default());
        INTERRUPTS.set(Some(1));
        assert!(run(&STEPS, &mut car, &mut journal).is_err());
        assert_eq!((RUNS.get(), car.disarmed), ([1, 1, 0], 1));
        INTERRUPTS.set(None);
        let findings = run(&STEPS, &mut car, &mut journal).unwrap();
        assert_eq!((RUNS.get(), car.disarmed), ([1, 2, 1], 1));
        let steps: Vec<_> = findings.iter().map(|finding| &*finding.step).collect();
        assert_eq!(steps, ["first", "second", "third"]);
    }

    #[test]
    fn a_step_that_failed_because_it_was_interrupted_has_found_nothing() {
        let (mut car, mut journal) = (NoCar::new(), Memory::default());
        car.is_interrupted = true;
        FAILS.set(Some(1));
        let result = run(&STEPS, &mut car, &mut journal);
        assert_eq!(result.unwrap_err(), Interrupted::ByOperator);
        assert_eq!((journal.0.len(), car.disarmed), (1, 1));
    }

    #[test]
    fn only_an_essential_step_that_fails_ends_a_procedure() {
        for (fails, count) in [(0, 1), (1, 3), (2, 3)] {
            FAILS.set(Some(fails));
            let findings = run(&STEPS, &mut NoCar::new(), &mut Memory::default()).unwrap();
            assert_eq!(findings.len(), count, "{fails}");
        }
    }
}
