//! Steps of a verification, with what each may cost.

use std::{
    fs,
    time::{Duration, Instant},
};

use crate::{
    prerequisites::Part,
    process::{Failure, failure},
    programs::Packages,
};

/// One check.
#[derive(Clone, Copy)]
pub(crate) struct Step {
    pub(crate) name: &'static str,
    /// Processor time that it may take from nothing, in seconds; docs/verification.md names the
    /// machine.
    pub(crate) budget_s: u32,
    pub(crate) scope: Scope,
    pub(crate) what: &'static str,
    pub(crate) run: fn(&Packages) -> Result<(), Failure>,
}

/// Which command a step belongs to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Scope {
    /// `cargo verify`: it needs nothing but Rust and a C compiler.
    Always,
    /// `cargo verify --all` alone.
    All,
    /// The same, and an optional part of it.
    Of(Part),
}

/// A step as a row of a table.
pub(crate) const fn row(
    name: &'static str,
    budget_s: u32,
    scope: Scope,
    what: &'static str,
    run: fn(&Packages) -> Result<(), Failure>,
) -> Step {
    Step {
        name,
        budget_s,
        scope,
        what,
        run,
    }
}

/// What a step has cost.
struct Cost {
    name: &'static str,
    wall: Duration,
    processor_s: f64,
    budget_s: u32,
}

/// Runs the steps up to the first failure. Prints the cost of each, those over their budgets, and the
/// steps that were not run.
pub(crate) fn run_all(steps: &[Step], packages: &Packages) -> Result<(), Failure> {
    let begin = Instant::now();
    let mut costs: Vec<Cost> = Vec::new();
    let mut result = Ok(());
    for step in steps {
        println!("\n== {}: {}", step.name, step.what);
        let (start, start_s) = (Instant::now(), processor_s());
        result =
            (step.run)(packages).map_err(|failure| failure!("{} failed: {failure}", step.name));
        costs.push(Cost {
            name: step.name,
            wall: start.elapsed(),
            processor_s: processor_s() - start_s,
            budget_s: step.budget_s,
        });
        if result.is_err() {
            break;
        }
    }
    print!("\n{}", table(&costs, begin.elapsed()));
    let not_run: Vec<&str> = steps[costs.len()..].iter().map(|step| step.name).collect();
    if !not_run.is_empty() {
        println!("NOT RUN: {}", not_run.join(", "));
    }
    result
}

/// A line a step, their sum, and the steps that took half more than their budgets.
fn table(costs: &[Cost], wall: Duration) -> String {
    let mut text = format!(
        "{:>22}  {:>9}  {:>11}  {:>8}\n",
        "step", "time", "processor", "budget"
    );
    let mut line = |name: &str, wall: Duration, processor_s: f64, budget_s: u32| {
        text += &format!(
            "{name:>22}  {:>7.1} s  {processor_s:>9.1} s  {budget_s:>6} s\n",
            wall.as_secs_f64()
        );
    };
    for cost in costs {
        line(cost.name, cost.wall, cost.processor_s, cost.budget_s);
    }
    let processor_s = costs.iter().map(|cost| cost.processor_s).sum();
    let budget_s = costs.iter().map(|cost| cost.budget_s).sum();
    line("total", wall, processor_s, budget_s);
    for cost in costs {
        if cost.processor_s > 1.5 * f64::from(cost.budget_s) {
            text += &format!(
                "OVER BUDGET: {} took {:.0} s of processor time, {} s are planned\n",
                cost.name, cost.processor_s, cost.budget_s
            );
        }
    }
    text
}

/// User and system time of all processes that this one has started and that have ended.
fn processor_s() -> f64 {
    /// Linux reports times in units of 10 ms on every processor of today.
    const UNIT_S: f64 = 0.01;
    let stat = fs::read_to_string("/proc/self/stat").unwrap_or_default();
    children_ticks(&stat).unwrap_or_default() as f64 * UNIT_S
}

/// Fields 16 and 17 of `/proc/PID/stat`; the second may hold blanks and ends with a parenthesis.
fn children_ticks(stat: &str) -> Option<u64> {
    let (_, rest) = stat.rsplit_once(')')?;
    let mut fields = rest.split_whitespace().skip(13);
    let mut next = || fields.next()?.parse::<u64>().ok();
    Some(next()? + next()?)
}

#[cfg(test)]
mod tests {
    use std::sync::Mutex;

    use super::*;

    #[test]
    fn steps_run_in_order_up_to_the_first_failure() {
        static RAN: Mutex<Vec<&str>> = Mutex::new(Vec::new());
        let step = |name, run| Step {
            name,
            budget_s: 1,
            scope: Scope::Always,
            what: "",
            run,
        };
        let steps = [
            step("one", |_| {
                RAN.lock().unwrap().push("one");
                Ok(())
            }),
            step("two", |_| Err(failure!("broken"))),
            step("three", |_| {
                RAN.lock().unwrap().push("three");
                Ok(())
            }),
        ];
        let failure = run_all(&steps, &Packages::Default).unwrap_err();
        assert_eq!(failure.to_string(), "two failed: broken");
        assert_eq!(*RAN.lock().unwrap(), ["one"]);
    }

    #[test]
    fn a_step_half_over_its_budget_is_named() {
        let cost = |name, processor_s| Cost {
            name,
            wall: Duration::from_secs(1),
            processor_s,
            budget_s: 10,
        };
        let text = table(&[cost("near", 14.9), cost("far", 15.1)], Duration::ZERO);
        assert!(text.contains("OVER BUDGET: far took 15 s"), "{text}");
        assert!(!text.contains("OVER BUDGET: near"), "{text}");
    }

    #[test]
    fn the_processor_time_of_ended_processes_is_counted() {
        let stat = "7 (a) b) S 1 7 7 0 -1 4194304 1 2 3 4 50 60 700 80 20 0 1 0 9";
        assert_eq!(children_ticks(stat), Some(780));
        assert_eq!(children_ticks("7 (a) S 1"), None);
        let before = processor_s();
        let busy = "i=0; while [ $i -lt 60000 ]; do i=$((i+1)); done";
        crate::process::check(std::process::Command::new("sh").args(["-c", busy])).unwrap();
        assert!(processor_s() > before, "{before}");
    }
}
