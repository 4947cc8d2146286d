//! `[tuning]`: what an operator may change while the car drives, and what a request may ask for.

use singletrack_control::Velocity;
use singletrack_pilot::{Tuned, Tuning, TuningBounds};
use singletrack_settings::{Declared as _, section};

use super::{Config, ConfigError, OuterLoopSection};

section! {
    /// Live tuning: `singletrack tune` changes these values while the car drives, within these
    /// bounds. Both ends of the bounds must pass every check that the configured values pass.
    /// `docs/tuning.md` says how to tune a car.
    "tuning" => pub TuningSection: Copy;
    [default];

    /// Whether anything can be tuned.
    enabled: bool = false;
    /// Least and most of each of `outer_loop.gain_per_s`, which must lie between them; for the
    /// loop "proportional". Left out, gains can't be tuned.
    gain_per_s: Option<[f64; 2]> = None, in 0.0..=100.0, example [0.5, 4.0];
    /// Least and most of `law.point_distance_m`, which must lie between them; not with
    /// `governor.enabled`. Left out, p can't be tuned.
    point_distance_m: Option<[f64; 2]> = None, in up_to(10.0), example [0.3, 0.4];
}

const GAIN: &str = "tuning.gain_per_s";
const DISTANCE: &str = "tuning.point_distance_m";

/// A configuration with every tuned value at an end of its bounds.
pub(crate) struct Extreme {
    /// The key of bounds that reach there, and their value.
    pub(crate) key: &'static str,
    pub(crate) bounds: String,
    /// Where it is, in words.
    pub(crate) place: String,
    /// With these values, and nothing to tune.
    pub(crate) config: Config,
}

impl TuningSection {
    /// For the pilot; none if nothing can be tuned.
    pub(super) const fn bounds(&self) -> Option<TuningBounds> {
        if !self.enabled {
            return None;
        }
        Some(TuningBounds {
            gain: self.gain_per_s,
            point_distance: self.point_distance_m,
        })
    }

    /// Refuses bounds that are none, that do not hold the configured value, or at an end of which
    /// the configuration is refused.
    pub(super) fn validate(&self, config: &Config) -> Result<(), ConfigError> {
        self.check()?;
        if !self.enabled {
            return Ok(());
        }
        let refused = |key, bounds: [f64; 2], fix: String| {
            Err(ConfigError::value(key, format!("{bounds:?}"), fix))
        };
        for (key, bounds) in [(GAIN, self.gain_per_s), (DISTANCE, self.point_distance_m)] {
            if let Some([least, most]) = bounds.filter(|[least, most]| least > most) {
                return refused(key, [least, most], "give the lower bound first".to_owned());
            }
        }
        if let Some(bounds) = self.gain_per_s {
            match &config.outer_loop {
                OuterLoopSection::Proportional { gain_per_s, .. } => {
                    if let Some(gain) = gain_per_s.iter().find(|gain| !within(bounds, **gain)) {
                        let fix =
                            format!("outer_loop.gain_per_s has {gain}, which must lie between");
                        return refused(GAIN, bounds, fix);
                    }
                }
                other => {
                    let fix = format!("{}; leave it out", no_gains(other.kind()));
                    return refused(GAIN, bounds, fix);
                }
            }
        }
        if let Some(bounds) = self.point_distance_m {
            if config.governor.enabled {
                return refused(DISTANCE, bounds, format!("{GOVERNED}; leave it out"));
            }
            let distance = config.law.point_distance_m;
            if !within(bounds, distance) {
                let fix = format!("law.point_distance_m is {distance}, which must lie between");
                return refused(DISTANCE, bounds, fix);
            }
        }
        if self.gain_per_s.is_none() && self.point_distance_m.is_none() {
            let fix = "there are no bounds: give tuning.gain_per_s or tuning.point_distance_m";
            return Err(ConfigError::value("tuning.enabled", true, fix));
        }
        for extreme in config.extremes() {
            extreme.config.validate().map_err(|error| {
                let Extreme {
                    key, bounds, place, ..
                } = extreme;
                let fix = format!("with {place}: {error}; narrow the bounds");
                ConfigError::value(key, bounds, fix)
            })?;
        }
        Ok(())
    }
}

/// Why p is not tuned with a governor.
pub(super) const GOVERNED: &str =
    "governor.enabled is true, and the governor reckons ahead with one p";

/// Why the gains of another loop are not tuned.
pub(super) fn no_gains(kind: &str) -> String {
    match kind {
        "open-loop" | "own" => format!("outer_loop.kind is \"{kind}\", which has no such gains"),
        kind => format!(
            "outer_loop.kind is \"{kind}\", whose gains follow from its weights by a Riccati equation \
             that is solved before the drive: change the weights and reload"
        ),
    }
}

fn within([least, most]: [f64; 2], value: f64) -> bool {
    (least..=most).contains(&value)
}

impl Config {
    /// This configuration with another p (m) and other gains (1/s), where it has such.
    pub fn with_tuning(&self, gain: Option<Velocity>, point_distance: f64) -> Self {
        let mut config = self.clone();
        config.law.point_distance_m = point_distance;
        if let (OuterLoopSection::Proportional { gain_per_s, .. }, Some(gain)) =
            (&mut config.outer_loop, gain)
        {
            *gain_per_s = [gain.x, gain.y];
        }
        config
    }

    /// The corners of what can be tuned; none if nothing can.
    pub(crate) fn extremes(&self) -> Vec<Extreme> {
        let tuning = &self.tuning;
        if !tuning.enabled {
            return Vec::new();
        }
        let ends =
            |bounds: Option<[f64; 2]>| bounds.map_or(vec![None], |ends| ends.map(Some).to_vec());
        let mut extremes = Vec::new();
        for distance in ends(tuning.point_distance_m) {
            for gain in ends(tuning.gain_per_s) {
                let mut config = self.with_tuning(
                    gain.map(|gain| Velocity::new(gain, gain)),
                    distance.unwrap_or(self.law.point_distance_m),
                );
                config.tuning = TuningSection::default();
                let p = distance.map(|distance| format!("p at {distance} m"));
                let gains = gain.map(|gain| format!("gains of {gain}/s"));
                let place: Vec<String> = p.into_iter().chain(gains).collect();
                let (key, bounds) = match (tuning.point_distance_m, tuning.gain_per_s) {
                    (Some(bounds), _) => (DISTANCE, bounds),
                    (None, bounds) => (GAIN, bounds.unwrap_or_default()),
                };
                extremes.push(Extreme {
                    key,
                    bounds: format!("{bounds:?}"),
                    place: place.join(" and "),
                    config,
                });
            }
        }
        extremes
    }
}

/// The rule by which requests to tune are judged, from a configuration.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TuningRule {
    /// What may be tuned; none if nothing may.
    pub bounds: Option<TuningBounds>,
    /// The gains of the configuration, per second; none for a loop without such gains.
    pub gain: Option<Velocity>,
    /// The p of the configuration, in m.
    pub point_distance: f64,
    kind: &'static str,
    governed: bool,
}

/// Why a request to tune is refused.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("{0}")]
pub struct TuningError(String);

impl From<&str> for TuningError {
    fn from(text: &str) -> Self {
        Self(text.to_owned())
    }
}

impl Config {
    /// The rule for requests to tune.
    pub const fn tuning_rule(&self) -> TuningRule {
        TuningRule {
            bounds: self.tuning.bounds(),
            gain: match self.outer_loop {
                OuterLoopSection::Proportional {
                    gain_per_s: [x, y], ..
                } => Some(Velocity::new(x, y)),
                _ => None,
            },
            point_distance: self.law.point_distance_m,
            kind: self.outer_loop.kind(),
            governed: self.governor.enabled,
        }
    }
}

impl TuningRule {
    /// Whether the pilot may be given `tuning` while `in_force` is in force.
    ///
    /// # Errors
    ///
    /// Why not.
    pub fn check(&self, tuning: &Tuning, in_force: Option<&Tuned>) -> Result<(), TuningError> {
        let bounds = self.bounds.ok_or(
            "nothing can be tuned: set tuning.enabled = true, with bounds, in the configuration of \
             the daemon",
        )?;
        if let Some(gain) = tuning.gain {
            let reason = || match self.kind {
                "proportional" => "tuning.gain_per_s has no bounds in the configuration".to_owned(),
                kind => no_gains(kind),
            };
            for gain in [gain.x, gain.y] {
                bounded("gain_per_s", gain, bounds.gain, reason)?;
            }
        }
        if let Some(distance) = tuning.point_distance {
            let reason = || {
                if self.governed {
                    GOVERNED.to_owned()
                } else {
                    "tuning.point_distance_m has no bounds in the configuration".to_owned()
                }
            };
            bounded("point_distance_m", distance, bounds.point_distance, reason)?;
        }
        if *tuning == Tuning::default() {
            return Err(
                "there is nothing to tune: give gain_per_s, point_distance_m or both".into(),
            );
        }
        match in_force {
            Some(tuned) if tuned.has(tuning) => {
                Err("nothing changes: these values are in force already".into())
            }
            _ => Ok(()),
        }
    }

    /// Whether `tuned` differs from the configuration.
    pub fn differs(&self, tuned: &Tuned) -> bool {
        tuned.gain != self.gain
            || tuned.point_distance != self.point_distance
            || tuned.wanted_point_distance != self.point_distance
    }
}

fn bounded(
    name: &'static str,
    value: f64,
    bounds: Option<[f64; 2]>,
    reason: impl FnOnce() -> String,
) -> Result<(), TuningError> {
    let Some([least, most]) = bounds else {
        return Err(TuningError(format!("{name} can't be tuned: {}", reason())));
    };
    if within([least, most], value) {
        return Ok(());
    }
    Err(TuningError(format!(
        "{name} is {value}: it must lie between {least} and {most} (tuning.{name})"
    )))
}
