//! The certificate of the safety filter: the room that it leaves for every stop of a finite cover of
//! states. `docs/theorems.md` states what it proves, and `lab/certificates/check_filter.py` checks
//! it with other arithmetic.

use std::{collections::BTreeMap, fs, path::Path};

use serde::Serialize;
use serde_json::Value;
use singletrack_control::{ROOM_DIRECTIONS, SafetyConfig, SafetyFilter, StopBox};

use crate::{
    config::{Config, ConfigError, refuse_if, value_at},
    run::proof::Fnv,
};

/// Least and most, in millionths of an SI unit.
type Ends = [i64; 2];

/// States of a car that goes forward.
#[derive(Clone, Copy, Debug, Serialize)]
struct States {
    /// The largest of the estimated, measured and commanded speeds.
    speed_um_s: Ends,
    /// Time from a tick to when a stop slows down.
    delay_us: Ends,
    /// Deceleration of a stop.
    braking_um_s2: Ends,
    pose_age_us: Ends,
    /// Deviation of the curvature up to a lateral acceleration of a quarter of gravity.
    curvature_error_u_per_m: Ends,
    /// Angle to which the wheels are sent.
    steering_urad: Ends,
    /// The most by which commands that are still on their way differ from it.
    spread_urad: Ends,
}

/// The number of cells that each range of [`States`] is cut into.
const CELLS: [i64; 7] = [4, 1, 2, 2, 2, 3, 2];

impl States {
    fn axes(&mut self) -> [&mut Ends; 7] {
        [
            &mut self.speed_um_s,
            &mut self.delay_us,
            &mut self.braking_um_s2,
            &mut self.pose_age_us,
            &mut self.curvature_error_u_per_m,
            &mut self.steering_urad,
            &mut self.spread_urad,
        ]
    }

    /// A cover of these by boxes.
    fn boxes(self) -> Vec<Self> {
        let mut boxes = vec![self];
        for (axis, cells) in CELLS.into_iter().enumerate() {
            let parts = |whole: Self| {
                (0..cells).map(move |cell| {
                    let mut part = whole;
                    if let Some(ends) = part.axes().into_iter().nth(axis) {
                        let [least, most] = *ends;
                        let cut = |cell| least + (most - least) * cell / cells;
                        *ends = [cut(cell), cut(cell + 1)];
                    }
                    part
                })
            };
            boxes = boxes.into_iter().flat_map(parts).collect();
        }
        boxes
    }
}

/// A box of states, and how far from a side in each direction every one of them can stop.
#[derive(Debug, Serialize)]
struct Proved {
    #[serde(flatten)]
    states: States,
    room_um: [i64; ROOM_DIRECTIONS],
}

/// Errors that follow from the actuators: the assumed ones are no smaller.
#[derive(Clone, Copy, Debug, Serialize)]
struct Residuals {
    curvature_u_per_m: i64,
    course_urad: i64,
    speed_um_s: i64,
}

#[derive(Debug, Serialize)]
struct Certificate {
    settings: BTreeMap<&'static str, String>,
    digest: String,
    steering_ticks: usize,
    residuals: Residuals,
    ranges: States,
    boxes: Vec<Proved>,
}

/// The certificate of a configuration, as the text of its file.
///
/// # Errors
///
/// The filter is not enabled, or the car may go backward.
pub fn certificate(config: &Config) -> Result<String, ConfigError> {
    Ok(format!("{:#}\n", proved(config)?))
}

/// Why the car may not be armed by the file of `safety_filter.certificate`; `None` if it may, or needs
/// none. The file is not trusted: it has to be what [`certificate`] gives.
pub fn refusal(config: &Config) -> Option<String> {
    let path = config.safety_filter.certificate.as_deref()?;
    let own = match proved(config) {
        Ok(own) => own,
        Err(error) => return Some(error.to_string()),
    };
    let why = difference(path, &own)?;
    Some(format!(
        "safety_filter.certificate = {}: {why}; write it with `singletrack certify CONFIG.toml --out \
         {}`, and check it with lab/certificates/check_filter.py",
        path.display(),
        path.display(),
    ))
}

/// How a file differs from the certificate of the configuration in force; `None` if it is that.
fn difference(path: &Path, own: &Value) -> Option<String> {
    let text = match fs::read_to_string(path) {
        Ok(text) => text,
        Err(error) => return Some(format!("it can't be read ({error})")),
    };
    let given: Value = match serde_json::from_str(&text) {
        Ok(given) => given,
        Err(error) => return Some(format!("it is no JSON ({error})")),
    };
    if given == *own {
        return None;
    }
    let of = |value: &Value, key: &str| value["settings"][key].as_str().map(str::to_owned);
    let keys = own["settings"].as_object()?.keys();
    let other = keys.into_iter().find(|key| of(&given, key) != of(own, key));
    Some(match other {
        Some(key) => format!(
            "it is of another configuration: {key} is {} there, and {} here",
            of(&given, key).unwrap_or_else(|| "missing".to_owned()),
            of(own, key).unwrap_or_default(),
        ),
        None => "its figures are not those of this configuration".to_owned(),
    })
}

fn proved(config: &Config) -> Result<Value, ConfigError> {
    let is_off = !config.safety_filter.enabled;
    let fix = "a certificate is one of the safety filter; set it to true";
    refuse_if(is_off, "safety_filter.enabled", false, fix)?;
    let key = "limits.max_reverse_speed_m_s";
    let reverse = config.limits.max_reverse_speed_m_s;
    let fix = "a certificate is about stops of a car that goes forward; set it to 0, or leave \
               safety_filter.certificate out";
    refuse_if(reverse > 0.0, key, reverse, fix)?;
    let filter = config.safety_filter.config(config)?;
    let settings = settings(config)?;
    let own = config.residuals();
    let residuals = Residuals {
        curvature_u_per_m: figure(own.curvature),
        course_urad: figure(own.course),
        speed_um_s: figure(own.speed),
    };
    let ranges = ranges(config, residuals);
    let boxes = ranges.boxes().into_iter();
    let certificate = Certificate {
        digest: digest(&settings),
        settings,
        steering_ticks: filter.steering_ticks,
        residuals,
        ranges,
        boxes: boxes
            .map(|states| {
                let room = room(config, &filter, residuals, &ranges, &states)?;
                let room_um = room.map(figure);
                Ok(Proved { states, room_um })
            })
            .collect::<Result<_, ConfigError>>()?,
    };
    serde_json::to_value(certificate)
        .map_err(|error| ConfigError::value("safety_filter", "no JSON", error.to_string()))
}

/// A setting as a whole number of units of 10 to the power of minus `digits`, rounded up.
fn units(value: f64, digits: usize) -> i64 {
    let text = value.to_string();
    let (whole, rest) = text.split_once('.').unwrap_or((&text, ""));
    let (kept, beyond) = rest.split_at(rest.len().min(digits));
    let units: i64 = format!("{whole}{kept:0<digits$}")
        .parse()
        .unwrap_or(i64::MAX);
    units.saturating_add(i64::from(!beyond.is_empty()))
}

/// A setting in millionths, rounded up.
fn micro(value: f64) -> i64 {
    units(value, 6)
}

/// What is computed in millionths, rounded up by more than its own rounding.
fn figure(value: f64) -> i64 {
    (value * 1e6 + 1e-6).floor() as i64 + 1
}

fn ranges(config: &Config, residuals: Residuals) -> States {
    let filter = &config.safety_filter;
    let braking = micro(config.fence.braking_m_s2);
    let steering = micro(config.limits.max_steering_rad);
    let curvature_error = micro(filter.curvature_error_per_m).max(residuals.curvature_u_per_m);
    States {
        speed_um_s: [0, micro(config.limits.max_speed_m_s)],
        delay_us: [0, units(filter.reaction_ms(config), 3)],
        // What a stop measures counts if it is less: down to half.
        braking_um_s2: [braking / 2, braking],
        pose_age_us: [0, 1_000 * i64::from(config.supervisor.hold_ms)],
        curvature_error_u_per_m: [0, curvature_error],
        steering_urad: [-steering, steering],
        spread_urad: [0, 2 * steering],
    }
}

/// The room of a box's worst state, m.
fn room(
    config: &Config,
    filter: &SafetyConfig,
    residuals: Residuals,
    ranges: &States,
    states: &States,
) -> Result<[f64; ROOM_DIRECTIONS], ConfigError> {
    let unit = |millionths: i64| millionths as f64 / 1e6;
    let section = &config.safety_filter;
    let speed_error = micro(section.speed_error_m_s).max(residuals.speed_um_s);
    let course_error = micro(section.course_error_rad).max(residuals.course_urad);
    let speed = unit(states.speed_um_s[1] + speed_error);
    let [[least, most], sent] = [ranges.steering_urad, states.steering_urad];
    let spread = states.spread_urad[1];
    let before = [(sent[0] - spread).max(least), (sent[1] + spread).min(most)];
    let filter = SafetyFilter::new(SafetyConfig {
        reaction: unit(states.delay_us[1]),
        curvature_error: unit(states.curvature_error_u_per_m[1]),
        course_error: unit(course_error),
        ..filter.clone()
    })
    .map_err(|error| ConfigError::value("safety_filter", error.name, error.to_string()))?;
    let blind = speed * unit(states.pose_age_us[1]);
    Ok(filter.room(&StopBox {
        speed,
        blind: blind.min(config.supervisor.hold_distance_m),
        braking: unit(states.braking_um_s2[0]),
        period: 1e-3 * f64::from(config.control.period_ms),
        rear_axle_distance: config.vehicle.wheelbase_m() - config.law.front_axle_distance_m,
        before: before.map(unit),
        sent: sent.map(unit),
    }))
}

/// The keys that the certificate rests on, but for `safety_filter.reaction_ms`, which may be left out.
const SETTINGS: [&str; 18] = [
    "actuators.speed_dead_time_ms",
    "actuators.steering_dead_time_ms",
    "actuators.steering_lag_ms",
    "control.period_ms",
    "fence.braking_m_s2",
    "law.front_axle_distance_m",
    "limits.max_speed_m_s",
    "limits.max_steering_rad",
    "safety_filter.course_error_rad",
    "safety_filter.curvature_error_per_m",
    "safety_filter.curvature_error_per_m_per_m_s2",
    "safety_filter.position_error_m",
    "safety_filter.speed_error_m_s",
    "supervisor.hold_distance_m",
    "supervisor.hold_ms",
    "vehicle.friction",
    "vehicle.front_axle_distance_m",
    "vehicle.rear_axle_distance_m",
];

/// What the certificate rests on, as decimals.
fn settings(config: &Config) -> Result<BTreeMap<&'static str, String>, ConfigError> {
    let written = toml::Value::try_from(config)
        .map_err(|error| ConfigError::value("safety_filter", "no TOML", error.to_string()))?;
    let decimal = |key| {
        let value = value_at(&written, key)?;
        let whole = value.as_integer().map(|number| number.to_string());
        whole.or_else(|| Some(value.as_float()?.to_string()))
    };
    let reaction_ms = config.safety_filter.reaction_ms(config).to_string();
    let settings = SETTINGS.into_iter().map(|key| match decimal(key) {
        Some(value) => Ok((key, value)),
        None => Err(ConfigError::value(key, "no number", "it must be one")),
    });
    settings
        .chain([Ok(("safety_filter.reaction_ms", reaction_ms))])
        .collect()
}

/// The hash of the settings as lines `key=value`.
fn digest(settings: &BTreeMap<&'static str, String>) -> String {
    let lines = settings
        .iter()
        .map(|(key, value)| format!("{key}={value}\n"));
    let mut hash = Fnv::default();
    hash.add(lines.collect::<String>().as_bytes());
    format!("{:016x}", hash.0)
}
