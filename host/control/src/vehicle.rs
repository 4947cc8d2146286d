//! The parameters of the car.

use serde::{Deserialize, Serialize};

/// Standard gravity, in m/s².
pub const GRAVITY: f64 = 9.806_65;

/// The parameters of the single-track model, in SI units.
///
/// Their type `P` is `f64`, or a dual number for derivatives by the parameters.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct VehicleParameters<P = f64> {
    /// Mass m, in kg.
    pub mass_kg: P,
    /// Yaw moment of inertia `I_z` about the centre of mass, in kg m².
    pub yaw_inertia_kg_m2: P,
    /// Distance `l_f` from the centre of mass G to the front axle, in m.
    pub front_axle_distance_m: P,
    /// Distance `l_r` from the centre of mass G to the rear axle, in m.
    pub rear_axle_distance_m: P,
    /// Friction coefficient μ between tyre and ground.
    pub friction: P,
    /// Cornering stiffness `C_f` of the front axle, in N/rad.
    pub front_cornering_stiffness_n_rad: P,
    /// Cornering stiffness `C_r` of the rear axle, in N/rad.
    pub rear_cornering_stiffness_n_rad: P,
}

/// Length of a 1:10 car per wheelbase: the paper's is 0.4 m long.
const LENGTH_PER_WHEELBASE: f64 = 0.4 / 0.26;
/// Width of a 1:10 car per length: 0.19 m of 0.4 m.
const WIDTH_PER_LENGTH: f64 = 0.19 / 0.4;

/// A vehicle parameter that is not finite or not positive.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[error("vehicle parameter {name} is {value}: it must be finite and above zero")]
#[non_exhaustive]
pub struct VehicleParameterError {
    /// The parameter's name.
    pub name: &'static str,
    /// Its value.
    pub value: f64,
}

impl<P: Copy> VehicleParameters<P> {
    /// The paper's symbols for them, without friction: `m`, `I_z`, `l_f`, `l_r`, `C_f` and `C_r`.
    pub const fn symbols(&self) -> [P; 6] {
        [
            self.mass_kg,
            self.yaw_inertia_kg_m2,
            self.front_axle_distance_m,
            self.rear_axle_distance_m,
            self.front_cornering_stiffness_n_rad,
            self.rear_cornering_stiffness_n_rad,
        ]
    }
}

impl VehicleParameters {
    /// The 1:10 car of the paper (table "Experimental Platform Data").
    pub const fn paper() -> Self {
        Self {
            mass_kg: 1.9,
            yaw_inertia_kg_m2: 0.0251,
            front_axle_distance_m: 0.1368,
            rear_axle_distance_m: 0.1232,
            friction: 0.25,
            front_cornering_stiffness_n_rad: 58.085,
            rear_cornering_stiffness_n_rad: 130.805,
        }
    }

    /// Distance between the axles, `l_f + l_r`, in m.
    pub const fn wheelbase_m(&self) -> f64 {
        self.front_axle_distance_m + self.rear_axle_distance_m
    }

    /// Length of the body, in m, if it has the paper's car's for its wheelbase.
    pub const fn body_length_m(&self) -> f64 {
        LENGTH_PER_WHEELBASE * self.wheelbase_m()
    }

    /// Width of the body, in m, if it has the usual one of a 1:10 car of this length. It is for
    /// drawings only.
    pub const fn body_width_m(&self) -> f64 {
        WIDTH_PER_LENGTH * self.body_length_m()
    }

    /// This car with another centre of mass: `l_f` is `front_axle_distance_m`, and
    /// `l_r` is the rest of the wheelbase.
    #[must_use]
    pub const fn with_centre_of_mass_at(&self, front_axle_distance_m: f64) -> Self {
        Self {
            front_axle_distance_m,
            rear_axle_distance_m: self.wheelbase_m() - front_axle_distance_m,
            ..*self
        }
    }

    /// Checks that every parameter is finite and above zero.
    ///
    /// # Errors
    ///
    /// The first parameter that is not.
    pub fn validate(&self) -> Result<(), VehicleParameterError> {
        for (name, value) in [
            ("mass_kg", self.mass_kg),
            ("yaw_inertia_kg_m2", self.yaw_inertia_kg_m2),
            ("front_axle_distance_m", self.front_axle_distance_m),
            ("rear_axle_distance_m", self.rear_axle_distance_m),
            ("friction", self.friction),
            (
                "front_cornering_stiffness_n_rad",
                self.front_cornering_stiffness_n_rad,
            ),
            (
                "rear_cornering_stiffness_n_rad",
                self.rear_cornering_stiffness_n_rad,
            ),
        ] {
            if !(value.is_finite() && value > 0.0) {
                return Err(VehicleParameterError { name, value });
            }
        }
        Ok(())
    }
}

impl Default for VehicleParameters {
    fn default() -> Self {
        Self::paper()
    }
}
