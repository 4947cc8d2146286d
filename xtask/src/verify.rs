//! `cargo verify`: the checks of the project.

use std::process::Command;

use crate::{
    deb, odroid, options,
    prerequisites::{self, PARTS},
    process::{Result, check, failure, require},
    programs::{Packages, check_published},
    python,
    step::{ALL, ALWAYS, Step, demo_s, row, run_all},
    uno, web,
    workspace::{adopt, cargo, script, target},
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

/// What a command line asks for.
#[derive(Debug)]
struct Selection {
    chosen: Vec<Step>,
    packages: Packages,
    /// Whether the steps were named.
    is_named: bool,
}

/// The options, and the steps.
pub(crate) fn usage() -> String {
    let steps = STEPS.map(|step| {
        let mark = if step.needs == ALWAYS { ' ' } else { '+' };
        let part = if step.needs == ALL { "" } else { step.needs };
        format!("{mark} {:14} {part:8} {}\n", step.name, step.what)
    });
    let of_steps = "Steps, those of --all alone with a +, and the part that each belongs to:";
    format!("{USAGE}\n{of_steps}\n{}", steps.concat())
}

pub(crate) fn main(arguments: &[String]) -> Result {
    let selection = parse(arguments)?;
    adopt()?;
    let result = run_all(&selection.chosen, &selection.packages, demo_s()?);
    let mut rest = STEPS.map(|step| step.name).to_vec();
    rest.retain(|name| selection.chosen.iter().all(|step| step.name != *name));
    if !selection.is_named && !rest.is_empty() {
        let rest = rest.join(", ");
        println!("Not part of it: {rest}. `cargo verify --all` checks everything.");
    }
    result
}

/// Refuses parts and steps that do not exist, and named steps that are skipped.
fn parse(arguments: &[String]) -> Result<Selection> {
    let (mut is_all, mut names, mut without) = (false, Vec::new(), Vec::new());
    for option in options(arguments, &["--without"]) {
        match option {
            ("--all", None) => is_all = true,
            ("--without", parts) => without.extend(parts.unwrap_or_default().split(',')),
            (unknown, _) if unknown.starts_with('-') => {
                return Err(failure!("unknown option {unknown:?}\n\n{USAGE}"));
            }
            (step, _) => names.push(step),
        }
    }
    for name in &without {
        let (is_part, known) = (PARTS.contains(name), PARTS.join(", "));
        require!(is_part, "--without {name:?}: the parts are {known}");
    }
    let is_skipped = |step: &Step| without.contains(&step.needs);
    for name in &names {
        let unknown = || failure!("unknown step {name:?}; `cargo verify --help` lists the steps");
        let step = STEPS.iter().find(|step| step.name == *name);
        let runs = !is_skipped(step.ok_or_else(unknown)?);
        require!(runs, "the step {name} is named, but skipped by --without");
    }
    let is_named = !names.is_empty();
    let is_whole = is_all || !is_named && !without.is_empty();
    let chosen = STEPS.into_iter().filter(|step| match is_named {
        true => step.name == PREREQUISITES || names.contains(&step.name),
        false => (is_whole || step.needs == ALWAYS) && !is_skipped(step),
    });
    let chosen: Vec<Step> = chosen.collect();
    // Named steps need the parts that they belong to, and no other.
    let parts = PARTS.into_iter().filter(|part| match is_whole {
        true => !without.contains(part),
        false => chosen.iter().any(|step| step.needs == *part),
    });
    // More packages than the default ones if a step needs more.
    let packages = match is_whole || chosen.iter().any(|step| step.needs != ALWAYS) {
        true => Packages::AllWith(parts.collect()),
        false => Packages::Default,
    };
    Ok(Selection {
        chosen,
        packages,
        is_named,
    })
}

/// The checks in order: fast ones first, real-time ones last.
#[rustfmt::skip]
const STEPS: [Step; 30] = [
    // Static checks.
    row(PREREQUISITES, 0.02, ALWAYS, "the machine has what the steps need", |packages| {
        let parts = PARTS.into_iter().filter(|part| packages.has(part));
        prerequisites::ensure(["base"].into_iter().chain(parts))
    }),
    // The image is not a member of the workspace.
    row("format", 0.02, ALWAYS, "the code is formatted", |_| check(&mut cargo("fmt --all --check"))
        .and_then(|()| check(cargo("fmt --check").current_dir(uno::folder())))),
    row("compile", 3.3, ALWAYS, "no warning from compiler, clippy and rustdoc", Packages::compile),
    row("lints-uno", 0.18, "uno", "no warning in the Arduino's image", |_| uno::lint()),
    row("packages", 0.18, ALL, "packages build alone, and those for others can be packed",
        // In the workspace's build, a package has the features that all others ask for, which hides missing
        // ones. Without the others: packages without I/O, and those that are published. What `cargo demo`
        // builds is built for the Odroid.
        |_| check(&mut cargo("check --quiet --package singletrack-protocol --package singletrack-board \
            --package singletrack-pilot --package singletrack-link")).and_then(|()| check_published())),
    row("units", 0.01, "units",
        "systemd accepts the services' units without warnings and rates their exposure as low",
        |_| check(script("xtask/src/units.sh").arg(target()?.join("units")))),
    // Checks of the programs in virtual time.
    row("tests", 2.4, ALWAYS, "unit, property and virtual-time tests, examples of the documentation",
        |packages| packages.check_with_image(&mut packages.tests(match packages {
            Packages::Default => "-- --skip thorough::",
            Packages::AllWith(_) => "",
        })?)),
    row("faults", 0.21, ALWAYS, "random faults in virtual time violate no invariant",
        |packages| check(&mut packages.program(match packages {
            Packages::Default => "singletrack-faults --count 60",
            Packages::AllWith(_) => "singletrack-faults --count 200",
        })?)),
    row("tutorial", 0.02, ALWAYS, "the commands of the tutorial are accepted and run",
        |packages| check(&mut packages.tests("--test book -- tutorial")?)),
    row("real-logs", 0.01, ALWAYS,
        "the logs of a real car: what would have stopped it, and the errors of the estimate",
        real_logs),
    row("uno", 0.02, "uno",
        "the Arduino's image has no miscompiled code and stays within its budgets",
        |packages| uno::check_image(&packages.image()?, 0, &mut packages.program("uno-figures")?)),
    row("tests-uno", 0.17, "uno",
        "the tests and random faults of the Arduino's image, in its simulator", |packages| {
        packages.check_with_image(&mut packages.tests("--test uno --")?)?;
        packages.check_with_image(&mut packages.program("singletrack-faults --count 8 --board uno")?)
    }),
    row("exploration", 0.08, ALL, "no interleaving of board, link and supervisor violates a claim",
        |packages| check(&mut packages.program("singletrack-exploration --states 9000")?)),
    row("onboard", 0.16, ALL,
        "cars of all kinds come from the parts to the circle, led by the three procedures",
        |packages| check(&mut packages.program("singletrack-onboard --count 3")?)),
    row("readers", 0.08, "readers",
        "independent readers agree on the contents of a record and of a repaired one",
        python::check_readers),
    row("slurm", 0.05, "slurm", "campaigns as job arrays of Slurm give what one process gives",
        // A Slurm that is installed does not count.
        |packages| check(script("tests/slurm/job-array.sh").arg(packages.path("")?)
            .env_remove("SLURM_CONF"))),
    row("certificates", 0.17, "python",
        "independent programs accept the proofs of stability and of the safety filter, and no changed one",
        |packages| check(script("lab/certificates/check.sh")
            .arg(packages.path("singletrack-lab")?)
            .arg(target()?.join("certificates")))),
    row("book", 0.33, ALL, "the commands of all pages are accepted by their programs, and most are run",
        |packages| check(&mut packages.tests("--test book --")?)),
    row("release", 0.22, ALL, "what computes gives the same bits, optimised as in a release, as tested",
        odroid::compare_optimised),
    row("debian", 0.15, "debian",
        "this machine's Debian package is clean by lintian, complete, and its programs run",
        deb::verify),
    row("odroid", 1.4, "odroid",
        "the daemon compiles for the Odroid, and what computes gives the same bits there", odroid::verify),
    row("web", 1.05, "web",
        "the laboratory in a browser has the same bits, in Node and in Chromium", web::verify),
    row("python", 0.34, "python",
        "the Python package drives the simulator and the daemon on both boards",
        python::check_package),
    // Checks in real time.
    row("hil", 0.62, ALWAYS, "hardware in the loop: the daemon against the simulated board",
        |packages| check(&mut suite(packages, "--board native")?)),
    row("hil-uno", 0.41, "uno", "the same against the Arduino's image",
        |packages| packages.check_with_image(&mut suite(packages, "--board uno")?)),
    row("two-computers", 0.02, ALL,
        "the cars of two computers start together, and stop when their network is cut",
        |packages| two_computers(packages, &[])),
    row("zenoh", 0.02, "zenoh", "the same by way of a zenoh router, which is killed as well",
        |packages| two_computers(packages, &["--zenoh"])),
    row("octave", 0.02, "octave", "the example for MATLAB drives the car over TCP, in Octave",
        |packages| check(&mut suite(packages, "--board native --octave in_octave")?)),
    row("browser", 0.03, "browser",
        "the page shows a drive in Chromium, at a desk and on a telephone",
        |packages| check(&mut suite(packages, "--board native --browser in_a_browser")?)),
    row("ros", 0.22, "ros", "a node of ROS 2 in Python reads the car and drives it",
        python::check_node),
];

/// The hardware-in-the-loop suite with the tested daemon, and its own arguments.
fn suite(packages: &Packages, arguments: &str) -> Result<Command> {
    let daemon = packages.path("singletrackd")?;
    let mut suite = packages.tests("--test hil -- --daemon")?;
    suite.arg(daemon).args(arguments.split(' '));
    Ok(suite)
}

fn two_computers(packages: &Packages, options: &[&str]) -> Result {
    let mut cars = script("tests/hil/two_computers.py");
    check(cars.arg(packages.path("")?).args(options))
}

/// No log of a real car is part of the project: they are judged where there are some.
fn real_logs(packages: &Packages) -> Result {
    match std::env::var_os("REAL_LOGS") {
        Some(_) => check(&mut packages.tests("--test real_logs -- --nocapture")?),
        None => {
            println!("not run: REAL_LOGS names no folder with logs of a real car");
            Ok(())
        }
    }
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
        let chosen = parsed(line).unwrap().chosen;
        chosen.iter().map(|step| step.name).collect()
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
            let known = PARTS.contains(&step.needs) || [ALWAYS, ALL].contains(&step.needs);
            assert!(known, "{}", step.name);
            assert_eq!(chosen("").contains(&step.name), step.needs == ALWAYS);
            assert!(chosen("--all").contains(&step.name), "{}", step.name);
        }
        assert_eq!(parsed("").unwrap().packages, Packages::Default);
        assert_eq!(parsed("compile hil").unwrap().packages, Packages::Default);
    }

    /// The aims are 12 demos and 4.5. The budgets are those of `--all`; `cargo verify` alone compiles
    /// and tests less.
    #[test]
    fn the_steps_stay_within_the_processor_time_of_both_commands() {
        let all: f64 = STEPS.iter().map(|step| step.budget).sum();
        assert!(all <= 12.0, "{all}");
        let always = STEPS.iter().filter(|step| step.needs == ALWAYS);
        let always: f64 = always.map(|step| step.budget).sum();
        assert!(always <= 6.61, "{always}");
    }

    #[test]
    fn parts_are_skipped_in_either_form() {
        let without = ["uno", "readers"];
        for line in [
            "--without uno,readers",
            "--without=uno,readers",
            "--all --without uno --without=readers,uno",
        ] {
            let selection = parsed(line).unwrap();
            for part in PARTS {
                let is_skipped = without.contains(&part);
                assert_eq!(selection.packages.has(part), !is_skipped, "{line}: {part}");
            }
            assert!(!chosen(line).contains(&"hil-uno"), "{line}");
            assert!(chosen(line).contains(&"octave"), "{line}");
        }
    }

    #[test]
    fn a_named_step_needs_its_own_part_alone() {
        let packages = parsed("hil-uno").unwrap().packages;
        for part in PARTS {
            assert_eq!(packages.has(part), part == "uno", "{part}");
        }
        assert_eq!(chosen("hil-uno"), [PREREQUISITES, "hil-uno"]);
        assert!(parsed("--all compile").unwrap().packages.has("uno"));
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
        let why = |line: &str| parsed(line).unwrap_err().to_string();
        assert!(why("test").contains("unknown step \"test\""));
        assert!(why("uno --without uno").contains("skipped by --without"));
    }
}
