//! The program `singletrack`.

use std::{io::Write as _, path::PathBuf, process::ExitCode};

use clap::{
    ArgMatches, CommandFactory as _, FromArgMatches as _, Parser, Subcommand, ValueEnum,
    error::ErrorKind,
};
use singletrack_core::feasibility::{Judgement, judge_reference};
use singletrack_figures::{output, plot};
use singletrack_scenario::simulate;

use crate::{
    Result, arguments::take_negative_numbers, demo, help::grouped, help::printable, lab, viewers,
};

const AFTER: &str = "\
Exit status:
  0    done
  1    failed; the reason is on standard error
  2    wrong options
  3    arm, drive, jog: something else than the operator stopped the car; doctor, bring-up,
       calibrate: a step failed
  4    replay: another controller made the record, and its outputs differ
  130  interrupted for the second time, before the first Ctrl-C was obeyed

Environment:
  SINGLETRACK_SOCKET  the daemon's control socket, where --socket is not given
  NO_COLOR            if it is not empty, no colours";

/// Drive a small car by feedback linearisation: simulate, drive, analyse.
#[derive(Parser)]
#[command(version, max_term_width = 100, after_long_help = AFTER)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Drive the paper's circle on the simulated car, in real time.
    Demo(demo::DemoArgs),
    /// Serve a page that shows in a browser what the daemon does, until Ctrl-C.
    Page(viewers::PageArgs),
    #[cfg(feature = "live")]
    /// Serve the messages of the record to Foxglove, Lichtblick and PlotJuggler, until Ctrl-C.
    Live(viewers::LiveArgs),
    /// Draw the figures of a recorded drive.
    Plot(plot::PlotArgs),
    /// Run a scenario in virtual time and print the tracking error, or the trajectory.
    Simulate {
        /// The scenario file.
        scenario: PathBuf,
        /// What to print.
        #[arg(long, value_enum, default_value_t = SimulateFormat::Text)]
        format: SimulateFormat,
        /// Write a record, as the daemon does: every tick's inputs and outputs.
        #[arg(long, value_name = "FILE.mcap")]
        record: Option<PathBuf>,
        /// Print the result for programs (plant kind "car"), as one JSON object: tracking error, the
        /// true ways, speeds and clearance, and why the drive ended, or did not start.
        #[arg(long, value_name = "FORMAT", value_parser = ["json"], conflicts_with = "format")]
        summary: Option<String>,
    },
    #[cfg(feature = "operator")]
    #[command(flatten)]
    Operator(crate::operator::OperatorCommand),
}

#[derive(Clone, Copy, PartialEq, ValueEnum)]
enum SimulateFormat {
    /// The result: the tracking error, and of plant kind "car" how the drive ended.
    Text,
    /// The trajectory: one row every 0.05 s, SI units and radians.
    Csv,
    /// A number for the bits of all outputs (plant kind "car"), which the browser shows, too.
    Digest,
}

/// Its options and commands, without those of the laboratory.
pub fn command() -> clap::Command {
    Cli::command()
}

/// Runs the command line of this process.
pub fn main() -> ExitCode {
    match lab::run().map_err(Into::into).and_then(|()| run(&parse())) {
        Ok(status) => status,
        Err(error) => {
            eprintln!("singletrack: {}", printable(&error.to_string()));
            ExitCode::FAILURE
        }
    }
}

/// The commands that only a feature of the package brings, as the shell knows them.
const OPTIONAL: [(&str, &str); 2] = [
    ("live", "live"),
    (
        "operator",
        "cameras doctor bring-up calibrate accept status arm jog disarm stop fleet set-reference \
         setpoint tune drive dump import recover replay",
    ),
];

/// The command line; the process ends here if it is wrong.
fn parse() -> Cli {
    let mut command = grouped(lab::listed(take_negative_numbers(Cli::command())));
    if let Some(name) = std::env::args().nth(1)
        && let Some(feature) = missing_feature(&command, &name)
    {
        let kind = ErrorKind::InvalidSubcommand;
        let how = "`cargo build --release -p singletrack` builds it with every command";
        let message =
            format!("this program was built without `{name}`, of the feature `{feature}`: {how}");
        command.error(kind, message).exit();
    }
    let matches: ArgMatches = command.get_matches_mut();
    Cli::from_arg_matches(&matches).unwrap_or_else(|error| error.format(&mut command).exit())
}

/// The feature that the command `name` needs and this program lacks.
fn missing_feature(command: &clap::Command, name: &str) -> Option<&'static str> {
    let brings = |(_, names): &(&str, &str)| names.split(' ').any(|one| one == name);
    let (feature, _) = OPTIONAL.into_iter().find(brings)?;
    command.find_subcommand(name).is_none().then_some(feature)
}

fn run(cli: &Cli) -> Result<ExitCode> {
    match &cli.command {
        Command::Demo(args) => demo::run(args)?,
        Command::Page(args) => viewers::page(args)?,
        #[cfg(feature = "live")]
        Command::Live(args) => viewers::live(args)?,
        Command::Plot(args) => plot::run(args)?,
        #[cfg(feature = "operator")]
        Command::Operator(command) => return crate::operator::run(command),
        Command::Simulate {
            scenario,
            format,
            record,
            summary,
        } => {
            let scenario = simulate::Scenario::read(scenario)?;
            let options = simulate::RunOptions {
                record: record.as_deref(),
                summary: summary.is_some(),
                digest: *format == SimulateFormat::Digest,
                ..simulate::RunOptions::default()
            };
            let judgement = judged(&scenario)?;
            for finding in &judgement.findings {
                let level = finding.severity.name();
                eprintln!("singletrack: {level}: {finding}");
            }
            let simulation = simulate::simulate_with(&scenario, options)?;
            for note in &simulation.notes {
                eprintln!("singletrack: note: {note}");
            }
            let mut text = Vec::new();
            match (summary, format) {
                (Some(_), _) => {
                    serde_json::to_writer(&mut text, &simulation.summary)?;
                    text.push(b'\n');
                }
                (None, SimulateFormat::Text) => writeln!(text, "{simulation}")?,
                (None, SimulateFormat::Digest) => {
                    let missing = simulate::SimulateError::NoPilot("no digest");
                    writeln!(text, "{}", simulation.digest.ok_or(missing)?)?;
                }
                (None, SimulateFormat::Csv) => simulate::write_csv(&simulation.rows, &mut text)?,
            }
            output::print(&String::from_utf8(text)?)?;
            // A program that wants a summary judges by it.
            if summary.is_none() && !judgement.is_possible() {
                return Ok(ExitCode::FAILURE);
            }
        }
    }
    Ok(ExitCode::SUCCESS)
}

/// What `singletrackd --check` would say of the scenario's reference; the ideal plant has no limits.
fn judged(scenario: &simulate::Scenario) -> Result<Judgement> {
    if scenario.plant.kind == simulate::PlantKind::Ideal {
        return Ok(Judgement::default());
    }
    let (mut config, _) = simulate::virtual_drive_config(scenario)?;
    // The ends of the bounds are not what is driven.
    config.tuning.enabled = false;
    Ok(judge_reference(&config, None, None)?)
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test may fail")]
mod tests {
    use super::{Cli, OPTIONAL, lab, missing_feature};
    use crate::{
        arguments::{take_negative_numbers, takes_number},
        help::GROUPS,
    };
    use clap::{Arg, Command, CommandFactory};

    #[test]
    fn a_command_of_a_feature_is_known_with_it_and_named_without() {
        let command = Cli::command();
        for (feature, names) in OPTIONAL {
            let built = match feature {
                "live" => cfg!(feature = "live"),
                _ => cfg!(feature = "operator"),
            };
            for name in names.split(' ') {
                let missing = missing_feature(&command, name);
                assert_eq!(missing, (!built).then_some(feature), "{name}");
            }
        }
        let kept = ["demo", "page", "plot", "simulate"];
        let known: Vec<&str> = OPTIONAL
            .iter()
            .flat_map(|(_, names)| names.split(' '))
            .collect();
        for subcommand in command.get_subcommands() {
            let name = subcommand.get_name();
            assert!(known.contains(&name) || kept.contains(&name), "{name}");
        }
    }

    #[test]
    fn every_command_that_is_shown_is_in_one_group_of_the_help() {
        let groups = GROUPS.iter().flat_map(|(_, names)| names.split(' '));
        let mut listed: Vec<_> = groups.collect();
        listed.sort_unstable();
        let command = lab::listed(Cli::command());
        let shown = command.get_subcommands().filter(|one| !one.is_hide_set());
        let mut shown: Vec<_> = shown.map(Command::get_name).collect();
        shown.sort_unstable();
        // A program may be built without some.
        listed.retain(|name| {
            shown.contains(name) || !OPTIONAL.iter().any(|(_, all)| all.contains(name))
        });
        assert_eq!(listed, shown);
    }

    #[test]
    fn the_command_line_is_consistent() {
        take_negative_numbers(Cli::command()).debug_assert();
    }

    /// The names of all subcommands that have options, and these.
    fn options_of(command: &Command, path: &[String], found: &mut Vec<(Vec<String>, Arg)>) {
        let options = command.get_arguments();
        found.extend(options.map(|option| (path.to_vec(), option.clone())));
        for subcommand in command.get_subcommands() {
            let path = [path, &[subcommand.get_name().to_owned()]].concat();
            options_of(subcommand, &path, found);
        }
    }

    #[test]
    fn a_negative_number_is_refused_with_the_option_and_the_value() {
        let mut found = Vec::new();
        options_of(&Cli::command(), &["singletrack".to_owned()], &mut found);
        let numbers: Vec<_> = found
            .into_iter()
            .filter(|(_, option)| takes_number(option))
            .collect();
        assert!(numbers.len() > 20, "{}", numbers.len());
        for (path, option) in numbers {
            let values = option.get_num_args().map_or(1, |range| range.min_values());
            let option = format!("--{}", option.get_long().unwrap_or_default());
            let mut line = [path, vec![option.clone()]].concat();
            line.extend(vec!["-5x".to_owned(); values]);
            let result = take_negative_numbers(Cli::command()).try_get_matches_from(&line);
            let error = result.unwrap_err().to_string();
            assert!(
                error.contains("'-5x'") && error.contains(&option),
                "{line:?}: {error}"
            );
            assert!(!error.contains("unexpected argument"), "{line:?}: {error}");
        }
    }
}
