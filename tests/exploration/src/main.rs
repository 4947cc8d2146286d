//! The command `cargo explore`; the library's documentation describes it.

use std::{
    io::{self, IsTerminal as _},
    path::PathBuf,
    process::ExitCode,
    time::Instant,
};

use clap::Parser;
use singletrack_core::Config;
use singletrack_exploration::{Explorer, Limits, Setting, Stopped, Theme};

/// Explore every interleaving of board, link and supervisor.
#[derive(Debug, Parser)]
#[command(name = "cargo explore", disable_version_flag = true)]
struct Options {
    /// What can happen; several with commas
    #[arg(
        long,
        value_name = "frames|wires|operator|all",
        value_parser = theme,
        value_delimiter = ',',
        default_value = "frames,wires,operator"
    )]
    theme: Vec<Theme>,

    /// Ticks of 10 ms in which something happens, between two times of calm
    #[arg(long, value_name = "N", default_value_t = 1)]
    burst: u8,

    /// Stop at this number of states of each theme: about 1,000 take a second, and 5 MB
    #[arg(long, value_name = "N", default_value_t = 20_000)]
    states: usize,

    /// Configuration of the daemon [default: the example]
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
}

fn theme(word: &str) -> Result<Theme, String> {
    let known = Theme::ALL.into_iter().find(|theme| theme.name() == word);
    known.ok_or_else(|| "expected frames, wires, operator or all".to_owned())
}

fn main() -> ExitCode {
    match run(&Options::parse()) {
        Ok(true) => ExitCode::SUCCESS,
        Ok(false) => ExitCode::FAILURE,
        Err(error) => {
            eprintln!("explore: {error}");
            ExitCode::from(2)
        }
    }
}

/// True if every claim holds.
fn run(options: &Options) -> Result<bool, String> {
    let setting = setting(options)?;
    for &theme in &options.theme {
        let limits = Limits {
            theme,
            burst: options.burst,
            states: options.states,
        };
        let start = Instant::now();
        let shows = io::stderr().is_terminal();
        let explored = Explorer::new(&setting, limits).run(|explored, open| {
            if shows {
                eprint!(
                    "\r{}: {} states, {open} open, depth {}, {:.0} s ",
                    theme.name(),
                    explored.states,
                    explored.depth,
                    start.elapsed().as_secs_f64()
                );
            }
        });
        if shows {
            eprintln!();
        }
        match explored {
            Ok(explored) => println!("{}: {explored}", theme.name()),
            Err(Stopped::Violated(found)) => {
                println!("{}: {found}", theme.name());
                return Ok(false);
            }
            Err(Stopped::Setting(error)) => return Err(error),
        }
    }
    Ok(true)
}

fn setting(options: &Options) -> Result<Setting, String> {
    let text = match &options.config {
        None => include_str!("../../../host/daemon/singletrackd.example.toml").to_owned(),
        Some(file) => {
            std::fs::read_to_string(file).map_err(|error| format!("{}: {error}", file.display()))?
        }
    };
    let config = Config::from_toml(&text).map_err(|error| error.to_string())?;
    Setting::of(&config)
}
