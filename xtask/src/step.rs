//! Steps of a verification, with names and times.

use std::time::{Duration, Instant};

use crate::{
    prerequisites::Part,
    process::{Failure, check},
    workspace::cargo,
};

/// One check.
pub(crate) struct Step {
    pub(crate) name: &'static str,
    pub(crate) what: &'static str,
    /// The optional part of the checks that it belongs to.
    pub(crate) part: Option<Part>,
    /// Other parts whose prerequisites it needs.
    needs: Vec<Part>,
    run: Box<dyn Fn() -> Result<(), Failure>>,
}

impl Step {
    pub(crate) fn new(
        name: &'static str,
        what: &'static str,
        run: impl Fn() -> Result<(), Failure> + 'static,
    ) -> Self {
        Self {
            name,
            what,
            part: None,
            needs: Vec::new(),
            run: Box::new(run),
        }
    }

    /// A step that is one call of cargo.
    pub(crate) fn cargo(
        name: &'static str,
        what: &'static str,
        arguments: impl IntoIterator<Item = &'static str>,
    ) -> Self {
        let arguments: Vec<_> = arguments.into_iter().collect();
        Self::new(name, what, move || check(cargo().args(&arguments)))
    }

    pub(crate) fn of(mut self, part: Part) -> Self {
        self.part = Some(part);
        self
    }

    /// Adds the prerequisites of a part without making it belong to the part.
    pub(crate) fn needing(mut self, part: Option<Part>) -> Self {
        self.needs.extend(part);
        self
    }

    /// The parts whose prerequisites it needs.
    pub(crate) fn parts_needed(&self) -> impl Iterator<Item = Part> + '_ {
        self.part.iter().chain(&self.needs).copied()
    }
}

/// Runs the selected steps up to the first failure. Prints the time of each, and
/// the steps that were not run.
pub(crate) fn run_all(steps: &[Step], chosen: &dyn Fn(&Step) -> bool) -> Result<(), Failure> {
    let mut took = Vec::new();
    let mut result = Ok(());
    for step in steps.iter().filter(|step| chosen(step)) {
        println!("\n== {}: {}", step.name, step.what);
        let start = Instant::now();
        result = (step.run)()
            .map_err(|failure| Failure::new(format!("{} failed: {failure}", step.name)));
        took.push((step.name, start.elapsed()));
        println!("-- {}: {:.1} s", step.name, start.elapsed().as_secs_f64());
        if result.is_err() {
            break;
        }
    }
    println!();
    for (name, duration) in &took {
        println!("{name:>22}  {:>6.1} s", duration.as_secs_f64());
    }
    let total: Duration = took.iter().map(|(_, duration)| *duration).sum();
    println!("{:>22}  {:>6.1} s", "total", total.as_secs_f64());
    let ran: Vec<&str> = took.iter().map(|(name, _)| *name).collect();
    let not_run = not_run(steps, &ran);
    if !not_run.is_empty() {
        println!("\nNOT RUN: {}", not_run.join(", "));
    }
    result
}

/// The names of the steps that did not run.
fn not_run(steps: &[Step], ran: &[&str]) -> Vec<&'static str> {
    steps
        .iter()
        .map(|step| step.name)
        .filter(|name| !ran.contains(name))
        .collect()
}

#[cfg(test)]
mod tests {
    use std::{cell::RefCell, rc::Rc};

    use super::*;

    #[test]
    fn steps_run_in_order_up_to_the_first_failure() {
        let ran = Rc::new(RefCell::new(Vec::new()));
        let step = |name: &'static str, succeeds: bool| {
            let ran = Rc::clone(&ran);
            Step::new(name, "", move || {
                ran.borrow_mut().push(name);
                succeeds
                    .then_some(())
                    .ok_or_else(|| Failure::new("broken".to_owned()))
            })
        };
        let steps = [
            step("one", true),
            step("two", true).of(Part::Uno),
            step("three", false),
            step("four", true),
        ];
        let failure = run_all(&steps, &|step| step.part.is_none()).unwrap_err();
        assert_eq!(failure.to_string(), "three failed: broken");
        assert_eq!(*ran.borrow(), ["one", "three"]);
        assert_eq!(not_run(&steps, &ran.borrow()), ["two", "four"]);
    }
}
