//! The result of an identification: for the screen, and in files.

use std::path::PathBuf;

use serde_json::{Value, json};
use singletrack_analysis::identification::{
    Criterion, Identification, Output, Parameter, Score, TrackPoint, Tyres, Warning,
};
use singletrack_control::VehicleParameters;

use super::IdentifyError;
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
    /// Why there is no validation on the others.
    pub not_validated: Vec<IdentifyError>,
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
        "not_validated": report.not_validated.iter().map(ToString::to_string).collect::<Vec<_>>(),
        "warnings": texts(warnings),
        "tyres": report.tyres.name(),
        "start": report.vehicle,
        "taken_as_exact": taken_as_exact(report)
            .map(|(name, _)| name)
            .collect::<Vec<_>>(),
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
pub(super) fn vehicle_file(report: &Report) -> Result<String, toml::ser::Error> {
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
