//! How drives of a comparison end, the own point of a law, and why a comparison fails.

use std::collections::BTreeMap;

use singletrack_control::{LawError, VehicleParameters};
use singletrack_core::ConfigError;
use singletrack_scenario::virtual_drive::VirtualDriveError;

/// Why a drive can't be simulated.
#[derive(Debug, thiserror::Error)]
pub enum DriveError {
    /// The reference is refused.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// The host or the world is refused.
    #[error(transparent)]
    Drive(#[from] VirtualDriveError),
    /// The law of the appendix has no limits and no start from standstill.
    #[error("the law of the appendix drives the ideal plant only; choose condition ideal-plant")]
    IdealPlantOnly,
    /// A program's own controller is driven by that program.
    #[error("a controller of your own is compared by the Python package")]
    Yours,
    /// A law is refused.
    #[error(transparent)]
    Law(#[from] LawError),
}

/// The point whose errors are the controller's own.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum OwnPoint {
    /// P, in front of the front axle.
    P,
    /// The front axle.
    FrontAxle,
    /// The rear axle.
    RearAxle,
    /// P of the appendix: ahead of G along its velocity.
    VelocityPoint,
}

impl OwnPoint {
    /// How far it is ahead of G on a straight line, in m.
    pub(super) fn reach(self, vehicle: &VehicleParameters) -> f64 {
        match self {
            Self::P => vehicle.front_axle_distance_m + POINT_DISTANCE_M,
            Self::FrontAxle => vehicle.front_axle_distance_m,
            Self::RearAxle => -vehicle.rear_axle_distance_m,
            Self::VelocityPoint => POINT_DISTANCE_M,
        }
    }
}

/// The distance of P from the front axle, in m.
pub(super) const POINT_DISTANCE_M: f64 = 0.35;

/// Reasons with the number of drives of each, the commonest first.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(super) struct StopReasons(Vec<(String, usize)>);

impl StopReasons {
    /// Counts reasons. What stands behind a colon is about one drive alone.
    pub(super) fn of<'a>(reasons: impl Iterator<Item = &'a str>) -> Self {
        let mut counts = BTreeMap::<&str, usize>::new();
        for reason in reasons {
            let kind = reason.split_once(':').map_or(reason, |(kind, _)| kind);
            *counts.entry(kind).or_default() += 1;
        }
        let counts = counts.into_iter();
        let mut counts: Vec<_> = counts
            .map(|(kind, count)| (kind.to_owned(), count))
            .collect();
        // Equal ones stay in the order of their names.
        counts.sort_by_key(|(_, count)| core::cmp::Reverse(*count));
        Self(counts)
    }

    /// Empty without a stop.
    pub(super) fn commonest(&self) -> &str {
        self.0.first().map_or("", |(kind, _)| kind)
    }

    /// Each with its number, between them `separator`.
    pub(super) fn joined(&self, separator: &str) -> String {
        let reasons = self.0.iter().map(|(kind, count)| format!("{kind} {count}"));
        reasons.collect::<Vec<_>>().join(separator)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_commonest_is_first_and_equal_ones_are_in_the_order_of_their_names() {
        let reasons = ["geofence", "refused: a, b", "diverged", "refused: c"];
        let reasons = StopReasons::of(reasons.into_iter());
        assert_eq!(reasons.commonest(), "refused");
        assert_eq!(reasons.joined(";"), "refused 2;diverged 1;geofence 1");
        assert_eq!(StopReasons::default().commonest(), "");
    }
}
