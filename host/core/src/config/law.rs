//! `[law]`: which law linearises the car.

use singletrack_control::{FrontPointLaw, LawError, VehicleParameters, VelocityPointLaw};
use singletrack_settings::section;
use singletrack_words::words;

section! {
    /// The linearising law.
    "law" => pub LawSection: Copy;
    [];

    /// The law: "front-point" is the paper's proposal; "velocity-point" exists in
    /// simulations only.
    kind: LawKind, words LawKind, example LawKind::FrontPoint;
    /// Distance p of the point P, which follows the reference, beyond the front axle. The servo
    /// bounds it from below, the more the faster the car: see `singletrack stability least-p`.
    point_distance_m: f64, text "above 0", example 0.35;
    /// Distance `l_f` of the front axle from the centre of mass, as measured; law and
    /// transform of P use it. The law needs only the distance of the front axle from the
    /// rigid body's pivot. Set this key and `marker_offset_m` so that their difference,
    /// forward, is the distance that you measured.
    front_axle_distance_m: f64, text "above 0, below the wheelbase", example 0.1368;
}

words! {
    /// The two laws of the paper.
    pub enum LawKind: serde {
        /// The proposed law.
        FrontPoint = "front-point",
        /// The law of the appendix.
        VelocityPoint = "velocity-point",
    }
}

impl LawSection {
    /// The proposed law with these values.
    ///
    /// # Errors
    ///
    /// Values that are invalid for the vehicle.
    pub fn front_point_law(&self, vehicle: &VehicleParameters) -> Result<FrontPointLaw, LawError> {
        FrontPointLaw::new(
            self.front_axle_distance_m,
            self.point_distance_m,
            vehicle.wheelbase_m(),
        )
    }

    /// The law of the appendix with these values.
    ///
    /// # Errors
    ///
    /// Values that are invalid for the vehicle.
    pub fn velocity_point_law(
        &self,
        vehicle: &VehicleParameters,
    ) -> Result<VelocityPointLaw, LawError> {
        VelocityPointLaw::new(
            vehicle.with_centre_of_mass_at(self.front_axle_distance_m),
            self.point_distance_m,
        )
    }

    /// Refuses values that are invalid for the vehicle.
    ///
    /// # Errors
    ///
    /// The first invalid value.
    pub fn validate(&self, vehicle: &VehicleParameters) -> Result<(), LawError> {
        match self.kind {
            LawKind::FrontPoint => self.front_point_law(vehicle).map(drop),
            LawKind::VelocityPoint => self.velocity_point_law(vehicle).map(drop),
        }
    }
}
