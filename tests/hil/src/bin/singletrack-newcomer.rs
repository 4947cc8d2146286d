//! `singletrack-newcomer`: takes a simulated car from the parts to a drive, in real time, with
//! the installed programs. It shows the procedures before they are done with a real car.

use std::{
    io::{self, Write as _},
    path::PathBuf,
    process::ExitCode,
};

use clap::Parser;
use singletrack_hil::{
    Failure, Outcome,
    newcomer::{Newcomer, Next, Session, Terminal},
};
use singletrack_onboard::{OnboardCar, Rehearsal};
use singletrack_sim::{HandCommand, HandMotion};

/// Watch a simulated person calibrate a simulated car.
///
/// Starts singletrack-sim and singletrackd, and runs `singletrack doctor`, `bring-up` and
/// `calibrate` in a terminal, in real time. A scripted person reads the questions, moves the
/// car, holds the space bar and answers. Then the car is armed and drives a circle.
///
/// It takes about a quarter of an hour. The folder keeps the calibrated configuration, the
/// pages with the findings, the records and the logs.
#[derive(Debug, Parser)]
#[command(name = "singletrack-newcomer", version)]
struct Options {
    /// Folder for everything that is written
    #[arg(value_name = "DIR", default_value = "singletrack-newcomer")]
    folder: PathBuf,

    /// Seed of the car and of the person; one car in ten has a planted fault, which is reported
    #[arg(long, value_name = "N", default_value_t = 3)]
    seed: u64,

    /// First procedure: those before it have passed with the configuration in DIR
    ///
    /// Run again with the one that was interrupted or failed: it goes on with that step.
    #[arg(long, value_name = "PROCEDURE", default_value = "doctor",
          value_parser = PROCEDURES)]
    from: String,

    /// Last procedure; the car drives after calibrate only
    #[arg(long, value_name = "PROCEDURE", default_value = "calibrate",
          value_parser = PROCEDURES)]
    until: String,

    /// Folder of singletrack, singletrackd and singletrack-sim [default: that of this program]
    #[arg(long, value_name = "DIR")]
    programs: Option<PathBuf>,
}

/// The procedures in their order.
const PROCEDURES: [&str; 3] = ["doctor", "bring-up", "calibrate"];

/// How long the car drives at the end.
const DRIVE: &str = "20s";

fn main() -> ExitCode {
    match run(&Options::parse()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => {
            eprintln!("singletrack-newcomer: {failure}");
            ExitCode::FAILURE
        }
    }
}

fn run(options: &Options) -> Outcome {
    let programs = match &options.programs {
        Some(folder) => folder.clone(),
        None => std::env::current_exe()
            .map_err(Failure::system("can't find this program"))?
            .with_file_name(""),
    };
    // Sockets have short paths, and the daemon another folder.
    let folder =
        std::path::absolute(&options.folder).map_err(Failure::system("the current folder"))?;
    let car = OnboardCar::random(options.seed);
    // In virtual time: which questions there are.
    let rehearsal = Rehearsal::of(&car)
        .map_err(|error| Failure::new(format!("the car of --seed {}: {error}", options.seed)))?;
    let mut newcomer = Newcomer::start(car, &folder, &programs)?;
    if options.from == "bring-up" {
        // A bring-up that goes on does not ask again whether the car is on its stand.
        newcomer.do_by_hand(HandCommand::Move(HandMotion::Lift { height_m: 0.1 }))?;
    }
    for procedure in PROCEDURES
        .into_iter()
        .skip_while(|one| *one != options.from)
    {
        attend(&mut newcomer, &rehearsal, &[procedure])?;
        if procedure == options.until {
            break;
        }
    }
    if PROCEDURES.last() == Some(&options.until.as_str()) {
        newcomer.place_at_circle()?;
        attend(&mut newcomer, &rehearsal, &["arm", "--for", DRIVE])?;
    }
    println!("\nThe configuration: {}", newcomer.config().display());
    Ok(())
}

/// Runs a command to its end, and shows its terminal.
fn attend(newcomer: &mut Newcomer, rehearsal: &Rehearsal, command: &[&str]) -> Outcome {
    println!("\n$ singletrack {}", command.join(" "));
    let mut shown = 0;
    let mut show = |text: &str| {
        // A terminal that nobody reads any more does not end the procedure.
        let text = Terminal::finished(text);
        let _ = io::stdout().write_all(text.get(shown..).unwrap_or_default().as_bytes());
        let _ = io::stdout().flush();
        shown = text.len();
    };
    let Session { text, status, time } = newcomer.run(command, rehearsal, |text, _, _| {
        show(text);
        Next::GoOn
    })?;
    show(&text);
    println!("[{:.0} s]", time.as_secs_f64());
    match status {
        Some(status) if status.success() => Ok(()),
        Some(status) => Err(Failure::new(format!(
            "singletrack {}: {status}",
            command.join(" ")
        ))),
        None => Err(Failure::new("the command is still running")),
    }
}
