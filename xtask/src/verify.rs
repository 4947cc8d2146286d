//! `cargo verify`: the checks of the project.

use std::process::Command;

use crate::{
    deb, odroid, options,
    prerequisites::{self, Part},
    process::{Result, check, failure, require},
    programs::{Packages, check_alone, check_published},
    python,
    step::{
        Scope::{All, Always, Of},
        Step, demo_s, row, run_all,
    },
    target, uno, web,
    workspace::{cargo, script},
};

const USAGE: &str = "\
usage: cargo verify [--all] [--without PART[,PART...]] [STEP...]

Run the checks that need nothing but Rust and a C compiler, or the named steps. Prints the time,
the processor time and the budget of each step, and stops at the first failure.

  --all            run every check of the project; installs Debian packages that are missing
  --without PART   every check but those of a part: uno, odroid, readers, python, ros, zenoh, octave, browser, web, slurm, units, debian
  -h, --help       print this help
";

/// The first step, which always runs.
const PREREQUISITES: &str = "prerequisites";

/// The selected steps.
#[derive(Debug, Default, PartialEq, Eq)]
struct Selection {
    all: bool,
    steps: Vec<String>,
    without: Vec<Part>,
}

/// The options, and the steps.
pub(crate) fn usage() -> String {
    let steps = STEPS.map(|step| {
        let (mark, part) = match step.scope {
            Always => (' ', ""),
            All => ('+', ""),
            Of(part) => ('+', part.name()),
        };
        format!("{mark} {:14} {part:8} {}\n", step.name, step.what)
    });
    let of_steps = "Steps, those of --all alone with a +, and the part that each belongs to:";
    format!("{USAGE}\n{of_steps}\n{}", steps.concat())
}

pub(crate) fn main(arguments: &[String]) -> Result {
    let selection = parse(arguments)?;
    selection.check()?;
    target::adopt()?;
    let (chosen, rest): (Vec<Step>, Vec<Step>) =
        STEPS.into_iter().partition(|step| selection.chooses(step));
    let result = run_all(&chosen, &selection.packages(), demo_s()?);
    if selection.steps.is_empty() && !rest.is_empty() {
        let rest: Vec<&str> = rest.iter().map(|step| step.name).collect();
        let rest = rest.join(", ");
        println!("Not part of it: {rest}. `cargo verify --all` checks everything.");
    }
    result
}

impl Selection {
    /// Leaves out parts, whose names are separated by commas.
    fn leave_out(&mut self, names: &str) -> Result {
        for name in names.split(',') {
            let part = Part::named(name).ok_or_else(|| {
                let known = Part::ALL.map(Part::name).join(", ");
                failure!("--without {name:?}: the parts are {known}")
            })?;
            if !self.without.contains(&part) {
                self.without.push(part);
            }
        }
        Ok(())
    }

    fn names(&self, step: &Step) -> bool {
        self.steps.iter().any(|name| name == step.name)
    }

    /// The packages to check: more than the default ones if a step needs more. Named steps need the
    /// parts that they belong to, and no other.
    fn packages(&self) -> Packages {
        if self.all || (self.steps.is_empty() && !self.without.is_empty()) {
            return Packages::AllWithout(self.without.clone());
        }
        let named = STEPS.into_iter().filter(|step| self.names(step));
        if named.clone().all(|step| step.scope == Always) {
            return Packages::Default;
        }
        let unneeded = |part: &Part| named.clone().all(|step| step.scope != Of(*part));
        Packages::AllWithout(Part::ALL.into_iter().filter(unneeded).collect())
    }

    /// Whether a step is to run.
    fn chooses(&self, step: &Step) -> bool {
        if matches!(step.scope, Of(part) if self.without.contains(&part)) {
            return false;
        }
        if self.steps.is_empty() {
            step.scope == Always || self.packages() != Packages::Default
        } else {
            step.name == PREREQUISITES || self.names(step)
        }
    }

    /// Refuses steps that do not exist or are skipped.
    fn check(&self) -> Result {
        for name in &self.steps {
            let step = STEPS.iter().find(|step| step.name == name).ok_or_else(|| {
                failure!("unknown step {name:?}; `cargo verify --help` lists the steps")
            })?;
            let runs = self.chooses(step);
            require!(runs, "the step {name} is named, but skipped by --without");
        }
        Ok(())
    }
}

fn parse(arguments: &[String]) -> Result<Selection> {
    let mut selection = Selection::default();
    for option in options(arguments, &["--without"]) {
        match option {
            ("--all", None) => selection.all = true,
            ("--without", names) => selection.leave_out(names.unwrap_or_default())?,
            (unknown, _) if unknown.starts_with('-') => {
                return Err(failure!("unknown option {unknown:?}\n\n{USAGE}"));
            }
            (step, _) => selection.steps.push(step.to_owned()),
        }
    }
    Ok(selection)
}

/// The checks in order: fast ones first, real-time ones last.
#[rustfmt::skip]
const STEPS: [Step; 30] = [
    // Static checks.
    row(PREREQUISITES, 0.02, Always, "the machine has what the steps need", |packages| {
        let parts = Part::ALL.into_iter().filter(|part| packages.has(*part));
        prerequisites::ensure(&["base"].into_iter().chain(parts.map(Part::name)).collect::<Vec<_>>())
    }),
    row("format", 0.02, Always, "the code is formatted", |_| format()),
    row("compile", 3.3, Always, "no warning from compiler, clippy and rustdoc", Packages::compile),
    row("lints-uno", 0.18, Of(Part::Uno), "no warning in the Arduino's image", |_| uno::lint()),
    row("packages", 0.18, All, "packages build alone, and those for others can be packed",
        |_| check_alone().and_then(|()| check_published())),
    row("units", 0.01, Of(Part::Units),
        "systemd accepts the services' units without warnings and rates their exposure as low",
        |_| check(script("xtask/src/units.sh").arg(target::folder()?.join("units")))),
    // Checks of the programs in virtual time.
    row("tests", 2.4, Always, "unit, property and virtual-time tests, examples of the documentation",
        |packages| {
        let mut tests = packages.tests(None)?;
        if *packages == Packages::Default {
            tests.args(["--", "--skip", "thorough::"]);
        }
        packages.check_with_image(&mut tests)
    }),
    row("faults", 0.21, Always, "random faults in virtual time violate no invariant",
        |packages| {
        let count = if *packages == Packages::Default { "60" } else { "200" };
        check(packages.program("singletrack-faults")?.args(["--count", count]))
    }),
    row("tutorial", 0.02, Always, "the commands of the tutorial are accepted and run",
        |packages| check(packages.tests(Some("book"))?.arg("tutorial"))),
    row("real-logs", 0.01, Always,
        "the logs of a real car: what would have stopped it, and the errors of the estimate",
        real_logs),
    row("uno", 0.02, Of(Part::Uno),
        "the Arduino's image has no miscompiled code and stays within its budgets", |packages| {
        let mut figures = packages.program("uno-figures")?;
        uno::check_image(&packages.image()?, 0, &mut figures)
    }),
    row("tests-uno", 0.17, Of(Part::Uno),
        "the tests and random faults of the Arduino's image, in its simulator", |packages| {
        packages.check_with_image(&mut packages.tests(Some("uno"))?)?;
        let mut faults = packages.program("singletrack-faults")?;
        packages.check_with_image(faults.args(["--count", "8", "--board", "uno"]))
    }),
    row("exploration", 0.08, All, "no interleaving of board, link and supervisor violates a claim",
        |packages| check(packages.program("singletrack-exploration")?.args(["--states", "9000"]))),
    row("onboard", 0.16, All,
        "cars of all kinds come from the parts to the circle, led by the three procedures",
        |packages| check(packages.program("singletrack-onboard")?.args(["--count", "3"]))),
    row("readers", 0.08, Of(Part::Readers),
        "independent readers agree on the contents of a record and of a repaired one",
        python::check_readers),
    row("slurm", 0.05, Of(Part::Slurm), "campaigns as job arrays of Slurm give what one process gives",
        |packages| {
        let mut job_array = script("tests/slurm/job-array.sh");
        // A Slurm that is installed does not count.
        check(job_array.arg(packages.path("")?).env_remove("SLURM_CONF"))
    }),
    row("certificates", 0.17, Of(Part::Python),
        "independent programs accept the proofs of stability and of the safety filter, and no changed one",
        |packages| check(script("lab/certificates/check.sh")
            .arg(packages.path("singletrack-lab")?)
            .arg(target::folder()?.join("certificates")))),
    row("book", 0.33, All, "the commands of all pages are accepted by their programs, and most are run",
        |packages| check(&mut packages.tests(Some("book"))?)),
    row("release", 0.22, All, "what computes gives the same bits, optimised as in a release, as tested",
        odroid::compare_optimised),
    row("debian", 0.15, Of(Part::Debian),
        "this machine's Debian package is clean by lintian, complete, and its programs run",
        deb::verify),
    row("odroid", 1.4, Of(Part::Odroid),
        "the daemon compiles for the Odroid, and what computes gives the same bits there", odroid::verify),
    row("web", 1.05, Of(Part::Web),
        "the laboratory in a browser has the same bits, in Node and in Chromium", web::verify),
    row("python", 0.34, Of(Part::Python),
        "the Python package drives the simulator and the daemon on both boards",
        python::check_package),
    // Checks in real time.
    row("hil", 0.62, Always, "hardware in the loop: the daemon against the simulated board",
        |packages| check(&mut suite(packages, "native")?)),
    row("hil-uno", 0.41, Of(Part::Uno), "the same against the Arduino's image",
        |packages| packages.check_with_image(&mut suite(packages, "uno")?)),
    row("two-computers", 0.02, All,
        "the cars of two computers start together, and stop when their network is cut",
        |packages| two_computers(packages, &[])),
    row("zenoh", 0.02, Of(Part::Zenoh), "the same by way of a zenoh router, which is killed as well",
        |packages| two_computers(packages, &["--zenoh"])),
    row("octave", 0.02, Of(Part::Octave), "the example for MATLAB drives the car over TCP, in Octave",
        |packages| check(suite(packages, "native")?.args(["--octave", "in_octave"]))),
    row("browser", 0.03, Of(Part::Browser),
        "the page shows a drive in Chromium, at a desk and on a telephone",
        |packages| check(suite(packages, "native")?.args(["--browser", "in_a_browser"]))),
    row("ros", 0.22, Of(Part::Ros), "a node of ROS 2 in Python reads the car and drives it",
        python::check_node),
];

/// The hardware-in-the-loop suite with the tested daemon; its own arguments follow.
fn suite(packages: &Packages, board: &str) -> Result<Command> {
    let daemon = packages.path("singletrackd")?;
    let mut suite = packages.tests(Some("hil"))?;
    suite.args(["--board", board, "--daemon"]).arg(daemon);
    Ok(suite)
}

fn two_computers(packages: &Packages, options: &[&str]) -> Result {
    let mut cars = script("tests/hil/two_computers.py");
    check(cars.arg(packages.path("")?).args(options))
}

/// No log of a real car is part of the project: they are judged where there are some.
fn real_logs(packages: &Packages) -> Result {
    match std::env::var_os("REAL_LOGS") {
        Some(_) => check(packages.tests(Some("real_logs"))?.arg("--nocapture")),
        None => {
            println!("not run: REAL_LOGS names no folder with logs of a real car");
            Ok(())
        }
    }
}

/// Checks the format of the workspace and of the image, which is not a member.
fn format() -> Result {
    check(&mut cargo("fmt --all --check"))?;
    check(cargo("fmt --check").current_dir(uno::folder()))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parsed(line: &str) -> Result<Selection> {
        let arguments: Vec<String> = line.split_whitespace().map(str::to_owned).collect();
        parse(&arguments)
    }

    /// The steps that a command line chooses.
    fn chosen(line: &str) -> Vec<&'static str> {
        let selection = parsed(line).unwrap();
        selection.check().unwrap();
        let chosen = STEPS.iter().filter(|step| selection.chooses(step));
        chosen.map(|step| step.name).collect()
    }

    /// The arguments of an alias of cargo in the documentation, without `--help`, which ends them.
    fn documented(alias: &str) -> Vec<String> {
        let root = crate::workspace::root();
        let docs = std::fs::read_dir(root.join("docs")).unwrap();
        let pages = docs.map(|entry| entry.unwrap().path());
        let text: String = pages
            .filter(|page| page.extension().is_some_and(|ending| ending == "md"))
            .chain([root.join("README.md")])
            .map(|page| std::fs::read_to_string(page).unwrap())
            .collect();
        text.split(['`', '\n'])
            .filter_map(|line| line.trim().strip_prefix(&format!("cargo {alias} ")))
            .map(|line| line.split(" #").next().unwrap().trim().to_owned())
            .filter(|line| !line.is_empty() && !line.starts_with('#') && !line.contains("--help"))
            .collect()
    }

    #[test]
    fn the_documented_commands_are_accepted() {
        let verify = documented("verify");
        assert!(verify.len() > 3, "{verify:?}");
        for line in verify {
            assert!(!chosen(&line).is_empty(), "{line}");
        }
        let uno = documented("uno");
        assert!(uno.len() > 1, "{uno:?}");
        for line in uno {
            let words: Vec<String> = line.split_whitespace().map(str::to_owned).collect();
            uno::parse(&words).unwrap();
        }
        let release = documented("release");
        assert!(release.len() > 1, "{release:?}");
        for line in release {
            let words: Vec<String> = line.split_whitespace().map(str::to_owned).collect();
            crate::release::parse(&words).unwrap();
        }
    }

    #[test]
    fn without_options_nothing_is_checked_that_needs_more_than_rust_and_a_c_compiler() {
        for step in STEPS {
            assert_eq!(chosen("").contains(&step.name), step.scope == Always);
            assert!(chosen("--all").contains(&step.name), "{}", step.name);
        }
        assert_eq!(parsed("").unwrap().packages(), Packages::Default);
        assert_eq!(parsed("compile hil").unwrap().packages(), Packages::Default);
    }

    /// The aims are 12 demos and 4.5. The budgets are those of `--all`; `cargo verify` alone compiles
    /// and tests less.
    #[test]
    fn the_steps_stay_within_the_processor_time_of_both_commands() {
        let all: f64 = STEPS.iter().map(|step| step.budget).sum();
        assert!(all <= 12.0, "{all}");
        let always = STEPS.iter().filter(|step| step.scope == Always);
        let always: f64 = always.map(|step| step.budget).sum();
        assert!(always <= 6.61, "{always}");
    }

    #[test]
    fn parts_are_skipped_in_either_form() {
        let without = vec![Part::Uno, Part::Readers];
        for line in [
            "--without uno,readers",
            "--without=uno,readers",
            "--all --without uno --without=readers,uno",
        ] {
            let selection = parsed(line).unwrap();
            assert_eq!(selection.packages(), Packages::AllWithout(without.clone()));
            assert!(!chosen(line).contains(&"hil-uno"), "{line}");
            assert!(chosen(line).contains(&"octave"), "{line}");
        }
    }

    #[test]
    fn a_named_step_needs_its_own_part_alone() {
        let packages = parsed("hil-uno").unwrap().packages();
        for part in Part::ALL {
            assert_eq!(packages.has(part), part == Part::Uno, "{}", part.name());
        }
        assert_eq!(chosen("hil-uno"), [PREREQUISITES, "hil-uno"]);
        assert!(parsed("--all compile").unwrap().packages().has(Part::Uno));
    }

    #[test]
    fn an_unknown_part_step_or_option_is_refused_with_the_known_ones() {
        let why = parsed("--without arduino").unwrap_err().to_string();
        assert!(
            why.contains("\"arduino\"") && why.contains("uno, odroid, readers"),
            "{why}"
        );
        for line in ["--without", "--witout uno", "--without=", "-x"] {
            assert!(parsed(line).is_err(), "{line}");
        }
        let why = |line: &str| parsed(line).unwrap().check().unwrap_err().to_string();
        assert!(why("test").contains("unknown step \"test\""));
        assert!(why("uno --without uno").contains("skipped by --without"));
    }
}
