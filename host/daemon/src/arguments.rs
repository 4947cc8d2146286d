//! The command line of `singletrackd`, as a library for its manual page.

use std::{num::ParseFloatError, path::PathBuf};

use clap::{Parser, ValueEnum};
use singletrack_core::feasibility::Stand;
use tracing_subscriber::filter::LevelFilter;

const EXIT_STATUS: &str = "\
Exit status:
  0  ended on request; with --check: the configuration is good
  1  an error; with --check: the car can't do what is asked
  2  wrong options, or a missing or invalid configuration";

/// Drives the car: motion capture in, commands to the board out, 100 times a second.
///
/// The car is armed by a request on the control socket, or by --arm. SIGTERM and SIGINT
/// slow the car down, disarm the board and end; a second one disarms at once. SIGHUP
/// reloads the configuration while the car does not drive; if the terminal that started
/// the daemon has been closed, SIGHUP ends it.
#[derive(Debug, Parser)]
#[command(version, name = "singletrackd", after_long_help = EXIT_STATUS)]
pub struct Arguments {
    /// The configuration; singletrackd.example.toml explains every key
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// Arm once, as soon as every arming check passes: the car then moves by itself
    ///
    /// A configuration that --check finds impossible is not armed.
    #[arg(long)]
    pub arm: bool,
    /// With --arm: also if doctor, bring-up and calibrate have not passed with this configuration
    ///
    /// The car then drives with values that have not been measured on it.
    #[arg(long, requires = "arm")]
    pub uncalibrated: bool,
    /// Judge the configuration, and end: mistakes, values left as in the example, and whether
    /// the car can drive its reference inside the geofence
    ///
    /// Warnings go to stderr. The exit status is 1 if the car can't do what is asked, and 2 if
    /// the configuration is invalid.
    #[arg(long)]
    pub check: bool,
    /// With --check: judge the geofence from where the car stands, in m and degrees
    #[arg(long, value_name = "X,Y,YAW", requires = "check")]
    #[arg(allow_hyphen_values = true, value_parser = parse_stand)]
    pub start: Option<Stand>,
    /// The format of the log on stderr. `RUST_LOG` filters it; `NO_COLOR` turns colours off
    #[arg(long, value_enum, value_name = "FORMAT", default_value = "text")]
    pub log_format: LogFormat,
    /// Log warnings and errors only, without `RUST_LOG`
    #[arg(short, long, conflicts_with = "verbose")]
    pub quiet: bool,
    /// Log what helps to find an error of the program, too, without `RUST_LOG`
    #[arg(short, long)]
    pub verbose: bool,
}

impl Arguments {
    /// What is logged without `RUST_LOG`.
    pub const fn log_level(&self) -> LevelFilter {
        match (self.quiet, self.verbose) {
            (true, _) => LevelFilter::WARN,
            (_, true) => LevelFilter::DEBUG,
            _ => LevelFilter::INFO,
        }
    }
}

/// A place to stand, as an argument: X,Y,YAW in m and degrees.
fn parse_stand(text: &str) -> Result<Stand, String> {
    let numbers: Vec<f64> = text
        .split(',')
        .map(|part| part.trim().parse())
        .collect::<Result<_, _>>()
        .map_err(|error: ParseFloatError| format!("{error}: write X,Y,YAW in m and degrees"))?;
    match numbers[..] {
        [x_m, y_m, yaw_deg] if numbers.iter().all(|number| number.is_finite()) => Ok(Stand {
            x_m,
            y_m,
            yaw_rad: yaw_deg.to_radians(),
        }),
        _ => Err("write three numbers: X,Y,YAW in m and degrees".to_owned()),
    }
}

/// The format of the log.
#[derive(Clone, Copy, Debug, ValueEnum)]
pub enum LogFormat {
    /// Lines for people.
    Text,
    /// One JSON object per line.
    Json,
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test may fail")]
mod tests {
    use super::*;

    #[test]
    fn the_command_line_is_consistent() {
        use clap::CommandFactory as _;
        Arguments::command().debug_assert();
    }

    #[test]
    fn less_more_and_the_usual_are_logged_as_asked() {
        for (options, level) in [
            (&["-q"][..], LevelFilter::WARN),
            (&["--verbose"], LevelFilter::DEBUG),
            (&[], LevelFilter::INFO),
        ] {
            let all = [&["singletrackd"], options].concat();
            assert_eq!(Arguments::parse_from(all).log_level(), level);
        }
        assert!(Arguments::try_parse_from(["singletrackd", "-q", "-v"]).is_err());
    }

    #[test]
    fn a_stand_is_three_numbers() {
        let stand = parse_stand("0.5, -1,90").unwrap();
        assert_eq!((stand.x_m, stand.y_m), (0.5, -1.0));
        assert!((stand.yaw_rad - core::f64::consts::FRAC_PI_2).abs() < 1e-12);
        for text in ["", "1,2", "1,2,3,4", "1,2,x", "1,2,inf"] {
            assert!(parse_stand(text).is_err(), "{text}");
        }
    }
}
