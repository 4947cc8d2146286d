//! A set-point of the options.

use std::{path::PathBuf, time::Duration};

use clap::{ArgGroup, Args};
use singletrack_api::Setpoint;

use crate::{arguments::parse_duration, operator::control::finite};

/// What the car should do; without any of these, the set-points of standard input.
#[derive(Clone, Debug, Default, Args)]
#[command(
    group(ArgGroup::new("steers").requires("drives").conflicts_with("trajectory")),
    group(ArgGroup::new("drives").requires("steers")),
)]
pub(super) struct DemandArgs {
    /// Velocity of P, in m/s, in the frame of the cameras
    #[arg(long, num_args = 2, value_names = ["VX", "VY"], value_parser = finite)]
    #[arg(conflicts_with_all = ["steers", "drives", "trajectory"])]
    velocity: Option<Vec<f64>>,

    /// Position of P as well, in m: the outer loop tracks it
    #[arg(long, num_args = 2, value_names = ["X", "Y"], value_parser = finite)]
    #[arg(requires = "velocity")]
    position: Option<Vec<f64>>,

    /// Steering angle in place of the law, in rad; positive to the left
    #[arg(long, value_name = "RAD", value_parser = finite, group = "steers")]
    steering: Option<f64>,

    /// Steering rate in place of the angle, in rad/s
    #[arg(long, value_name = "RAD_S", value_parser = finite, group = "steers")]
    steering_rate: Option<f64>,

    /// Speed of the centre of mass, in m/s; negative in reverse
    #[arg(long, value_name = "M_S", value_parser = finite, group = "drives")]
    speed: Option<f64>,

    /// Change of the speed in place of the speed, in m/s2
    #[arg(long, value_name = "M_S2", value_parser = finite, group = "drives")]
    acceleration: Option<f64>,

    /// File of a trajectory of P, CSV or JSON
    #[arg(long, value_name = "FILE")]
    pub(super) trajectory: Option<PathBuf>,

    /// How long the set-point is sent, such as 2.5s; otherwise until Ctrl-C
    #[arg(long = "for", value_name = "DURATION", value_parser = parse_duration, conflicts_with = "trajectory")]
    pub(super) lasts: Option<Duration>,
}

impl DemandArgs {
    /// The set-point of the options; `None` if they have none.
    pub(super) fn setpoint(&self) -> Option<Setpoint> {
        let pair = |values: &Option<Vec<f64>>| values.as_deref()?.try_into().ok();
        let setpoint = Setpoint {
            velocity_m_s: pair(&self.velocity),
            position_m: pair(&self.position),
            steering_rad: self.steering,
            steering_rate_rad_s: self.steering_rate,
            speed_m_s: self.speed,
            acceleration_m_s2: self.acceleration,
            ..Setpoint::default()
        };
        (setpoint != Setpoint::default()).then_some(setpoint)
    }
}

#[cfg(test)]
mod tests {
    use clap::{CommandFactory as _, FromArgMatches as _, Parser, error::ErrorKind};
    use serde_json::json;

    use super::*;
    use crate::arguments::take_negative_numbers;

    #[derive(Debug, Parser)]
    struct Program {
        #[command(flatten)]
        demand: DemandArgs,
    }

    fn parse(options: &str) -> Result<DemandArgs, clap::Error> {
        let words = ["setpoint"].into_iter().chain(options.split(' '));
        let command = take_negative_numbers(Program::command());
        let matches = command.try_get_matches_from(words)?;
        Ok(Program::from_arg_matches(&matches)?.demand)
    }

    #[test]
    fn every_level_has_its_options() {
        for (options, keys) in [
            (
                "--velocity 0.4 -0.1",
                json!({ "velocity_m_s": [0.4, -0.1] }),
            ),
            (
                "--velocity 0 0 --position -1 2.5",
                json!({ "velocity_m_s": [0.0, 0.0], "position_m": [-1.0, 2.5] }),
            ),
            (
                "--steering -0.1 --speed 0.5",
                json!({ "steering_rad": -0.1, "speed_m_s": 0.5 }),
            ),
            (
                "--steering-rate 0.2 --acceleration -0.5 --for 2",
                json!({ "steering_rate_rad_s": 0.2, "acceleration_m_s2": -0.5 }),
            ),
        ] {
            let setpoint = parse(options).unwrap().setpoint().unwrap();
            assert_eq!(json!(setpoint), keys, "{options}");
        }
        assert_eq!(parse("--for 2").unwrap().setpoint(), None);
        let way = parse("--trajectory way.csv").unwrap();
        assert_eq!(
            (way.setpoint(), way.trajectory),
            (None, Some("way.csv".into()))
        );
    }

    #[test]
    fn half_a_set_point_and_two_at_once_are_refused_with_the_options_that_are_missing() {
        for (options, kind, part) in [
            (
                "--steering 0.1",
                ErrorKind::MissingRequiredArgument,
                "--speed",
            ),
            (
                "--speed 0.1",
                ErrorKind::MissingRequiredArgument,
                "--steering",
            ),
            (
                "--position 1 1",
                ErrorKind::MissingRequiredArgument,
                "--velocity",
            ),
            ("--velocity 1", ErrorKind::WrongNumberOfValues, "2 values"),
            (
                "--velocity 1 0 --steering 0.1 --speed 1",
                ErrorKind::ArgumentConflict,
                "--velocity",
            ),
            (
                "--trajectory a.csv --velocity 1 0",
                ErrorKind::ArgumentConflict,
                "--trajectory",
            ),
            (
                "--steering 0.1 --steering-rate 0.1 --speed 1",
                ErrorKind::ArgumentConflict,
                "--steering-rate",
            ),
            (
                "--velocity nan 0",
                ErrorKind::ValueValidation,
                "finite number",
            ),
            ("--velocity 1 0 --for -1", ErrorKind::ValueValidation, "-1"),
        ] {
            let error = parse(options).unwrap_err();
            let text = error.to_string();
            assert!(text.contains(part), "{options}: {text}");
            assert_eq!(error.kind(), kind, "{options}: {text}");
        }
    }
}
