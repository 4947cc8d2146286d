//! What is said of a log in the end.

use serde::Serialize;
use singletrack_control::{EstimatorConfig, PoseVerdict};

use super::{
    log::Log,
    run::{Run, Stop},
    score::{self, Errors, Noise},
    truth::{self, Kind, Seen},
};

/// What the pilot would have said of a drive, and how its estimate compares with the cameras.
#[derive(Clone, Debug, Serialize)]
pub struct Verdict {
    /// From the first tick to the last.
    pub duration_s: f64,
    /// Poses of the cameras.
    pub poses: usize,
    /// Poses of the car that the gate of the cameras or the estimator refused.
    pub rejected: usize,
    /// Times at which the estimate followed another body.
    pub adopted_ghosts: usize,
    /// Stretches of poses of another body: beginning and end.
    pub ghosts_s: Vec<[f64; 2]>,
    /// Poses of the car that were turned for a moment.
    pub flips_s: Vec<f64>,
    /// When a person would have been asked whether the body is the car.
    pub asked_s: Vec<f64>,
    /// Mean of the normalised innovation squared of every pose of the car after the estimate has
    /// settled, before any weighting, rejected poses included; 3 is right.
    pub nis_mean: Option<f64>,
    /// What would have ended a drive.
    pub stops: Vec<Stop>,
    /// The largest estimated speed after the estimate has settled.
    pub speed_max_m_s: f64,
    /// Root mean square of estimated minus smoothed speed, above 0.5 m/s.
    pub speed_rms_m_s: Option<f64>,
    /// The same of the yaw rate.
    pub yaw_rate_rms_rad_s: Option<f64>,
    /// The same of the sideslip.
    pub sideslip_rms_rad: Option<f64>,
    /// Root mean square of the sideslip itself.
    pub true_sideslip_rms_rad: Option<f64>,
    /// The share of sideslips inside their stated 95 %.
    pub sideslip_within_95: Option<f64>,
    /// The gyro's scale in the end.
    pub gyro_scale: f64,
    /// Of every sensor.
    pub noise: Vec<Noise>,
    /// What could not be judged, for want of an input.
    pub not_judged: Vec<&'static str>,
}

impl Verdict {
    pub(super) fn of(log: &Log, run: &Run, config: &EstimatorConfig) -> Self {
        let begin = log.ticks.first().map(|tick| tick.time).unwrap_or_default();
        let at = |seen: &Seen| seen.time.seconds_since(begin);
        let poses = run.poses.iter();
        let of_car = poses.filter(|judged| score::counts(judged.seen.kind));
        let rejected = of_car
            .clone()
            .filter(|judged| judged.gated || judged.verdict == Some(PoseVerdict::Implausible));
        let settled = of_car.filter(|judged| judged.settled);
        let innovations: Vec<f64> = settled.filter_map(|judged| judged.innovation).collect();
        let ghosts = truth::ghosts_of(run.poses.iter().map(|judged| judged.seen));
        let mut adopted = 0;
        let mut was_adopted = false;
        for judged in &run.poses {
            let is_ghost = judged.seen.kind == Kind::Ghost;
            let is_adopted = is_ghost && judged.verdict == Some(PoseVerdict::Accepted);
            adopted += usize::from(is_adopted && !was_adopted);
            was_adopted = is_adopted;
        }
        let errors = Errors::of(&run.compared);
        let seen: Vec<Seen> = run.poses.iter().map(|judged| judged.seen).collect();
        let flips = seen.iter().filter(|seen| seen.kind == Kind::Flip);
        Self {
            duration_s: log.duration(),
            poses: run.poses.len(),
            rejected: rejected.count(),
            adopted_ghosts: adopted,
            ghosts_s: ghosts
                .iter()
                .map(|ghost| ghost.map(|time| time.seconds_since(begin)))
                .collect(),
            flips_s: flips.map(at).collect(),
            asked_s: run.asked.clone(),
            nis_mean: (!innovations.is_empty())
                .then(|| innovations.iter().sum::<f64>() / innovations.len() as f64),
            stops: run.stops.clone(),
            speed_max_m_s: run.speed_max,
            speed_rms_m_s: errors.speed.value(),
            yaw_rate_rms_rad_s: errors.yaw_rate.value(),
            sideslip_rms_rad: errors.sideslip.value(),
            true_sideslip_rms_rad: errors.true_sideslip.value(),
            sideslip_within_95: errors.within_95(),
            gyro_scale: run.gyro_scale,
            noise: score::noise(&seen, &run.samples, config),
            not_judged: not_judged(log),
        }
    }
}

fn not_judged(log: &Log) -> Vec<&'static str> {
    let mut missing = vec!["arming", "the proving run", "the end of a stop", "the law"];
    if !log.has_speed {
        missing.push("the commanded speed");
    }
    if !log.has_health {
        missing.push("battery, stop switch and real time");
    }
    if !log.has_attitude {
        missing.push("tilt, height and the cameras' clock");
    }
    missing
}
