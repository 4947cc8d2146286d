//! `cargo verify`: every check of the project.

use std::process::Command;

use crate::{
    deb, image, odroid, packages,
    prerequisites::{self, Part},
    process::{Failure, check},
    publish, python, readers,
    release::{Release, features},
    ros, same_bits, slurm,
    step::{Step, run_all},
    target, units, uno,
    workspace::cargo,
};

pub(crate) const USAGE: &str = "\
usage: cargo verify [STEP...] [--without PART[,PART...]]

Run every check of the project, or the named steps. First tests the prerequisites on
this machine, and installs Debian packages that are missing or too old. Prints the time
of each step, stops at the first failure, and lists the steps that were not run.

  --without PART   skip all steps of a part: uno, odroid, readers, python, ros, octave, browser, slurm, units, debian
  -h, --help       print this help
";

/// The first step, which always runs.
const PREREQUISITES: &str = "prerequisites";

/// The selected steps.
#[derive(Debug, Default, PartialEq, Eq)]
struct Selection {
    steps: Vec<String>,
    without: Vec<Part>,
}

pub(crate) fn main(arguments: &[String]) -> Result<(), Failure> {
    if arguments
        .iter()
        .any(|argument| argument == "--help" || argument == "-h")
    {
        print!("{USAGE}\nSteps, and the part that each belongs to:\n");
        println!(
            "  {PREREQUISITES:14} {:8} the machine meets the prerequisites; always first",
            ""
        );
        for step in steps(&[]) {
            let part = step.part.map_or("", Part::name);
            println!("  {:14} {part:8} {}", step.name, step.what);
        }
        return Ok(());
    }
    let request = parse(arguments)?;
    let steps = steps(&request.without);
    request.check(&steps)?;
    target::adopt()?;
    let parts = request.parts_needed(&steps);
    let first = Step::new(
        PREREQUISITES,
        "the machine meets the prerequisites",
        move || prerequisites::ensure(&prerequisites::of_parts(&parts)),
    );
    let steps: Vec<Step> = [first].into_iter().chain(steps).collect();
    let chosen = |step: &Step| step.name == PREREQUISITES || request.chooses(step);
    let result = run_all(&steps, &chosen, &|names| request.alone(names));
    if !request.without.is_empty() {
        let parts: Vec<&str> = request.without.iter().map(|part| part.name()).collect();
        println!("Skipped by --without: {}", parts.join(", "));
    }
    if request.without.contains(&Part::Uno) {
        println!("Without uno, lints and tests do not cover the simulated Arduino and its image.");
    }
    result
}

impl Selection {
    /// Whether a step is to run.
    fn chooses(&self, step: &Step) -> bool {
        !step.part.is_some_and(|part| self.without.contains(&part))
            && (self.steps.is_empty() || self.steps.iter().any(|name| name == step.name))
    }

    /// The command that runs these steps alone.
    fn alone(&self, names: &[&'static str]) -> Command {
        let this = std::env::current_exe().unwrap_or_else(|_| "xtask".into());
        let mut command = Command::new(this);
        command.arg("verify").args(names);
        for part in &self.without {
            command.args(["--without", part.name()]);
        }
        command
    }

    /// Refuses steps that do not exist or are skipped.
    fn check(&self, steps: &[Step]) -> Result<(), Failure> {
        for name in self.steps.iter().filter(|name| *name != PREREQUISITES) {
            let Some(step) = steps.iter().find(|step| step.name == name) else {
                return Err(Failure::new(format!(
                    "unknown step {name:?}; `cargo verify --help` lists the steps"
                )));
            };
            if !self.chooses(step) {
                return Err(Failure::new(format!(
                    "the step {name} is named, but skipped by --without"
                )));
            }
        }
        Ok(())
    }

    /// The parts whose prerequisites the selected steps need. The step
    /// `prerequisites`, if named, tests those of all parts that are not skipped.
    fn parts_needed(&self, steps: &[Step]) -> Vec<Part> {
        let everything = self.steps.iter().any(|name| name == PREREQUISITES);
        let needed: Vec<Part> = steps
            .iter()
            .filter(|step| everything || self.chooses(step))
            .flat_map(Step::parts_needed)
            .collect();
        Part::ALL
            .into_iter()
            .filter(|part| needed.contains(part) && !self.without.contains(part))
            .collect()
    }
}

fn parse(arguments: &[String]) -> Result<Selection, Failure> {
    let mut request = Selection::default();
    let mut arguments = arguments.iter().map(String::as_str);
    while let Some(argument) = arguments.next() {
        let list = match argument.strip_prefix("--without") {
            Some("") => arguments.next().ok_or_else(|| {
                Failure::new(format!("--without needs the names of parts\n\n{USAGE}"))
            })?,
            Some(list) if list.starts_with('=') => &list[1..],
            _ if argument.starts_with('-') => {
                return Err(Failure::new(format!(
                    "unknown option {argument:?}\n\n{USAGE}"
                )));
            }
            _ => {
                request.steps.push(argument.to_owned());
                continue;
            }
        };
        for name in list.split(',') {
            let part = Part::ALL
                .into_iter()
                .find(|part| part.name() == name)
                .ok_or_else(|| {
                    Failure::new(format!(
                        "--without {name:?}: the parts are uno, odroid, readers, python, ros, octave, browser, slurm, units, debian"
                    ))
                })?;
            if !request.without.contains(&part) {
                request.without.push(part);
            }
        }
    }
    Ok(request)
}

/// The checks in order: fast ones first, real-time ones last.
fn steps(without: &[Part]) -> Vec<Step> {
    let release = Release {
        uno: !without.contains(&Part::Uno),
    };
    [
        text_steps(release),
        program_steps(release),
        real_time_steps(release),
    ]
    .into_iter()
    .flatten()
    .collect()
}

/// Static checks.
fn text_steps(release: Release) -> Vec<Step> {
    vec![
        Step::new("format", "the code is formatted", format),
        Step::cargo(
            "lints",
            "no warning from compiler or clippy",
            ["clippy", "--workspace", "--all-targets"]
                .into_iter()
                .chain(features(release.uno))
                .chain(["--", "-D", "warnings"]),
        )
        .needing(release.part()),
        Step::new(
            "lints-uno",
            "no warning in the Arduino's image",
            image::lint,
        )
        .of(Part::Uno),
        Step::new(
            "packages",
            "each pure package builds alone, with its own features",
            packages::check_all,
        ),
        Step::new(
            "publish",
            "the packages for others can be packed, and build outside of the workspace",
            publish::check_all,
        ),
        Step::new(
            "documentation",
            "the documentation builds without a warning",
            || {
                check(
                    cargo()
                        .args(["doc", "--workspace", "--no-deps"])
                        .env("RUSTDOCFLAGS", "-D warnings"),
                )
            },
        ),
        Step::new(
            "units",
            "systemd accepts the service's unit without warnings and rates its exposure as low",
            units::check,
        )
        .of(Part::Units),
    ]
}

/// Checks of the programs in virtual time. What other compilers build goes beside; from `tests` on
/// there are tests that use real time now and then.
fn program_steps(release: Release) -> Vec<Step> {
    vec![
        Step::new(
            "odroid",
            "daemon and tools build for the Odroid, and simulate the same bits there",
            move || odroid::verify(release),
        )
        .of(Part::Odroid)
        .needing(release.part())
        .beside(),
        Step::new(
            "same-bits",
            "debug and release builds simulate the same bits",
            move || same_bits::check(release),
        )
        .needing(release.part())
        .beside(),
        Step::new("programs", "release builds of all programs", move || {
            release.build()
        })
        .needing(release.part()),
        Step::new(
            "uno",
            "the Arduino's image has no miscompiled code and stays within its budgets",
            move || uno::check_image(&release.image()?, 0, &mut release.program("uno-figures")?),
        )
        .of(Part::Uno),
        Step::new(
            "faults",
            "random faults in virtual time violate no invariant",
            move || {
                check(
                    release
                        .program("singletrack-faults")?
                        .args(["--count", "300"]),
                )
            },
        )
        .needing(release.part()),
        Step::new(
            "faults-uno",
            "the same with the Arduino's image",
            move || {
                with_image(
                    release,
                    release
                        .program("singletrack-faults")?
                        .args(["--count", "8", "--board", "uno"]),
                )
            },
        )
        .of(Part::Uno),
        Step::new(
            "onboard",
            "cars of all kinds come from the parts to the circle, led by the three procedures",
            move || {
                check(
                    release
                        .program("singletrack-onboard")?
                        .args(["--count", "3"]),
                )
            },
        )
        .needing(release.part()),
        Step::new(
            "readers",
            "independent readers agree on the contents of a record and of a repaired one",
            move || readers::check(release),
        )
        .of(Part::Readers)
        .needing(release.part()),
        Step::new(
            "tests",
            if release.uno {
                "unit, property and virtual-time tests, including the Arduino's image"
            } else {
                "unit, property and virtual-time tests, without the Arduino's image"
            },
            move || {
                let mut tests = release.tests();
                if release.uno {
                    with_image(release, &mut tests)
                } else {
                    check(&mut tests)
                }
            },
        )
        .needing(release.part())
        .quiet(),
        Step::new(
            "slurm",
            "campaigns as job arrays of Slurm give what one process gives",
            move || slurm::check(release),
        )
        .of(Part::Slurm)
        .needing(release.part()),
        Step::new(
            "debian",
            "this machine's Debian package is clean by lintian, complete, and its programs run",
            move || deb::verify(release),
        )
        .of(Part::Debian)
        .needing(release.part()),
        Step::new(
            "book",
            "the commands of the documentation: all are read by their programs, most are run",
            move || {
                let mut book = release.tests();
                check(book.args(["--test", "book"]))
            },
        )
        .needing(release.part())
        .quiet(),
        Step::new(
            "python",
            "the Python package installs, and drives the simulator and the daemon on both boards",
            move || python::check(release),
        )
        .of(Part::Python)
        .needing(release.part())
        .quiet(),
    ]
}

/// Checks in real time.
fn real_time_steps(release: Release) -> Vec<Step> {
    let suite = move |board| {
        let mut suite = release.suite();
        suite
            .args(["--board", board, "--daemon"])
            .arg(release.path("singletrackd")?);
        Ok::<_, Failure>(suite)
    };
    vec![
        Step::new(
            "hil-native",
            "hardware in the loop: the shipped daemon against the simulated board",
            move || check(&mut suite("native")?),
        )
        .needing(release.part()),
        Step::new(
            "hil-uno",
            "the same against the Arduino's image",
            move || with_image(release, &mut suite("uno")?),
        )
        .of(Part::Uno),
        Step::new(
            "octave",
            "the example for MATLAB drives the car over TCP, in Octave",
            move || check(suite("native")?.args(["--octave", "in_octave"])),
        )
        .of(Part::Octave)
        .needing(release.part()),
        Step::new(
            "browser",
            "the daemon's page shows a drive in Chromium, at a desk and on a telephone",
            move || check(suite("native")?.args(["--browser", "in_a_browser"])),
        )
        .of(Part::Browser)
        .needing(release.part()),
        Step::new(
            "ros",
            "a node of ROS 2 in Python reads the car and drives it",
            move || ros::check(release),
        )
        .of(Part::Ros)
        .needing(release.part()),
    ]
}

/// Runs a command with this source's image: a step that runs alone must not test an
/// old image or one named by the environment.
fn with_image(release: Release, command: &mut Command) -> Result<(), Failure> {
    let image = release.image()?;
    check(command.env("SINGLETRACK_UNO", &image.folder))
}

/// Checks the format of the workspace and of the image, which is not a member.
fn format() -> Result<(), Failure> {
    check(cargo().args(["fmt", "--all", "--check"]))?;
    check(
        cargo()
            .current_dir(image::folder())
            .args(["fmt", "--check"]),
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parsed(line: &str) -> Result<Selection, Failure> {
        let arguments: Vec<String> = line.split_whitespace().map(str::to_owned).collect();
        parse(&arguments)
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
            let request = parsed(&line).unwrap();
            request.check(&steps(&request.without)).unwrap();
        }
        let uno = documented("uno");
        assert!(uno.len() > 1, "{uno:?}");
        for line in uno {
            let words: Vec<String> = line.split_whitespace().map(str::to_owned).collect();
            uno::parse(&words).unwrap();
        }
    }

    #[test]
    fn parts_are_skipped_in_either_form() {
        let without = vec![Part::Uno, Part::Readers];
        for line in [
            "--without uno,readers",
            "--without=uno,readers",
            "--without uno --without=readers,uno",
        ] {
            assert_eq!(parsed(line).unwrap().without, without, "{line}");
        }
        let request = parsed("format --without uno tests").unwrap();
        assert_eq!(request.steps, ["format", "tests"]);
    }

    #[test]
    fn an_unknown_part_or_option_is_refused_with_the_known_ones() {
        let why = parsed("--without arduino").unwrap_err().to_string();
        assert!(
            why.contains("\"arduino\"")
                && why.contains(
                    "uno, odroid, readers, python, ros, octave, browser, slurm, units, debian"
                )
        );
        for line in ["--without", "--witout uno", "--without=", "-x"] {
            assert!(parsed(line).is_err(), "{line}");
        }
    }

    #[test]
    fn each_step_has_its_prerequisites_when_run_alone() {
        let needed = |line: &str| {
            let request = parsed(line).unwrap();
            request.parts_needed(&steps(&request.without))
        };
        let uno = vec![Part::Uno];
        for line in [
            "lints",
            "tests",
            "programs",
            "same-bits",
            "faults",
            "hil-native",
            "uno",
        ] {
            assert_eq!(needed(line), uno, "{line}");
        }
        assert_eq!(needed("format documentation packages publish"), []);
        assert_eq!(needed("readers"), [Part::Uno, Part::Readers]);
        assert_eq!(needed("python"), [Part::Uno, Part::Python]);
        assert_eq!(needed("odroid"), [Part::Uno, Part::Odroid]);
        assert_eq!(needed("debian"), [Part::Uno, Part::Debian]);
        assert_eq!(needed(""), Part::ALL);
        assert_eq!(needed("prerequisites"), Part::ALL);
    }

    #[test]
    fn skipped_parts_need_nothing() {
        for line in ["--without uno,odroid", "prerequisites --without uno,odroid"] {
            let request = parsed(line).unwrap();
            let steps = steps(&request.without);
            assert_eq!(
                request.parts_needed(&steps),
                [
                    Part::Readers,
                    Part::Python,
                    Part::Ros,
                    Part::Octave,
                    Part::Browser,
                    Part::Slurm,
                    Part::Units,
                    Part::Debian
                ]
            );
        }
        let request = parsed("tests --without uno").unwrap();
        assert_eq!(request.parts_needed(&steps(&request.without)), []);
    }

    #[test]
    fn an_unknown_or_skipped_step_is_refused() {
        let why = |line: &str| {
            let request = parsed(line).unwrap();
            request
                .check(&steps(&request.without))
                .unwrap_err()
                .to_string()
        };
        assert!(why("test").contains("unknown step \"test\""));
        assert!(why("uno --without uno").contains("skipped by --without"));
    }
}
