//! `[law]`: which law linearises the car.

use serde::{Deserialize, Serialize};
use singletrack_control::{FrontPointLaw, LawError, VehicleParameters, VelocityPointLaw};

/// Which law, and what it believes.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LawSection {
    /// Which law.
    pub kind: LawKind,
    /// Distance p of the point P, in m.
    pub point_distance_m: f64,
    /// The estimate of `l_f` that law and point-P transform use, in m.
    pub front_axle_distance_m: f64,
}

/// The two laws of the paper.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum LawKind {
    /// The proposed law.
    FrontPoint,
    /// The appendix's law.
    VelocityPoint,
}

impl LawSection {
    /// The proposed law with these values.
    ///
    /// # Errors
    ///
    /// Values that make no sense for the vehicle.
    pub fn front_point_law(&self, vehicle: &VehicleParameters) -> Result<FrontPointLaw, LawError> {
        FrontPointLaw::new(
            self.front_axle_distance_m,
            self.point_distance_m,
            vehicle.wheelbase_m(),
        )
    }

    /// The appendix's law with these values.
    ///
    /// # Errors
    ///
    /// Values that make no sense for the vehicle.
    pub fn velocity_point_law(
        &self,
        vehicle: &VehicleParameters,
    ) -> Result<VelocityPointLaw, LawError> {
        VelocityPointLaw::new(
            vehicle.with_centre_of_mass_at(self.front_axle_distance_m),
            self.point_distance_m,
        )
    }

    /// Refuses values that make no sense for the vehicle.
    ///
    /// # Errors
    ///
    /// The first of them.
    pub fn validate(&self, vehicle: &VehicleParameters) -> Result<(), LawError> {
        match self.kind {
            LawKind::FrontPoint => self.front_point_law(vehicle).map(drop),
            LawKind::VelocityPoint => self.velocity_point_law(vehicle).map(drop),
        }
    }
}
