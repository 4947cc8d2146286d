//! `[neighbours]`: other rigid bodies as obstacles.

use singletrack_control::NeighbourConfig;
use singletrack_settings::section;

use super::{Config, ConfigError};

section! {
    /// Keeps the car apart from every other rigid body that the cameras list: other cars, a wand on
    /// the floor, a person's cap. Where one may be when the car has stopped, the car slows down or
    /// waits (with `[safety_filter]`), and stops (always). `docs/neighbours.md` states what that
    /// rests on.
    "neighbours" => pub NeighboursSection;
    [default];

    /// Whether it does.
    @restart enabled: bool = false;
    /// Distance from the centre of mass to the body's origin within which they may touch. The
    /// default is the length of the car, and 0.1 m.
    clearance_m: Option<f64> = None, in 0.05..=5.0, example 0.5;
    /// The largest speed of another body.
    max_speed_m_s: f64 = 2.0, in up_to(20.0);
    /// The largest acceleration of another body.
    acceleration_m_s2: f64 = 2.0, in up_to(50.0);
    /// The deceleration with which another car stops. The default is `fence.braking_m_s2`.
    braking_m_s2: Option<f64> = None, in up_to(50.0), example 0.9;
    /// Time from a pose of another car until it brakes. The default is that of this car: as
    /// `safety_filter.reaction_ms`, and two periods.
    reaction_ms: Option<f64> = None, in 0.0..=2_000.0, example 216.0;
    /// How long the car waits for a body in its way before the drive ends.
    patience_s: f64 = 10.0, in 0.0..=3_600.0;
    /// The other cars, by the names of their rigid bodies; without one of them the car does not
    /// drive. It needs the safety filter. Each must have this section too, with this car in the
    /// list: of two, the one with the lower streaming id has the right of way.
    @restart expected: Vec<String> = Vec::new();
    /// Rigid bodies that are no obstacles, by their names.
    @restart ignored: Vec<String> = Vec::new();
}

impl NeighboursSection {
    /// For the controller of this car; none if it is not enabled.
    ///
    /// # Errors
    ///
    /// A body is both expected and ignored, or is the car's own; or others are expected without the
    /// safety filter.
    pub(super) fn config(&self, config: &Config) -> Result<Option<NeighbourConfig>, ConfigError> {
        let own = &config.motion_capture.rigid_body;
        for name in &self.expected {
            let fix = match self.ignored.contains(name) {
                true => "it is in neighbours.ignored too: remove it from one of them",
                false if name == own => "it is this car's own body: remove it",
                false => continue,
            };
            return Err(ConfigError::value(
                "neighbours.expected",
                format!("{name:?}"),
                fix,
            ));
        }
        if !self.enabled {
            return Ok(None);
        }
        // The car that has the right of way relies on the filter of the other one.
        if !self.expected.is_empty() && !config.safety_filter.enabled {
            return Err(ConfigError::value(
                "neighbours.expected",
                format!("{:?}", self.expected),
                "these cars rely on this one to wait for them: set safety_filter.enabled = true, or \
                 empty the list",
            ));
        }
        let reaction_ms = self.reaction_ms.unwrap_or_else(|| {
            config.safety_filter.reaction_ms(config) + 2.0 * f64::from(config.control.period_ms)
        });
        Ok(Some(NeighbourConfig {
            clearance: self
                .clearance_m
                .unwrap_or_else(|| config.vehicle.body_length_m() + 0.1),
            max_speed: self.max_speed_m_s,
            acceleration: self.acceleration_m_s2,
            braking: self.braking_m_s2.unwrap_or(config.fence.braking_m_s2),
            reaction: 1e-3 * reaction_ms,
            patience: self.patience_s,
        }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn refused(expected: &str, more: &str) -> String {
        let example = include_str!("../../../daemon/singletrackd.example.toml");
        let mut file: toml::Table = toml::from_str(example).unwrap();
        let text = format!("enabled = true\nexpected = {expected}\n{more}");
        file.insert(
            "neighbours".to_owned(),
            toml::from_str::<toml::Table>(&text).unwrap().into(),
        );
        let result = Config::from_toml(&toml::to_string(&file).unwrap());
        result.map_or_else(|error| error.to_string(), |_| String::new())
    }

    #[test]
    fn cars_that_can_not_be_kept_apart_from_are_refused_with_what_to_change() {
        for (expected, more, fix) in [
            ("[\"car2\"]", "", "safety_filter.enabled = true"),
            ("[\"car\"]", "", "this car's own body"),
            (
                "[\"car2\"]",
                "ignored = [\"car2\"]",
                "neighbours.ignored too",
            ),
        ] {
            let error = refused(expected, more);
            assert!(
                error.contains("neighbours.expected") && error.contains(fix),
                "{error}"
            );
        }
        assert_eq!(refused("[]", ""), "");
    }
}
