//! `[governor]`: makes the reference slower or wider where the car can't follow it.

use singletrack_control::{FrontPointLaw, GovernorConfig, Limits, Room};
use singletrack_settings::section;

use super::{Config, ConfigError};

section! {
    /// Makes the reference slower or wider where the car can't follow it, by the limits of
    /// `[limits]`, and slower where P is far behind or the car could not stop inside the geofence,
    /// which must be convex. A reference that the car can follow is not changed.
    "governor" => pub GovernorSection: Copy;
    [default];

    /// Whether the reference may be changed so. Set-points from outside and velocity steps never
    /// are.
    enabled: bool = false;
    /// Distance of P behind its reference from which on the reference slows down. At twice the
    /// distance it waits.
    behind_m: f64 = 0.5, in 0.05..=10.0;
}

/// The time before a stop begins, s: the reaction of the geofence's watch, the age of a pose, and
/// the lag of the car behind its reference.
const REACTION_S: f64 = 0.2;

impl GovernorSection {
    /// For the controller of this car; none if it is not enabled.
    ///
    /// # Errors
    ///
    /// The geofence is not convex, or nothing is left of it.
    pub(super) fn config(
        &self,
        config: &Config,
        law: FrontPointLaw,
        limits: Limits,
    ) -> Result<Option<GovernorConfig>, ConfigError> {
        if !self.enabled {
            return Ok(None);
        }
        let area = config.fence.convex(&config.vehicle, "governor")?;
        let braking = config.fence.braking_m_s2;
        let room = Room::new(&area, braking, REACTION_S).ok_or_else(|| {
            ConfigError::value(
                "fence.margin_m",
                config.fence.margin_m(&config.vehicle),
                "the governor keeps 5 cm more, and nothing is left; lower it, give a larger \
                 fence.corners_m, or set governor.enabled = false",
            )
        })?;
        Ok(Some(GovernorConfig {
            law,
            limits,
            behind: self.behind_m,
            room: Some(room),
        }))
    }
}
