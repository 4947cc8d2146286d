//! Steps of a verification, with what each may cost. The unit of the costs, which says how fast this
//! machine is, is the processor time of `cargo demo` from nothing, which is mostly compiling.

use std::{
    fs,
    process::Command,
    time::{Duration, Instant},
};

use crate::{
    process::{Failure, NOT_VALID, Result, command, failure, silent},
    programs::Packages,
    workspace::{emptied, write},
};

/// One check.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Step {
    pub(crate) name: &'static str,
    /// Processor time that it may take from nothing, as a multiple of that of `cargo demo` from nothing
    /// on the same machine.
    pub(crate) budget: f64,
    /// [`ALWAYS`], [`ALL`], or an optional part.
    pub(crate) needs: &'static str,
    pub(crate) what: &'static str,
    pub(crate) run: fn(&Packages) -> Result,
}

/// What a step of `cargo verify` needs: nothing but Rust and a C compiler. The others are steps of
/// `cargo verify --all` alone.
pub(crate) const ALWAYS: &str = "";
/// What a step needs that belongs to no optional part.
pub(crate) const ALL: &str = "all";

/// A step as a row of a table.
pub(crate) const fn row(
    name: &'static str,
    budget: f64,
    needs: &'static str,
    what: &'static str,
    run: fn(&Packages) -> Result,
) -> Step {
    Step {
        name,
        budget,
        needs,
        what,
        run,
    }
}

/// What a step has cost: time on the clock, and processor time in s.
type Cost<'a> = (&'a Step, Duration, f64);

/// Runs the steps up to the first failure. Prints the cost of each, those over their budgets, and the
/// steps that were not run. A step that was not valid does not end the others. `demo_s` is the unit of
/// the costs.
pub(crate) fn run_all(steps: &[Step], packages: &Packages, demo_s: f64) -> Result {
    let begin = Instant::now();
    let mut costs: Vec<Cost<'_>> = Vec::new();
    let mut not_valid: Vec<&str> = Vec::new();
    let mut result = Ok(());
    for step in steps {
        println!("\n== {}: {}", step.name, step.what);
        let (start, start_s) = (Instant::now(), processor_s());
        let checked = (step.run)(packages);
        costs.push((step, start.elapsed(), processor_s() - start_s));
        match checked {
            Ok(()) => {}
            Err(failure) if failure.status == NOT_VALID => {
                println!("NOT VALID: {failure}");
                not_valid.push(step.name);
            }
            Err(failure) => {
                result = Err(failure!("{} failed: {failure}", step.name));
                break;
            }
        }
    }
    let wall = begin.elapsed();
    print!("\n{}", table(&costs, wall, demo_s));
    let not_run: Vec<&str> = steps[costs.len()..].iter().map(|step| step.name).collect();
    if !not_run.is_empty() {
        println!("NOT RUN: {}", not_run.join(", "));
    }
    result?;
    if not_valid.is_empty() {
        return Ok(());
    }
    let names = not_valid.join(" ");
    let text = format!(
        "not valid on this machine now: {names}. They check in real time, and the machine was busy; \
         everything else has passed. End other programs, then: cargo verify {names} \
         (exit status {NOT_VALID})"
    );
    let status = NOT_VALID;
    Err(Failure { text, status })
}

/// A line a step, their sum, and the steps that took half more than their budgets. Costs are multiples
/// of the demo's, too.
fn table(costs: &[Cost<'_>], wall: Duration, demo_s: f64) -> String {
    let mut text = format!(
        "{:>22}  {:>9}  {:>11}  {:>8}  {:>6}\n",
        "step", "time", "processor", "in demos", "budget"
    );
    let mut over = String::new();
    let mut line = |name: &str, wall: Duration, processor_s: f64, budget: f64| {
        let (wall_s, demos) = (wall.as_secs_f64(), processor_s / demo_s);
        text += &format!(
            "{name:>22}  {wall_s:>7.1} s  {processor_s:>9.1} s  {demos:>8.2}  {budget:>6.2}\n"
        );
    };
    for (Step { name, budget, .. }, wall, processor_s) in costs {
        line(name, *wall, *processor_s, *budget);
        let demos = processor_s / demo_s;
        if demos > 1.5 * budget {
            over += &format!(
                "OVER BUDGET: {name} took the processor time of {demos:.2} demos, {budget} are planned\n"
            );
        }
    }
    let processor_s = costs.iter().map(|cost| cost.2).sum();
    let budget = costs.iter().map(|cost| cost.0.budget).sum();
    line("total", wall, processor_s, budget);
    text + &over
        + &format!(
            "A demo from nothing takes {demo_s:.0} s of processor time here, by the compilation of a sample.\n"
        )
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

/// Processor time of `cargo demo` from nothing, as a multiple of that of the sample. Measured in one
/// session on one machine: 213.2 s, and 0.98 s.
const SAMPLES_IN_A_DEMO: f64 = 217.0;

/// Processor time of `cargo demo` from nothing on this machine, estimated by compiling a sample: a library
/// that depends on nothing but the standard library, and is always the same, modules that differ in a
/// number.
pub(crate) fn demo_s() -> Result<f64> {
    let folder = emptied("yardstick")?;
    let file = folder.join("sample.rs");
    let modules = ["0", "1", "2", "3"];
    let sample = modules.map(|number| include_str!("sample.txt").replace("NUMBER", number));
    write(&file, sample.concat())?;
    let mut rustc = command(
        "rustc --edition 2024 --crate-type lib -C opt-level=1 -C codegen-units=1 --out-dir",
    );
    Ok(SAMPLES_IN_A_DEMO * least_s(4, rustc.args([&folder, &file]))?)
}

/// Processor time of a command that runs this often: the least one, which other work on the machine
/// disturbs least.
pub(crate) fn least_s(runs: u32, command: &mut Command) -> Result<f64> {
    let mut least_s = f64::INFINITY;
    for _ in 0..runs {
        let before_s = processor_s();
        silent(command)?;
        least_s = least_s.min(processor_s() - before_s);
    }
    Ok(least_s)
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
            budget: 1.0,
            needs: ALWAYS,
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
        let failure = run_all(&steps, &Packages::Default, 100.0).unwrap_err();
        assert_eq!(failure.to_string(), "two failed: broken");
        assert_eq!(*RAN.lock().unwrap(), ["one"]);
    }

    #[test]
    fn a_check_that_was_not_valid_ends_no_other_and_is_named() {
        let step = |name, run| row(name, 1.0, ALWAYS, "", run);
        let steps = [
            step("busy", |_| {
                let (text, status) = ("late".to_owned(), NOT_VALID);
                Err(Failure { text, status })
            }),
            step("calm", |_| Ok(())),
        ];
        let failure = run_all(&steps, &Packages::Default, 100.0).unwrap_err();
        assert_eq!(failure.status, NOT_VALID, "{failure}");
        let text = failure.to_string();
        assert!(
            text.contains("cargo verify busy (exit status 75)"),
            "{text}"
        );
    }

    #[test]
    fn a_step_half_over_its_budget_is_named() {
        let step = |name| row(name, 0.1, ALWAYS, "", |_| Ok(()));
        let (near, far) = (step("near"), step("far"));
        let wall = Duration::from_secs(1);
        let costs = [(&near, wall, 14.9), (&far, wall, 15.1)];
        let text = table(&costs, Duration::ZERO, 100.0);
        assert!(
            text.contains("OVER BUDGET: far took the processor time of 0.15 demos, 0.1 are"),
            "{text}"
        );
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
