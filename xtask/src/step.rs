//! Steps of a verification, with names and times.

use std::{process::Command, time::Instant};

use crate::{
    beside::Beside,
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
    /// When it runs.
    turn: Turn,
    run: Box<dyn Fn() -> Result<(), Failure>>,
}

/// When a step runs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Turn {
    /// After the steps before it.
    Next,
    /// In a process of its own, while those after it run.
    Beside,
    /// After all steps before it, also those in other processes: it measures real time.
    Quiet,
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
            turn: Turn::Next,
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

    /// Lets it run in a process of its own, while those after it run.
    pub(crate) fn beside(mut self) -> Self {
        self.turn = Turn::Beside;
        self
    }

    /// Lets it wait for what runs beside others.
    pub(crate) fn quiet(mut self) -> Self {
        self.turn = Turn::Quiet;
        self
    }

    /// The parts whose prerequisites it needs.
    pub(crate) fn parts_needed(&self) -> impl Iterator<Item = Part> + '_ {
        self.part.iter().chain(&self.needs).copied()
    }
}

/// Runs the selected steps up to the first failure. `other` is this program with these steps
/// alone: it runs those that go beside others. Prints the time of each, and the steps that were
/// not run.
pub(crate) fn run_all(
    steps: &[Step],
    chosen: &dyn Fn(&Step) -> bool,
    other: &dyn Fn(&[&'static str]) -> Command,
) -> Result<(), Failure> {
    let begin = Instant::now();
    let mut took = Vec::new();
    let mut result = Ok(());
    let mut beside: Option<Beside> = None;
    let mut rest = steps.iter().filter(|step| chosen(step)).peekable();
    while let Some(step) = rest.next() {
        if step.turn == Turn::Beside && beside.is_none() {
            let mut names = vec![step.name];
            let mut after = rest.clone();
            while let Some(next) = after.next_if(|next| next.turn == Turn::Beside) {
                names.push(next.name);
            }
            if after.peek().is_some_and(|next| next.turn == Turn::Next) {
                rest = after;
                match Beside::start(&names, other(&names)) {
                    Ok(started) => beside = Some(started),
                    Err(failure) => result = Err(failure),
                }
                if result.is_err() {
                    break;
                }
                continue;
            }
        }
        if step.turn == Turn::Quiet
            && let Some(beside) = beside.take()
        {
            result = beside.finish(&mut took);
            if result.is_err() {
                break;
            }
        }
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
    if let Some(beside) = beside {
        // The first failure is the one that counts.
        let others = beside.finish(&mut took);
        result = result.and(others);
    }
    println!();
    for (name, duration) in &took {
        println!("{name:>22}  {:>6.1} s", duration.as_secs_f64());
    }
    println!("{:>22}  {:>6.1} s", "total", begin.elapsed().as_secs_f64());
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

    fn unused() -> Command {
        unreachable!("nothing runs beside another step")
    }

    /// What ran in this process, with the steps of the other one in braces when they were waited
    /// for, and the result.
    fn order(steps: &str, other: &str) -> (String, Result<(), Failure>) {
        let ran = Rc::new(RefCell::new(String::new()));
        let step = |name: char| {
            let ran = Rc::clone(&ran);
            let names = ["a", "b", "c", "d", "e"];
            let lower = name.to_ascii_lowercase();
            let name = names
                .into_iter()
                .find(|known| *known == lower.to_string())
                .unwrap();
            Step::new(name, "", move || {
                ran.borrow_mut().push_str(name);
                Ok(())
            })
        };
        let mut all: Vec<Step> = Vec::new();
        let mut letters = steps.chars().peekable();
        while let Some(letter) = letters.next() {
            all.push(match letters.next_if(|next| "&!".contains(*next)) {
                Some('&') => step(letter).beside(),
                Some(_) => step(letter).quiet(),
                None => step(letter),
            });
        }
        let begun = Rc::clone(&ran);
        let result = run_all(&all, &|_| true, &|names| {
            begun
                .borrow_mut()
                .push_str(&format!("({})", names.concat()));
            let mut command = Command::new("/bin/sh");
            command.args(["-c", other]);
            command
        });
        let ran = ran.borrow().clone();
        (ran, result)
    }

    #[test]
    fn steps_that_may_run_beside_others_start_together_and_before_them() {
        assert_eq!(order("ab&c&de!", "exit 0").0, "a(bc)de");
        // Alone or before one that wants quiet they run here: the other process does the same.
        assert_eq!(order("b&", "exit 0").0, "b");
        assert_eq!(order("ab&c&d!", "exit 0").0, "abcd");
    }

    #[test]
    fn a_failure_beside_others_ends_before_a_step_that_wants_quiet() {
        let (ran, result) = order("a&bc!", "echo this is why; exit 1");
        assert_eq!(ran, "(a)b");
        let failure = result.unwrap_err().to_string();
        assert!(failure.starts_with("a failed"), "{failure}");
        let (ran, result) = order("a&b", "exit 1");
        assert_eq!(ran, "(a)b");
        assert!(result.is_err(), "at the end at the latest");
    }

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
        let failure = run_all(&steps, &|step| step.part.is_none(), &|_| unused()).unwrap_err();
        assert_eq!(failure.to_string(), "three failed: broken");
        assert_eq!(*ran.borrow(), ["one", "three"]);
        assert_eq!(not_run(&steps, &ran.borrow()), ["two", "four"]);
    }
}
