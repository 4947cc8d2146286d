//! The command line of Singletrack.

use std::{io::Write as _, path::PathBuf, process::ExitCode};

use clap::{
    ArgMatches, CommandFactory as _, FromArgMatches as _, Parser, Subcommand, ValueEnum,
    error::ErrorKind,
};
#[cfg(feature = "demo")]
use singletrack::demo;
#[cfg(any(feature = "live", feature = "page"))]
use singletrack::viewers;
#[cfg(feature = "operator")]
use singletrack::{
    accept, arm, bench, cameras, control, drive, dump, fleet, import, install_files, jog, recover,
    replay, set_reference, setpoint, status, teach, tune,
};
use singletrack::{arguments::take_negative_numbers, help::grouped, printable::printable};
#[cfg(feature = "paper")]
use singletrack_campaign::{MergeArgs, run_merge};
use singletrack_figures::{output, plot};
#[cfg(feature = "operator")]
use singletrack_logs::judge;
#[cfg(feature = "paper")]
use singletrack_paper::{compare, identify, reproduce, stability};
use singletrack_scenario::simulate;

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
    #[cfg(feature = "demo")]
    /// Drive the paper's circle on the simulated car, in real time.
    Demo(demo::DemoArgs),
    #[cfg(feature = "operator")]
    /// Look at the motion capture without a daemon: its bodies, rate, jitter, latency and ghosts.
    ///
    /// The exit status is 1 if no server sends poses.
    Cameras(cameras::CamerasArgs),
    #[cfg(feature = "operator")]
    /// Check a new car without moving it, and measure what a hand can show; with --stand, how much
    /// the IMU vibrates with turning wheels.
    ///
    /// The exit status is 0 if no step failed, 1 if it was interrupted, and 3 if a step failed.
    Doctor(bench::DoctorArgs),
    #[cfg(feature = "operator")]
    /// Calibrate servo and ESC, wheels off the floor (after the doctor).
    ///
    /// The exit status is 0 if no step failed, 1 if it was interrupted, and 3 if a step failed.
    BringUp(bench::BenchArgs),
    #[cfg(feature = "operator")]
    /// Drive slowly on the floor to measure steering, motor and brakes: after bring-up.
    ///
    /// The exit status is 0 if no step failed, 1 if it was interrupted, and 3 if a step failed.
    Calibrate(bench::BenchArgs),
    #[cfg(feature = "operator")]
    /// Write what drives say of the calibration into the configuration, after showing the change.
    Accept(accept::AcceptArgs),
    #[cfg(feature = "paper")]
    /// Compare controllers on the simulated car: errors, intervals and stops.
    Compare(compare::CompareArgs),
    #[cfg(feature = "page")]
    /// Serve a page that shows in a browser what the daemon does, until Ctrl-C.
    Page(viewers::PageArgs),
    #[cfg(feature = "live")]
    /// Serve the messages of the record to Foxglove, Lichtblick and PlotJuggler, until Ctrl-C.
    Live(viewers::LiveArgs),
    #[cfg(feature = "operator")]
    /// Print or count the messages of a record, of the running daemon, or of the serial line.
    Dump(dump::DumpArgs),
    #[cfg(feature = "operator")]
    /// Make a record of the log of another program.
    Import(import::ImportArgs),
    #[cfg(feature = "operator")]
    /// Say what the pilot would have said of a recorded drive: stops, and errors of its estimate.
    Judge(judge::JudgeArgs),
    /// Draw the figures of a recorded drive.
    Plot(plot::PlotArgs),
    #[cfg(feature = "operator")]
    /// Repair a truncated or damaged record.
    Recover(recover::RecoverArgs),
    #[cfg(feature = "operator")]
    /// Run the pilot on a record's inputs again and compare its outputs with the recorded ones.
    Replay(replay::ReplayArgs),
    #[cfg(feature = "paper")]
    /// Repeat the paper's experiments and analyses, and compare its claims with measured results.
    Reproduce(reproduce::ReproduceArgs),
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
        /// Print the result for programs (plant kind "car"); a drive that does not start is one, too.
        #[arg(long, value_enum, value_name = "FORMAT", conflicts_with = "format")]
        summary: Option<SummaryFormat>,
    },
    #[cfg(feature = "paper")]
    /// Compute where the steady motion is stable: eigenvalues, bifurcations, the sampled loop.
    Stability(stability::StabilityArgs),
    #[cfg(feature = "paper")]
    /// Identify the car's parameters from recorded drives.
    Identify(identify::IdentifyArgs),
    #[cfg(feature = "paper")]
    /// Join the result files of a campaign's shards to the file that one process writes.
    ///
    /// The files come from --shard K/N --json FILE. Gaps, doubles, and files of different
    /// campaigns, options or builds are refused. --from of the command that wrote them prints the
    /// report.
    Merge(MergeArgs),
    #[cfg(feature = "operator")]
    /// Print what the daemon does: mode, reason, what to do about it, and what the car senses.
    Status(status::StatusArgs),
    #[cfg(feature = "operator")]
    /// Arm the car and start driving; the drive ends when this command does.
    ///
    /// With --for the drive ends after a time, with --unattended it does not end by itself. The
    /// exit status is 0 if the drive ended as wanted, 1 if the car was not armed or the
    /// connection was lost, and 3 if something else stopped the car.
    Arm(arm::ArmArgs),
    #[cfg(feature = "operator")]
    /// Give servo and ESC bare pulses, with the wheels off the floor, while this command runs.
    Jog(jog::JogArgs),
    #[cfg(feature = "operator")]
    /// Slow down, stop and disarm.
    Disarm(control::DisarmArgs),
    #[cfg(feature = "operator")]
    /// Emergency stop: neutral at once, until the board is reset.
    Stop(control::ControlArgs),
    #[cfg(feature = "operator")]
    /// One command for several cars, each with a daemon of its own.
    Fleet(fleet::FleetArgs),
    #[cfg(feature = "operator")]
    /// Replace the reference of a standing car; it lasts until the configuration is reloaded.
    SetReference(set_reference::SetReferenceArgs),
    #[cfg(feature = "operator")]
    /// Stream set-points from standard input to a car whose reference is external.
    Setpoint(setpoint::SetpointArgs),
    #[cfg(feature = "operator")]
    /// Change gains or p within the bounds of the configuration, also while the car drives.
    Tune(tune::TuneArgs),
    #[cfg(feature = "operator")]
    /// Drive with a game-pad: one button lets the car drive itself, the other enables the sticks.
    Drive(drive::DriveArgs),
    #[cfg(feature = "operator")]
    /// Record the path that the car is pushed along, as a reference.
    Teach(teach::TeachArgs),
    #[cfg(feature = "operator")]
    /// Write completions for bash, zsh and fish and the manual pages, for packages.
    #[command(hide = true)]
    InstallFiles(install_files::InstallFilesArgs),
}

#[derive(Clone, Copy, ValueEnum)]
enum SimulateFormat {
    /// The result: the tracking error, and of plant kind "car" how the drive ended.
    Text,
    /// The trajectory: one row every 0.05 s, SI units and radians.
    Csv,
}

#[derive(Clone, Copy, ValueEnum)]
enum SummaryFormat {
    /// One JSON object: tracking error, the true ways, speeds and clearance, and why the drive ended.
    Json,
}

fn main() -> ExitCode {
    match run(&parse()) {
        Ok(status) => status,
        Err(error) => {
            eprintln!("singletrack: {}", printable(&error.to_string()));
            ExitCode::FAILURE
        }
    }
}

/// The commands that only a feature of the package brings, as the shell knows them.
const OPTIONAL: [(&str, &str); 5] = [
    ("demo", "demo"),
    ("live", "live"),
    ("page", "page"),
    (
        "operator",
        "cameras doctor bring-up calibrate accept status arm jog disarm stop fleet set-reference setpoint tune drive \
         teach dump import judge recover replay install-files",
    ),
    ("paper", "compare reproduce stability identify merge"),
];

/// The command line; the process ends here if it is wrong.
fn parse() -> Cli {
    let mut command = grouped(take_negative_numbers(Cli::command()));
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
    let (feature, _) = OPTIONAL
        .into_iter()
        .find(|(_, names)| names.split(' ').any(|one| one == name))?;
    command.find_subcommand(name).is_none().then_some(feature)
}

fn run(cli: &Cli) -> Result<ExitCode, Box<dyn std::error::Error>> {
    let done: Result<(), Box<dyn std::error::Error>> = match &cli.command {
        #[cfg(feature = "demo")]
        Command::Demo(args) => Ok(demo::run(args)?),
        #[cfg(feature = "operator")]
        Command::Cameras(args) => return cameras::run(args),
        #[cfg(feature = "operator")]
        Command::Doctor(args) => return bench::run(args.procedure(), &args.bench),
        #[cfg(feature = "operator")]
        Command::BringUp(args) => return bench::run(&bench::BRING_UP, args),
        #[cfg(feature = "operator")]
        Command::Calibrate(args) => return bench::run(&bench::CALIBRATE, args),
        #[cfg(feature = "operator")]
        Command::Accept(args) => accept::run(args),
        #[cfg(feature = "paper")]
        Command::Compare(args) => Ok(compare::run(args)?),
        #[cfg(feature = "page")]
        Command::Page(args) => viewers::page(args),
        #[cfg(feature = "live")]
        Command::Live(args) => viewers::live(args),
        #[cfg(feature = "operator")]
        Command::Dump(args) => Ok(dump::run(args)?),
        #[cfg(feature = "operator")]
        Command::Import(args) => import::run(args),
        #[cfg(feature = "operator")]
        Command::Judge(args) => Ok(judge::run(args)?),
        Command::Plot(args) => Ok(plot::run(args)?),
        #[cfg(feature = "operator")]
        Command::Recover(args) => recover::run(args),
        #[cfg(feature = "operator")]
        Command::Replay(args) => return replay::run(args),
        #[cfg(feature = "paper")]
        Command::Stability(args) => Ok(stability::run(args)?),
        #[cfg(feature = "paper")]
        Command::Reproduce(args) => Ok(reproduce::run(args)?),
        #[cfg(feature = "paper")]
        Command::Identify(args) => Ok(identify::run(args)?),
        #[cfg(feature = "paper")]
        Command::Merge(args) => Ok(run_merge(args)?),
        #[cfg(feature = "operator")]
        Command::Status(args) => Ok(status::run(args)?),
        #[cfg(feature = "operator")]
        Command::Arm(args) => return Ok(arm::run(args)?),
        #[cfg(feature = "operator")]
        Command::Jog(args) => return Ok(jog::run(args)?),
        #[cfg(feature = "operator")]
        Command::Disarm(args) => Ok(control::disarm(args)?),
        #[cfg(feature = "operator")]
        Command::Stop(args) => Ok(control::stop(args)?),
        #[cfg(feature = "operator")]
        Command::Fleet(args) => return fleet::run(args),
        #[cfg(feature = "operator")]
        Command::SetReference(args) => set_reference::run(args),
        #[cfg(feature = "operator")]
        Command::Setpoint(args) => setpoint::run(args),
        #[cfg(feature = "operator")]
        Command::Tune(args) => Ok(tune::run(args)?),
        #[cfg(feature = "operator")]
        Command::Drive(args) => return drive::run(args),
        #[cfg(feature = "operator")]
        Command::Teach(args) => teach::run(args),
        #[cfg(feature = "operator")]
        Command::InstallFiles(args) => Ok(install_files::run(args, &Cli::command())?),
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
            };
            let simulation = simulate::simulate_with(&scenario, options)?;
            for note in &simulation.notes {
                eprintln!("singletrack: note: {note}");
            }
            let mut text = Vec::new();
            match (summary, format) {
                (Some(SummaryFormat::Json), _) => {
                    serde_json::to_writer(&mut text, &simulation.summary)?;
                    text.push(b'\n');
                }
                (None, SimulateFormat::Text) => writeln!(text, "{simulation}")?,
                (None, SimulateFormat::Csv) => simulate::write_csv(&simulation.rows, &mut text)?,
            }
            Ok(output::print(&String::from_utf8(text)?)?)
        }
    };
    done.map(|()| ExitCode::SUCCESS)
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test may fail")]
mod tests {
    use clap::{Arg, Command, CommandFactory};
    use singletrack::{
        arguments::{take_negative_numbers, takes_number},
        help::GROUPS,
    };

    use super::{Cli, OPTIONAL, missing_feature};

    #[test]
    fn a_command_of_a_feature_is_known_with_it_and_named_without() {
        let command = Cli::command();
        for (feature, names) in OPTIONAL {
            let built = match feature {
                "demo" => cfg!(feature = "demo"),
                "live" => cfg!(feature = "live"),
                "page" => cfg!(feature = "page"),
                "operator" => cfg!(feature = "operator"),
                _ => cfg!(feature = "paper"),
            };
            for name in names.split(' ') {
                let missing = missing_feature(&command, name);
                assert_eq!(missing, (!built).then_some(feature), "{name}");
            }
        }
        let kept = ["plot", "simulate"];
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
        let command = Cli::command();
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
