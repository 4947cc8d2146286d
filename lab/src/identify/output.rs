//! The result of an identification: for the screen, and in files.

use std::{fmt::Write as _, path::PathBuf};

use serde_json::{Value, json};
use singletrack_analysis::identification::{
    Criterion, Estimate, Identification, Output, Parameter, Score, ServoFrames, TrackPoint, Tyres,
    Warning,
};
use singletrack_control::VehicleParameters;

use crate::vehicle_file;

/// Drives and their identification.
#[derive(Clone, Debug)]
pub struct Identified {
    /// The drives; at least one.
    pub logs: Vec<LogScore>,
    /// Their result.
    pub identification: Identification,
}

/// How well a drive is simulated.
#[derive(Clone, Debug)]
pub struct LogScore {
    /// The record that it is in.
    pub path: PathBuf,
    /// Its number there, from 1.
    pub drive: usize,
    /// The simulation's score on it.
    pub score: Score,
}

/// The result of the command.
#[derive(Debug)]
pub struct Report {
    /// The nominal car.
    pub vehicle: VehicleParameters,
    /// The tyres' force curve.
    pub tyres: Tyres,
    /// From the records.
    pub identified: Identified,
    /// Validation, drive by drive.
    pub validated: Vec<Identified>,
    /// Validation of the nominal car, if it was asked for, on those drives that it can be.
    pub nominal_validated: Vec<Identified>,
    /// Why there is no validation on the others.
    pub not_validated: Vec<String>,
}

impl Report {
    /// Every drive with its role.
    pub(super) fn logs(&self) -> impl Iterator<Item = (&'static str, &LogScore)> {
        let identified = self.identified.logs.iter();
        let validated = self.validated.iter().flat_map(|one| &one.logs);
        let identified = identified.map(|log| ("identification", log));
        identified.chain(validated.map(|log| ("validation", log)))
    }
}

pub(super) fn json(report: &Report) -> String {
    let Identification {
        estimates,
        criterion,
        warnings,
        ..
    } = &report.identified.identification;
    let parameters = estimates.iter().map(|estimate| {
        let [low, high] = estimate.interval;
        let of = json!({ "value": estimate.value, "low": low, "high": high });
        (estimate.parameter.name().to_owned(), of)
    });
    let logs = report.logs().map(|(role, log)| {
        let fit = |wanted: Output| {
            let mut outputs = log.score.outputs.iter();
            let found = outputs.find(|one| one.output == wanted);
            found.map(|one| one.fit_percent)
        };
        json!({
            "record": log.path.display().to_string(),
            "drive": log.drive,
            "role": role,
            "nmpe": log.score.nmpe,
            "fit_yaw_rate_percent": fit(Output::YawRate),
            "fit_sideslip_percent": fit(Output::Sideslip),
            "fit_left_acceleration_percent": fit(Output::Left),
        })
    });
    let document = json!({
        // A fit that has not converged is an error.
        "converged": true,
        "criterion": criterion.name(),
        "parameters": parameters.collect::<serde_json::Map<String, Value>>(),
        "logs": logs.collect::<Vec<_>>(),
        "not_validated": report.not_validated,
        "warnings": texts(warnings),
        "tyres": report.tyres.name(),
        "start": report.vehicle,
        "taken_as_exact": taken_as_exact(report).map(|(name, _)| name).collect::<Vec<_>>(),
        "vehicle": report.identified.identification.vehicle(),
        "identification": identified(&report.identified),
        "validation": report.validated.iter().map(identified).collect::<Vec<_>>(),
    });
    format!("{document:#}\n")
}

/// The values that the intervals assume to be exact: name, and value with unit.
pub(super) fn taken_as_exact(report: &Report) -> impl Iterator<Item = (&'static str, String)> {
    let vehicle = &report.vehicle;
    let given = [
        ("mass", None, format!("{} kg", vehicle.mass_kg)),
        (
            "l_f",
            Some(Parameter::FrontAxleDistance),
            format!("{} m", vehicle.front_axle_distance_m),
        ),
        (
            "friction",
            Some(Parameter::Friction),
            format!("{}", vehicle.friction),
        ),
        (
            "steering_gain",
            Some(Parameter::SteeringGain),
            "the servo's calibration".to_owned(),
        ),
    ];
    let identification = &report.identified.identification;
    given
        .into_iter()
        .filter(|(_, parameter, _)| {
            parameter.is_none_or(|parameter| identification.estimate(parameter).is_none())
        })
        .map(|(name, _, value)| (name, value))
}

fn identified(identified: &Identified) -> Value {
    let Identified {
        logs,
        identification,
    } = identified;
    let noise = &identification.noise;
    let estimates = identification.estimates.iter().map(|estimate| {
        json!({
            "parameter": estimate.parameter.name(),
            "unit": estimate.parameter.unit(),
            "value": estimate.value,
            "standard_deviation": estimate.standard_deviation,
            "interval_95": estimate.interval,
            "white_deviation": estimate.white_deviation,
            "robust_deviation": estimate.robust_deviation,
            "start": estimate.start,
            "at_bound": estimate.at_bound,
        })
    });
    let correlation = identification.correlation.row_iter();
    let correlation = correlation.map(|row| row.iter().copied().collect::<Vec<f64>>());
    let residuals = identification.residuals.iter().map(|residuals| {
        json!({
            "channel": residuals.channel.name(),
            "count": residuals.values.len(),
            "autocorrelation": residuals.autocorrelation,
        })
    });
    let [slowest, fastest] = speeds(identification);
    json!({
        "records": logs
            .iter()
            .map(|log| json!({ "record": log.path.display().to_string(), "drive": log.drive }))
            .collect::<Vec<_>>(),
        "seconds": identification.seconds(),
        "slowest_m_s": slowest,
        "fastest_m_s": fastest,
        "servo_frames": identification.frames.name(),
        "estimates": estimates.collect::<Vec<_>>(),
        "correlation": correlation.collect::<Vec<_>>(),
        // The simulation's fit does not estimate them.
        "noise": (identification.criterion == Criterion::Prediction).then(|| json!({
            "position_m": noise.position_m,
            "yaw_rad": noise.yaw_rad,
            "yaw_rate_rad_s": noise.yaw_rate_rad_s,
            "left_acceleration_m_s2": noise.left_m_s2,
            "forward_acceleration_m_s2_per_root_hz": noise.forward_density,
            "axle_force_n_per_root_hz": noise.force_density,
        })),
        "score": score(&identification.score),
        "residuals": residuals.collect::<Vec<_>>(),
        "warnings": texts(&identification.warnings),
    })
}

fn texts(warnings: &[Warning]) -> Vec<String> {
    warnings.iter().map(ToString::to_string).collect()
}

fn score(score: &Score) -> Value {
    let outputs = score.outputs.iter().map(|output| {
        json!({
            "output": output.output.name(),
            "nmpe": output.nmpe,
            "fit_percent": output.fit_percent,
            "rms": output.rms,
        })
    });
    json!({ "nmpe": score.nmpe, "outputs": outputs.collect::<Vec<_>>() })
}

/// The beginning of a vehicle file of this command.
pub(super) const VEHICLE_FILE_BEGINS: &str = "# Identified by singletrack ";

/// A vehicle file, which a daemon's configuration can use.
pub(super) fn vehicle_file(report: &Report) -> crate::Result<String> {
    let identification = &report.identified.identification;
    let vehicle = identification.vehicle();
    let logs = report.identified.logs.iter();
    let logs = logs.map(|log| {
        // A line break in the name must not end the comment.
        let path = log.path.display().to_string().replace(['\n', '\r'], " ");
        format!("{path}, drive {}", log.drive)
    });
    let mut text = format!(
        "{VEHICLE_FILE_BEGINS}from {}; {:.1} s; NMPE {:.4}.\n",
        logs.collect::<Vec<_>>().join("; "),
        identification.seconds(),
        identification.score.nmpe,
    );
    for estimate in &identification.estimates {
        let [low, high] = estimate.interval;
        text += &format!(
            "# {} = {} {}, 95 % between {low} and {high}\n",
            estimate.parameter.name(),
            estimate.value,
            estimate.parameter.unit(),
        );
    }
    Ok(text + "\n" + &vehicle_file::text(vehicle)?)
}

/// Lowest and highest speed of the data, in m/s.
pub(super) fn speeds(identification: &Identification) -> [f64; 2] {
    let speeds = identification.track.iter().map(TrackPoint::speed_m_s);
    speeds.fold([f64::INFINITY, 0.0], |[least, most], speed| {
        [least.min(speed), most.max(speed)]
    })
}

/// How a parameter is shown: its unit there, how many of them make one of its own, and
/// digits behind the point.
const fn shown(parameter: Parameter) -> (&'static str, f64, usize) {
    match parameter {
        Parameter::FrontStiffness | Parameter::RearStiffness => ("N/rad", 1.0, 3),
        Parameter::YawInertia => ("kg m²", 1.0, 6),
        Parameter::FrontAxleDistance => ("mm", 1e3, 2),
        Parameter::Friction | Parameter::SteeringGain | Parameter::GyroScale => ("", 1.0, 4),
        Parameter::ServoLag | Parameter::SteeringDelay | Parameter::InertialDelay => ("ms", 1e3, 3),
        Parameter::SteeringTrim => ("mrad", 1e3, 3),
        Parameter::LateralBias => ("mm/s²", 1e3, 1),
    }
}

pub(super) fn table(report: &Report) -> String {
    let mut text = String::new();
    // Writing to a string does not fail.
    let _ = write(&mut text, report);
    text
}

fn write(text: &mut String, report: &Report) -> std::fmt::Result {
    let Identified {
        logs,
        identification,
    } = &report.identified;
    let speeds = speeds(identification);
    for log in logs {
        writeln!(text, "{}, drive {}", log.path.display(), log.drive)?;
    }
    writeln!(
        text,
        "{:.1} s at {:.2} to {:.2} m/s; tyres {}; servo pulses from {} records; minimised: error of the {}",
        identification.seconds(),
        speeds[0],
        speeds[1],
        report.tyres.name(),
        match identification.frames {
            ServoFrames::Every => "all",
            frames => frames.name(),
        },
        identification.criterion.name(),
    )?;
    writeln!(
        text,
        "\n{:14}{:>12} {:6}{:>26}{:>9}{:>12}",
        "parameter", "estimate", "", "95 % interval", "±", "start"
    )?;
    for estimate in &identification.estimates {
        row(text, estimate)?;
    }
    let exact: Vec<String> = taken_as_exact(report)
        .map(|(name, value)| format!("{name} ({value})"))
        .collect();
    writeln!(text, "\nthe intervals take as exact: {}", exact.join(", "))?;
    writeln!(
        text,
        "with 1 % more mass c_f, c_r and i_z are 1 % more; the others can be estimated jointly \
         (--parameters)"
    )?;
    writeln!(text, "\ncorrelation")?;
    let names = identification.estimates.iter();
    let names = names.map(|estimate| estimate.parameter.name());
    write!(text, "{:14}", "")?;
    for name in names {
        write!(text, "{name:>13}")?;
    }
    writeln!(text)?;
    for (row, estimate) in identification.estimates.iter().enumerate() {
        write!(text, "{:14}", estimate.parameter.name())?;
        for column in 0..=row {
            write!(text, "{:>13.3}", identification.correlation[(row, column)])?;
        }
        writeln!(text)?;
    }
    if identification.criterion == Criterion::Prediction {
        let noise = &identification.noise;
        writeln!(
            text,
            "\nnoise: position {:.2} mm, yaw {:.2} mrad, gyro {:.2} mrad/s, acceleration {:.3} m/s², \
         unexplained force {:.2} mN/√Hz an axle",
            1e3 * noise.position_m,
            1e3 * noise.yaw_rad,
            1e3 * noise.yaw_rate_rad_s,
            noise.left_m_s2,
            1e3 * noise.force_density,
        )?;
    }
    writeln!(
        text,
        "\nthe model left alone with speed and servo pulses, beside what was measured:"
    )?;
    for (what, log) in report.logs() {
        writeln!(text, "{}, drive {}", log.path.display(), log.drive)?;
        score_line(text, what, &log.score)?;
    }
    writeln!(
        text,
        "NMPE: mean |model - measured| over the standard deviation of the measured, and the mean of that \
         over the outputs."
    )
}

fn row(text: &mut String, estimate: &Estimate) -> std::fmt::Result {
    let (unit, scale, digits) = shown(estimate.parameter);
    let [low, high] = estimate.interval.map(|end| scale * end);
    let relative = 100.0 * estimate.standard_deviation / estimate.value.abs();
    let part = if Parameter::NUISANCE.contains(&estimate.parameter) {
        String::new()
    } else {
        format!("{:.2} %", 1.96 * relative)
    };
    writeln!(
        text,
        "{:14}{:>12.digits$} {unit:6}{:>26}{part:>9}{:>12.digits$}",
        estimate.parameter.name(),
        scale * estimate.value,
        format!("{low:.digits$} to {high:.digits$}"),
        scale * estimate.start,
    )
}

fn score_line(text: &mut String, what: &str, score: &Score) -> std::fmt::Result {
    writeln!(text, "{what:15} NMPE {:.4}", score.nmpe)?;
    for output in score.outputs.iter().filter(|output| !output.rms.is_nan()) {
        writeln!(
            text,
            "  {:18} NMPE {:.4}  fit {:5.1} %  rms {:.5}",
            output.output.name(),
            output.nmpe,
            output.fit_percent,
            output.rms
        )?;
    }
    Ok(())
}
