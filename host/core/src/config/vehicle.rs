//! `[vehicle]`: the parameters of the car.
//!
//! [`VehicleParameters`] is read as it is; the section declared here describes it.

use singletrack_control::VehicleParameters;
use singletrack_settings::section;

section! {
    /// The car: the 1:10 car of the paper unless given. All of these keys or none.
    "vehicle" => pub(super) VehicleKeys;
    [maps VehicleParameters = VehicleParameters::paper()];

    /// Mass.
    mass_kg: f64 => mass_kg, text "above 0";
    /// Yaw moment of inertia about the centre of mass.
    yaw_inertia_kg_m2: f64 => yaw_inertia_kg_m2, text "above 0";
    /// Distance of the front axle from the centre of mass.
    front_axle_distance_m: f64 => front_axle_distance_m, text "above 0";
    /// Distance of the rear axle from the centre of mass.
    rear_axle_distance_m: f64 => rear_axle_distance_m, text "above 0";
    /// Friction coefficient between tyre and ground.
    friction: f64 => friction, text "above 0";
    /// Cornering stiffness of the front axle.
    front_cornering_stiffness_n_rad: f64 => front_cornering_stiffness_n_rad, text "above 0";
    /// Cornering stiffness of the rear axle.
    rear_cornering_stiffness_n_rad: f64 => rear_cornering_stiffness_n_rad, text "above 0";
}
