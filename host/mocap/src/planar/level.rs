//! How a body lies, with either up axis: a wrong setting shows here.

use crate::{axes::UpAxis, body::BodyPose};

/// Height and tilt of a body, read with the configured up axis and with the other one.
///
/// The up axis is a setting of the server and is not on the wire. A car on a floor has a low
/// height and a small tilt with the right one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Level {
    /// Height of the pivot, in metres.
    pub height_m: f64,
    /// Angle between the body's up axis and the world's, in radians.
    pub tilt_rad: f64,
    /// The height with the other up axis.
    pub other_height_m: f64,
    /// The tilt with the other up axis.
    pub other_tilt_rad: f64,
}

/// Where the pivot of a car on a floor can be, in metres, and how far it can tilt, in radians.
const LOWEST_M: f64 = -0.1;
const HIGHEST_M: f64 = 0.6;
const TILT_RAD: f64 = 0.3;

impl Level {
    pub(super) fn of(pose: &BodyPose, up_axis: UpAxis) -> Self {
        let [x, y, z, _] = pose.orientation_xyzw;
        let [_, py, pz] = pose.position_m;
        // Back to the stream's axes, then read as the other one.
        let (other_height_m, other_vector) = match up_axis {
            // Stream (x, y, z) was read as (x, -z, y).
            UpAxis::Y => (-py, [x, z]),
            UpAxis::Z => (py, [x, -z]),
        };
        Self {
            height_m: pz,
            tilt_rad: tilt([x, y]),
            other_height_m,
            other_tilt_rad: tilt(other_vector),
        }
    }

    /// Whether the pose makes no sense with the configured up axis and does with the other.
    #[must_use]
    pub fn suggests_other_axis(&self) -> bool {
        let sensible = |height_m: f64, tilt_rad: f64| {
            (LOWEST_M..=HIGHEST_M).contains(&height_m) && tilt_rad <= TILT_RAD
        };
        !sensible(self.height_m, self.tilt_rad)
            && sensible(self.other_height_m, self.other_tilt_rad)
    }
}

/// The angle between two up axes, from the horizontal part of the rotation's vector.
fn tilt([x, y]: [f64; 2]) -> f64 {
    2.0 * libm::asin(libm::sqrt(x * x + y * y).min(1.0))
}
