//! The command `cargo onboard`; the library's documentation describes it.

use std::{path::PathBuf, process::ExitCode};

use clap::Parser;
use singletrack_onboard::{Campaign, CampaignError};
use singletrack_sim::BoardKind;

/// Take random cars through doctor, bring-up and calibration, by scripted hands, in virtual
/// time.
#[derive(Debug, Parser)]
#[command(name = "cargo onboard", disable_version_flag = true)]
struct Options {
    /// First seed
    #[arg(long, value_name = "N", default_value_t = 1)]
    first_seed: u64,

    /// Number of consecutive seeds
    #[arg(long, value_name = "M", default_value_t = 20)]
    count: u64,

    /// Write a row per car and parameter to this file:
    /// `seed,parameter,unit,truth,estimate,low,high`
    #[arg(long, value_name = "FILE")]
    csv: Option<PathBuf>,

    /// Board to simulate: the board's code, or the UNO image on a simulated processor
    #[arg(long, value_name = "native|uno", default_value_t = BoardKind::Native)]
    board: BoardKind,

    /// Number of threads; does not affect the results [default: one per core]
    #[arg(long, value_name = "N")]
    threads: Option<usize>,

    /// Print every finding
    #[arg(long, short)]
    verbose: bool,
}

fn main() -> ExitCode {
    let options = Options::parse();
    match run(&options) {
        Ok(true) => ExitCode::SUCCESS,
        Ok(false) => ExitCode::FAILURE,
        Err(error) => {
            eprintln!("cargo onboard: {error}");
            ExitCode::FAILURE
        }
    }
}

/// Whether no violation was found, and every planted fault was.
fn run(options: &Options) -> Result<bool, CampaignError> {
    let campaign = Campaign {
        first_seed: options.first_seed,
        count: options.count,
        board: options.board,
        threads: options.threads.unwrap_or_else(|| {
            std::thread::available_parallelism().map_or(1, core::num::NonZero::get)
        }),
    };
    let cars = campaign.run(|car| print!("{}", car.text(options.verbose)));
    let summary = singletrack_onboard::Summary::of(&cars);
    if let Some(path) = &options.csv {
        singletrack_onboard::write_csv(path, &cars)?;
    }
    print!("{summary}");
    Ok(summary.is_good())
}
