//! `singletrack accept`: writes what drives say of the calibration into the configuration.

use std::{
    io::{self, IsTerminal as _},
    path::{Path, PathBuf},
};

use clap::Args;
use jiff::Timestamp;
use serde_json::Value as Json;
use singletrack_api::{Calibration, Request, ask};
use singletrack_commissioning::edit::Edit;
use singletrack_control::{CalibrationEstimate, CalibrationParameter};
use singletrack_core::{
    Config,
    feasibility::judge,
    online_calibration::{OnlineCalibration, advice, corrected, deviation, units},
};
use singletrack_pilot::DriveCommand;
use singletrack_record::{Entry, Reader, Topic};
use toml_edit::Value;

use crate::{
    Result,
    operator::control::{self, ControlArgs},
};

/// Options of `singletrack accept`.
#[derive(Clone, Debug, Args)]
pub struct AcceptArgs {
    /// The record of a drive that says it, also of one without advice [default: ask the daemon]
    #[arg(value_name = "RECORD.mcap", requires = "config")]
    record: Option<PathBuf>,
    /// The configuration to change [default: that of the daemon]
    #[arg(long, value_name = "FILE", requires = "record")]
    config: Option<PathBuf>,
    /// Print what the record and its halves say of every parameter by this configuration, as true
    /// less configured values with 95 %; write nothing
    #[arg(long, requires = "record", conflicts_with = "yes")]
    check: bool,
    /// Write without asking
    #[arg(long)]
    yes: bool,
    #[command(flatten)]
    control: ControlArgs,
}

/// The daemon estimates nothing, or has not driven yet.
const UNKNOWN: &str = "the daemon knows nothing of its calibration: set online_calibration.mode = \
                       \"advice\" and drive bends to both sides for a minute, or give the record of \
                       such a drive";

/// The daemon was started without a file.
const NO_FILE: &str = "the daemon has no configuration file: start it with --config";

/// Nobody has agreed.
const NOT_AGREED: &str = "nothing was written: agree with y, or give --yes";

/// Shows the advice and the change, and writes it if the operator agrees.
///
/// # Errors
///
/// Nothing is known, the file is not the one that was driven with, or the new values do not fit.
pub fn run(args: &AcceptArgs) -> Result<()> {
    if let (true, Some(record), Some(config)) = (args.check, &args.record, &args.config) {
        return control::print(&check(record, &Config::read(config)?)?);
    }
    let (known, path) = match (&args.record, &args.config) {
        (Some(record), Some(config)) => (of_record(record)?, config.clone()),
        _ => of_daemon(&args.control)?,
    };
    let Some(line) = known.line() else {
        return control::print("the drives contradict no value");
    };
    control::print(&line)?;
    if known.corrections.is_empty() {
        return Ok(());
    }
    let edit = change(&path, &known)?;
    control::print(edit.diff(&path.display().to_string()).trim_end())?;
    if !args.yes && !agrees() {
        return Err(NOT_AGREED.into());
    }
    let date = Timestamp::now().strftime("%Y-%m-%dT%H%M%SZ").to_string();
    if let Some(kept) = edit.write(&path, &date)? {
        control::print(&format!("The old file is {}.", kept.display()))?;
    }
    if args.record.is_some() {
        return Ok(());
    }
    let reloaded =
        ask(&Request::Reload {}, &args.control.socket).map_err(|error| error.to_string());
    control::print(&match reloaded {
        Ok(_) => "The daemon has reloaded it.".to_owned(),
        Err(error) => format!("The file is written, but not in force yet: {error}"),
    })
}

/// What the daemon knows, and the file that it reads.
fn of_daemon(control: &ControlArgs) -> Result<(Calibration, PathBuf)> {
    let status = ask(&Request::Status {}, &control.socket)?.status;
    let status = status.ok_or(UNKNOWN)?;
    let known = status.calibration.ok_or(UNKNOWN)?;
    let path = status.config_path.ok_or(NO_FILE)?;
    Ok((known, path.into()))
}

/// What the drives of a record say of their last configuration.
fn of_record(path: &Path) -> Result<Calibration> {
    let mut reader = Reader::open(path)?.only(&[Topic::Configuration, Topic::Tick]);
    let mut config = Config::from_toml(&reader.meta.configuration)?;
    let mut calibration = OnlineCalibration::of(&config);
    for entry in reader.by_ref() {
        match entry? {
            Entry::Configuration(record) => {
                config = Config::from_toml(&record.toml)?;
                calibration = OnlineCalibration::of(&config);
            }
            Entry::Tick(tick) if tick.output.mode.is_underway() => {
                calibration.tick(&tick);
            }
            _ => {}
        }
    }
    Ok(advice(&config, &calibration.errors.estimates()))
}

/// A line a parameter: what the ticks of all drives of a record say, and each half of them.
fn check(path: &Path, config: &Config) -> Result<String> {
    let mut ticks = Vec::new();
    for entry in Reader::open(path)?.only(&[Topic::Tick]) {
        if let Entry::Tick(mut tick) = entry?
            && tick.output.mode.is_underway()
        {
            // An imported log may have no speed, and therefore no command.
            tick.output.command.get_or_insert(DriveCommand {
                rear_speed: 0.0,
                steering: tick.output.actuation.steering,
                pose_time: tick.pilot_time,
                brake: false,
            });
            ticks.push(tick);
        }
    }
    let (first, second) = ticks.split_at(ticks.len() / 2);
    let columns = [&ticks[..], first, second].map(|ticks| {
        let mut calibration = OnlineCalibration::of(config);
        for tick in ticks {
            calibration.tick(tick);
        }
        calibration.errors.estimates()
    });
    let row = |[name, whole, first, second]: [String; 4]| {
        format!("{name:<16} {whole:>20} {first:>20} {second:>20}")
    };
    let mut lines = vec![row(
        ["", "whole", "first half", "second half"].map(str::to_owned)
    )];
    for (index, parameter) in CalibrationParameter::ALL.iter().enumerate() {
        let [whole, first, second] = columns.each_ref().map(|column| said(&column[index]));
        lines.push(row([parameter.to_string(), whole, first, second]));
    }
    Ok(lines.join("\n"))
}

/// A gross error is this many half widths.
const SURE: f64 = 3.0;

/// The [`deviation`]; an error so large that it shows although no interval can be relied on is said
/// without one.
fn said(estimate: &CalibrationEstimate) -> String {
    let off = estimate.value.abs();
    // The others are confounded in steady turns.
    let gross = match estimate.parameter {
        CalibrationParameter::PivotForward => 0.06,
        CalibrationParameter::SteeringGain => 0.15,
        _ => f64::INFINITY,
    };
    if estimate.observable || off < gross || off < SURE * estimate.half_width {
        return deviation(estimate);
    }
    let (_, unit, scale, digits) = units(estimate.parameter);
    let (value, digits) = (scale * estimate.value, digits.saturating_sub(1));
    format!("about {value:+.digits$} {unit}")
}

/// The change of the file, if it passes what `singletrackd --check` judges.
fn change(path: &Path, known: &Calibration) -> Result<Edit> {
    let config = corrected(&Config::read(path)?, &known.corrections)?;
    let judgement = judge(&config, None)?;
    if !judgement.is_possible() {
        let findings = judgement.findings.iter().map(ToString::to_string);
        let findings = findings.collect::<Vec<_>>().join("; ");
        return Err(format!("{findings}; change that first, and accept then").into());
    }
    let mut edit = Edit::read(path)?;
    for correction in &known.corrections {
        let (key, value) = (&correction.key, &correction.value);
        let cannot = || format!("{key} = {value} can't be written: set it by hand");
        edit.set(key, &written(value).ok_or_else(cannot)?)?;
    }
    Ok(edit)
}

/// A number, or a list of numbers, as it is written.
fn written(value: &Json) -> Option<Value> {
    match value {
        Json::Number(number) => match number.as_i64() {
            Some(number) => Some(number.into()),
            None => number.as_f64().map(Value::from),
        },
        Json::Array(values) => values.iter().map(written).collect::<Option<_>>(),
        _ => None,
    }
}

/// Whether somebody at a terminal says yes.
fn agrees() -> bool {
    if !io::stdin().is_terminal() {
        return false;
    }
    eprint!("Write it? [y/N] ");
    let mut line = String::new();
    io::stdin().read_line(&mut line).is_ok() && matches!(line.trim(), "y" | "yes")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_gross_error_is_said_where_no_interval_can_be_given() {
        let estimate = |parameter, value, half_width| CalibrationEstimate {
            parameter,
            value,
            half_width,
            observable: false,
        };
        let pivot = |value, half_width| {
            said(&estimate(
                CalibrationParameter::PivotForward,
                value,
                half_width,
            ))
        };
        assert_eq!(pivot(-0.12, 0.01), "about -120 mm");
        assert_eq!(pivot(-0.12, 0.05), "not observable");
        assert_eq!(pivot(0.03, 0.005), "not observable");
        let gain = estimate(CalibrationParameter::SteeringGain, 0.22, 0.04);
        assert_eq!(said(&gain), "about +22 %");
        let yaw = estimate(CalibrationParameter::BodyYaw, 0.2, 0.01);
        assert_eq!(said(&yaw), "not observable");
    }
}
