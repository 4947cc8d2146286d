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
    /// drive. Each must have this section too, with this car in the list: of two, the one with the
    /// lower streaming id has the right of way.
    @restart expected: Vec<String> = Vec::new();
    /// Rigid bodies that are no obstacles, by their names.
    @restart ignored: Vec<String> = Vec::new();
}

impl NeighboursSection {
    /// For the controller of this car; none if it is not enabled.
    ///
    /// # Errors
    ///
    /// A body is both expected and ignored, or is the car's own.
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
