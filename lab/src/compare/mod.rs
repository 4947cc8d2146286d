//! `singletrack compare`: controllers on the simulated car, against each other.
//!
//! Every controller drives the same car with the same seeds: the complete host with its
//! supervisor, the board, noisy and late cameras. The errors are those of the true car.

mod controller;
mod counted;
mod course;
mod drive;
mod foreign;
mod ideal;
mod plan;
mod predictive;
mod table;

use std::path::PathBuf;

use clap::{Args, ValueEnum};
use singletrack_campaign::{Campaign, CampaignArgs};
use singletrack_figures::output::{make_folder, write};

use crate::{Result, print};

pub use controller::{Controller, ControllerName};
pub use counted::{AddedDelay, DriveError, DriveResult, Effort, Errors, OwnPoint};
pub use course::PathName;
use course::TEST_PATHS;
pub use drive::{Condition, Decide};
pub use plan::{BUDGET, Comparison, Row};
pub use table::{
    DELAYS_HEADER, DelayLine, HEADER, Line, csv, delays, delays_csv, delays_markdown, figure,
    lines, lines_with, markdown,
};

/// Options of `singletrack compare`.
#[derive(Clone, Debug, Args)]
pub struct CompareArgs {
    /// Controllers to compare [default: all].
    #[arg(long, value_enum, value_name = "NAMES", value_delimiter = ',')]
    pub controllers: Vec<Controller>,

    /// Paths to drive [default: the test paths, on which no parameter was chosen].
    #[arg(long, value_enum, value_name = "NAMES", value_delimiter = ',')]
    pub paths: Vec<PathName>,

    /// Speeds, in m/s [default: 1.0,1.5].
    #[arg(long, value_name = "SPEEDS", value_delimiter = ',', value_parser = speed)]
    pub speeds: Vec<f64>,

    /// Conditions [default: nominal].
    #[arg(long, value_enum, value_name = "NAMES", value_delimiter = ',')]
    pub conditions: Vec<Condition>,

    /// Every path at 0.5, 1.0, 1.5 and 1.8 m/s under every condition, except those that are given:
    /// hours.
    #[arg(long)]
    pub all: bool,

    /// First seed. Seed 0 is that of the tuning.
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub first_seed: u64,

    /// Number of seeds of each row, the same for all.
    #[arg(long = "count", value_name = "M", default_value_t = 30, value_parser = clap::value_parser!(u64).range(1..))]
    pub seeds: u64,

    /// Number of seeds with which the added delay is searched, where --count is more: a search
    /// takes some ten drives.
    #[arg(long = "delay-count", value_name = "M", default_value_t = 10, value_parser = clap::value_parser!(u64).range(1..))]
    pub delay_seeds: u64,

    /// How to print the result.
    #[arg(long, value_enum, default_value_t = CompareFormat::Markdown)]
    pub format: CompareFormat,

    /// Write compare.csv, compare.md and, where there is something to write, compare.svg (condition
    /// nominal) and delays.csv into this folder, too.
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,

    /// Tune the controllers in place of comparing them: each tries 25 parameters on the same
    /// drives.
    #[arg(long, conflicts_with_all = ["shard", "json", "from", "out"])]
    pub tune: bool,

    /// How it is run.
    #[command(flatten)]
    pub campaign: CampaignArgs,
}

/// How to print the result.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum CompareFormat {
    /// For a page, in mm, the best first.
    Markdown,
    /// For a program, in m, every digit.
    Csv,
}

fn speed(text: &str) -> Result<f64, String> {
    match text.parse() {
        Ok(speed) if (0.1..=2.0).contains(&speed) => Ok(speed),
        _ => Err("a speed lies between 0.1 and 2 m/s".to_owned()),
    }
}

/// What is given, or all of it, or the default.
fn or<T: Clone>(given: &[T], is_all: bool, all: &[T], default: &[T]) -> Vec<T> {
    match (given, is_all) {
        ([], true) => all,
        ([], false) => default,
        _ => given,
    }
    .to_vec()
}

const ALL_SPEEDS_M_S: [f64; 4] = [0.5, 1.0, 1.5, 1.8];
const SPEEDS_M_S: [f64; 2] = [1.0, 1.5];

/// Runs the comparison, prints and writes its table.
///
/// # Errors
///
/// A drive can't be simulated, or a file can't be read or written.
pub fn run(args: &CompareArgs) -> Result {
    let controllers = Controller::value_variants();
    let controllers = or(&args.controllers, true, controllers, &[]);
    if args.tune {
        return print(&plan::tune(&controllers, args.campaign.threads())?);
    }
    if let Some(folder) = &args.out {
        // Before hours of work.
        make_folder(folder)?;
    }
    let mut conditions = or(
        &args.conditions,
        args.all,
        Condition::value_variants(),
        &[Condition::Nominal],
    );
    if args.conditions.is_empty()
        && args.format == CompareFormat::Csv
        && args.out.is_none()
        && args.campaign.json.is_none()
    {
        // This table does not have the delays, whose search takes longest.
        conditions.retain(|condition| *condition != Condition::AddedDelay);
    }
    let plan = Comparison {
        controllers,
        paths: or(
            &args.paths,
            args.all,
            PathName::value_variants(),
            &TEST_PATHS,
        ),
        speeds_m_s: or(&args.speeds, args.all, &ALL_SPEEDS_M_S, &SPEEDS_M_S),
        conditions,
        first_seed: args.first_seed,
        seeds: args.seeds,
        delay_seeds: args.delay_seeds,
    };
    let campaign = Campaign::obtain(plan, &args.campaign)?;
    let lines = lines(&campaign.experiment, &campaign.results);
    let delays = delays(&campaign.experiment, &campaign.results);
    let csv = csv(&lines);
    let markdown = markdown(&lines) + &delays_markdown(&delays);
    if let Some(folder) = &args.out {
        let mut files = vec![
            ("compare.csv", csv.clone()),
            ("compare.md", markdown.clone()),
        ];
        if !delays.is_empty() {
            files.push(("delays.csv", delays_csv(&delays)));
        }
        if let Some(figure) = figure(&lines) {
            files.push(("compare.svg", figure.to_svg()));
        }
        for (name, text) in files {
            write(&folder.join(name), &text)?;
        }
    }
    print(match args.format {
        CompareFormat::Csv => &csv,
        CompareFormat::Markdown => &markdown,
    })
}
