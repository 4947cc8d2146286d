//! `[fence]`: where the car may be.

use serde::{Deserialize, Serialize};
use singletrack_control::Position;
use singletrack_pilot::Fence;

use super::{ConfigError, check};

/// Of the simulated car, whose motor does not brake at neutral: it rolls out.
const BRAKING_M_S2: f64 = 1.4;

/// Where the car may be.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct FenceSection {
    /// Corners of a polygon, in order.
    pub corners_m: Vec<[f64; 2]>,
    /// Distance that the centre of mass keeps from its sides.
    pub margin_m: f64,
    /// The deceleration that the car really has when it is told to stop.
    pub braking_m_s2: f64,
}

impl Default for FenceSection {
    /// The paper's carpet, 2 m by 2 m around the origin.
    fn default() -> Self {
        Self::square(2.0)
    }
}

impl FenceSection {
    /// A square of this width, in m, around the origin.
    #[must_use]
    pub fn square(width_m: f64) -> Self {
        let h = 0.5 * width_m;
        Self {
            corners_m: vec![[-h, -h], [h, -h], [h, h], [-h, h]],
            margin_m: 0.0,
            braking_m_s2: BRAKING_M_S2,
        }
    }

    /// For the controller.
    ///
    /// # Errors
    ///
    /// A polygon that encloses nothing or crosses over.
    pub fn fence(&self) -> Result<Fence, ConfigError> {
        let corners: Vec<_> = self
            .corners_m
            .iter()
            .map(|&[x, y]| Position::new(x, y))
            .collect();
        Ok(Fence::new(&corners, self.margin_m)?)
    }

    pub(super) fn validate(&self) -> Result<(), ConfigError> {
        check::within("fence.margin_m", self.margin_m, 0.0..=10.0)?;
        check::positive("fence.braking_m_s2", self.braking_m_s2, 50.0)?;
        for coordinate in self.corners_m.iter().flatten() {
            check::within("fence.corners_m", *coordinate, -1_000.0..=1_000.0)?;
        }
        self.fence().map(drop)
    }
}
