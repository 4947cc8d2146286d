//! What a drive says about the calibration, from the records of its ticks.

use serde_json::{Value as Json, json};
use singletrack_api::Correction;
use singletrack_control::{
    Calibration, CalibrationConfig, CalibrationEstimate, CalibrationParameter,
};
use singletrack_pilot::{Event, Learned, Mode};
use singletrack_record::TickRecord;
use toml::Value;

use crate::{
    Config, ConfigError,
    config::{OnlineCalibrationMode, WatchSection},
};

/// Interval at which a learner says what it has learned, in ticks.
const LEARNED_TICKS: u32 = 100;

/// Estimates what a drive says about the calibration.
#[derive(Clone, Debug)]
pub struct OnlineCalibration {
    /// The errors of the calibration, on the heap: they are too large for a thread's stack.
    pub errors: Box<Calibration>,
    /// None if the pilot does not learn.
    learner: Option<Learner>,
    watch: WatchSection,
    ticks: u32,
}

/// What the pilot is told.
#[derive(Clone, Debug, Default)]
struct Learner {
    /// The parameters that were off: what is not is left as configured.
    off: [bool; CalibrationParameter::ALL.len()],
    learned: Learned,
}

impl Learner {
    /// Takes over the estimates that are observable now.
    fn take(&mut self, estimates: &[CalibrationEstimate]) -> Learned {
        for (estimate, off) in estimates.iter().zip(&mut self.off) {
            *off |= estimate.is_off();
            if !*off || !estimate.observable {
                continue;
            }
            let learned = &mut self.learned;
            let correction = match estimate.parameter {
                CalibrationParameter::SteeringGain => &mut learned.steering_gain,
                CalibrationParameter::SteeringTrim => &mut learned.steering_trim,
                CalibrationParameter::StampOffset => &mut learned.stamp_offset,
                CalibrationParameter::BodyYaw => &mut learned.body_yaw,
                CalibrationParameter::PivotForward => &mut learned.pivot_forward,
                CalibrationParameter::PivotLeft => &mut learned.pivot_left,
                // The estimator follows the gyro itself, and the board measures the speed.
                CalibrationParameter::GyroScale | CalibrationParameter::PulseDistance => continue,
            };
            *correction = estimate.value;
        }
        self.learned
    }
}

impl OnlineCalibration {
    /// For this configuration; none if it is off.
    pub fn new(config: &Config) -> Option<Self> {
        let is_enabled = config.online_calibration.is_enabled();
        is_enabled.then(|| Self::of(config))
    }

    /// For this configuration, also if it is off.
    pub fn of(config: &Config) -> Self {
        Self {
            errors: Box::new(Calibration::new(CalibrationConfig {
                vehicle: config.vehicle,
                actuators: config.actuators.model(),
                marker_offset: config.motion_capture.marker_offset_m,
                marker_yaw: config.motion_capture.marker_yaw_rad,
                pulse_distance: f64::from(config.board.speed.pulse_distance_um) * 1e-6,
            })),
            learner: (config.online_calibration.mode == OnlineCalibrationMode::Live)
                .then(Learner::default),
            watch: config.watch,
            ticks: 0,
        }
    }

    /// Takes a tick. Once a second, gives what a pilot that learns is to be told; nothing in
    /// doubt.
    pub fn tick(&mut self, tick: &TickRecord) -> Option<Learned> {
        let now = tick.pilot_time;
        self.errors.begin_tick(now);
        for event in &tick.events {
            match event {
                // What the pilot does not believe is not learned from.
                Event::Pose(pose) if !tick.output.held => self.errors.pose(pose),
                Event::Board(board) => {
                    let inertial = board.inertial.filter(|it| self.watch.is_possible(it));
                    self.errors.board(board.time, inertial, board.motor_speed);
                }
                _ => {}
            }
        }
        let output = &tick.output;
        let drives = matches!(output.mode, Mode::Driving | Mode::Slowing | Mode::Stopping);
        let command = output.command.filter(|_| drives);
        self.errors
            .end_tick(now, command.map(|command| command.steering));
        self.ticks = self.ticks.wrapping_add(1);
        let learner = self.learner.as_mut()?;
        if !drives || !self.ticks.is_multiple_of(LEARNED_TICKS) || self.errors.doubts_steering() {
            return None;
        }
        Some(learner.take(&self.errors.estimates()))
    }
}

/// What is wrong with the calibration, and what to write.
pub fn advice(config: &Config, estimates: &[CalibrationEstimate]) -> singletrack_api::Calibration {
    let off = estimates.iter().filter(|estimate| estimate.is_off());
    singletrack_api::Calibration {
        advice: off.map(describe).collect(),
        corrections: corrections(config, estimates),
    }
}

/// Such as "steering gain is 4.1 +- 0.2 % less than configured".
fn describe(estimate: &CalibrationEstimate) -> String {
    let (name, unit, scale, digits) = units(estimate.parameter);
    let side = if estimate.value < 0.0 { "less" } else { "more" };
    let [off, half] = [estimate.value.abs(), estimate.half_width].map(|it| it * scale);
    format!("{name} is {off:.digits$} +- {half:.digits$} {unit} {side} than configured")
}

/// Such as "-4.1 +- 0.2 %": the true value less the configured one; "not observable" if the drive
/// does not show it.
pub fn deviation(estimate: &CalibrationEstimate) -> String {
    if !estimate.observable {
        return "not observable".to_owned();
    }
    let (_, unit, scale, digits) = units(estimate.parameter);
    let [value, half] = [estimate.value, estimate.half_width].map(|it| it * scale);
    format!("{value:+.digits$} +- {half:.digits$} {unit}")
}

/// Name and unit of a parameter for a person, the unit for one of its own, and digits.
pub const fn units(parameter: CalibrationParameter) -> (&'static str, &'static str, f64, usize) {
    use CalibrationParameter as Parameter;
    match parameter {
        Parameter::SteeringGain => ("the steering gain", "%", 1e2, 1),
        Parameter::SteeringTrim => ("the steering trim", "rad", 1.0, 4),
        Parameter::StampOffset => ("the stamp offset of the cameras", "ms", 1e3, 1),
        Parameter::GyroScale => ("the scale of the gyro", "%", 1e2, 1),
        Parameter::BodyYaw => ("the yaw of the rigid body", "rad", 1.0, 4),
        Parameter::PivotForward => ("the pivot of the rigid body, forward,", "mm", 1e3, 1),
        Parameter::PivotLeft => ("the pivot of the rigid body, to the left,", "mm", 1e3, 1),
        Parameter::PulseDistance => ("the distance for a motor pulse", "%", 1e2, 1),
    }
}

/// What has to be written for the estimates that are off. The scale of the gyro has no key, and a
/// steering table is measured by `singletrack calibrate`.
pub fn corrections(config: &Config, estimates: &[CalibrationEstimate]) -> Vec<Correction> {
    let off = |parameter| {
        estimates
            .iter()
            .find(|estimate| estimate.parameter == parameter && estimate.is_off())
            .map(|estimate| estimate.value)
    };
    let written = json!({
        "board": config.board,
        "limits": config.limits,
        "motion_capture": config.motion_capture,
    });
    let mut corrections = Vec::new();
    let mut correct = |key: &str, value: Json| {
        let configured = key.split('.').fold(&written, |at, name| &at[name]);
        // What is rounded to what it was is no correction.
        if *configured != value {
            corrections.push(Correction {
                configured: configured.clone(),
                key: key.to_owned(),
                value,
            });
        }
    };
    let gain = off(CalibrationParameter::SteeringGain);
    let trim = off(CalibrationParameter::SteeringTrim);
    if config.actuators.steering_table.is_none() && (gain.is_some() || trim.is_some()) {
        let servo = &config.board.servo;
        let gain_us_per_rad = f64::from(servo.gain_us_per_rad) / (1.0 + gain.unwrap_or(0.0));
        let centre_us = f64::from(servo.centre_us) - trim.unwrap_or(0.0) * gain_us_per_rad;
        let [gain_us_per_rad, centre_us] = [gain_us_per_rad, centre_us].map(f64::round);
        correct(
            "board.servo.gain_us_per_rad",
            (gain_us_per_rad as i64).into(),
        );
        correct("board.servo.centre_us", (centre_us as i64).into());
        let [most, least] = [servo.max_us, servo.min_us].map(f64::from);
        let reach = (most - centre_us).min(centre_us - least) / gain_us_per_rad.abs();
        if config.limits.max_steering_rad > reach {
            correct(
                "limits.max_steering_rad",
                ((1e3 * reach).floor() / 1e3).into(),
            );
        }
    }
    let cameras = &config.motion_capture;
    if let Some(late) = off(CalibrationParameter::StampOffset) {
        let value = rounded(cameras.timing.stamp_offset_ms + 1e3 * late, 1e2);
        correct("motion_capture.timing.stamp_offset_ms", value.into());
    }
    if let Some(yaw) = off(CalibrationParameter::BodyYaw) {
        let value = rounded(cameras.marker_yaw_rad + yaw, 1e5);
        correct("motion_capture.marker_yaw_rad", value.into());
    }
    let forward = off(CalibrationParameter::PivotForward);
    let left = off(CalibrationParameter::PivotLeft);
    if forward.is_some() || left.is_some() {
        let [x, y] = cameras.marker_offset_m;
        let moved = |configured, by: Option<f64>| rounded(configured + by.unwrap_or(0.0), 1e4);
        let value = vec![moved(x, forward), moved(y, left)];
        correct("motion_capture.marker_offset_m", value.into());
    }
    if let Some(more) = off(CalibrationParameter::PulseDistance) {
        let configured = f64::from(config.board.speed.pulse_distance_um);
        let value = (configured * (1.0 + more)).round() as i64;
        correct("board.speed.pulse_distance_um", value.into());
    }
    corrections
}

fn rounded(value: f64, per_one: f64) -> f64 {
    (value * per_one).round() / per_one
}

/// The configuration with these corrections.
///
/// # Errors
///
/// A value is not the one that was driven with; or a corrected one is out of range, or contradicts
/// another one.
pub fn corrected(config: &Config, corrections: &[Correction]) -> Result<Config, ConfigError> {
    let unwritten = |error: &dyn core::fmt::Display| {
        ConfigError::value("online_calibration", "corrections", error.to_string())
    };
    let mut written = Value::try_from(config).map_err(|error| unwritten(&error))?;
    for correction in corrections {
        let key = &correction.key;
        let [configured, value] = [&correction.configured, &correction.value].map(Value::try_from);
        let configured = configured.map_err(|error| unwritten(&error))?;
        let value = value.map_err(|error| unwritten(&error))?;
        let mut parts = key.split('.');
        match parts.try_fold(&mut written, |at, part| at.get_mut(part)) {
            Some(old) if *old == configured => *old = value,
            old => {
                let old = old.map_or_else(|| "absent".to_owned(), |old| old.to_string());
                let value = "another one than that of the drives";
                let fix = format!("{key} is {old}, and was {configured}; drive with it first");
                return Err(ConfigError::value("the configuration", value, fix));
            }
        }
    }
    let text = toml::to_string(&written).map_err(|error| unwritten(&error))?;
    Config::from_toml(&text)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn config() -> Config {
        Config::from_toml(include_str!("../../../daemon/singletrackd.example.toml")).unwrap()
    }

    fn found(values: &[(CalibrationParameter, f64)]) -> Vec<CalibrationEstimate> {
        let found = values
            .iter()
            .map(|&(parameter, value)| CalibrationEstimate {
                parameter,
                value,
                half_width: 0.002,
                observable: true,
            });
        found.collect()
    }

    #[test]
    fn advice_says_what_is_off_and_what_to_write() {
        let estimates = found(&[
            (CalibrationParameter::SteeringGain, -0.041),
            (CalibrationParameter::StampOffset, 0.001),
        ]);
        let found_off = advice(&config(), &estimates);
        assert_eq!(
            found_off.advice,
            ["the steering gain is 4.1 +- 0.2 % less than configured"]
        );
        assert_eq!(
            found_off.corrections,
            [Correction {
                configured: Json::from(-800),
                key: "board.servo.gain_us_per_rad".to_owned(),
                value: Json::from(-834),
            }]
        );
        let good = advice(&config(), &found(&[(CalibrationParameter::BodyYaw, 0.003)]));
        assert!(good.advice.is_empty() && good.corrections.is_empty());
    }

    #[test]
    fn corrections_are_those_of_the_configured_values() {
        let estimates = found(&[
            (CalibrationParameter::SteeringGain, -0.2),
            (CalibrationParameter::SteeringTrim, 0.05),
            (CalibrationParameter::StampOffset, 0.02),
            (CalibrationParameter::BodyYaw, 0.017_453),
            (CalibrationParameter::PivotLeft, -0.01),
            (CalibrationParameter::PulseDistance, 0.03),
            (CalibrationParameter::GyroScale, 0.03),
        ]);
        let corrections = corrections(&config(), &estimates);
        let config = corrected(&config(), &corrections).unwrap();
        // The wheels turn 0.05 rad at 1500 us, and a radian for 1000 us.
        assert_eq!(config.board.servo.gain_us_per_rad, -1_000);
        assert_eq!(config.board.servo.centre_us, 1_550);
        assert_eq!(config.limits.max_steering_rad, 0.37);
        assert_eq!(config.motion_capture.timing.stamp_offset_ms, 20.0);
        assert_eq!(config.motion_capture.marker_yaw_rad, 0.017_45);
        assert_eq!(config.motion_capture.marker_offset_m, [0.0, -0.01]);
        assert_eq!(config.board.speed.pulse_distance_um, 3_090);
        assert_eq!(corrections.len(), 7);
    }

    #[test]
    fn live_excludes_the_safety_filter() {
        let mut config = config();
        config.online_calibration.mode = OnlineCalibrationMode::Live;
        config.validate().unwrap();
        assert!(config.pilot().unwrap().learns);
        config.safety_filter.enabled = true;
        let error = config.validate().unwrap_err().to_string();
        assert!(
            error.contains("online_calibration.mode") && error.contains("\"advice\""),
            "{error}"
        );
    }

    #[test]
    fn only_what_is_off_is_learned_and_kept_while_nothing_is_observable() {
        let mut learner = Learner::default();
        let all = |value: f64, observable| {
            CalibrationParameter::ALL.map(|parameter| CalibrationEstimate {
                parameter,
                value: value * parameter.threshold(),
                half_width: 0.5 * parameter.threshold(),
                observable,
            })
        };
        assert_eq!(learner.take(&all(0.9, true)), Learned::default());
        assert_eq!(learner.take(&all(2.0, false)), Learned::default());
        let learned = learner.take(&all(-2.0, true));
        assert_eq!(learned.steering_gain, -0.04);
        assert_eq!(learned.pivot_left, -0.006);
        assert_eq!(learner.take(&all(5.0, false)), learned);
        // It goes on to follow what it has found.
        assert_eq!(learner.take(&all(0.5, true)).steering_gain, 0.01);
    }
}
