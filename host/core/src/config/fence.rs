//! `[fence]`: where the car may be.

use singletrack_control::Position;
use singletrack_pilot::Fence;

use super::{ConfigError, section::section};

section! {
    /// Where the centre of mass may be, and must be able to stop. The default is the paper's
    /// carpet. A car that has to turn round first, which takes up to 2.7 m, needs a larger
    /// fence.
    "fence" => pub FenceSection;
    [default];

    /// Corners of a polygon, 3 to 16, in order.
    corners_m: Vec<[f64; 2]> = square(2.0), in -1_000.0..=1_000.0;
    /// Distance kept from the sides; half the car's length keeps all of it inside.
    margin_m: f64 = 0.0, in 0.0..=10.0;
    // That of the simulated car, whose motor does not brake at neutral.
    /// Deceleration that the car really reaches when it is commanded to stop. To measure it,
    /// let the car roll out on your floor from speed v over the distance s: v * v / (2 * s).
    braking_m_s2: f64 = 1.4, in up_to(50.0);
}

/// The corners of a square of this width, in m, around the origin.
fn square(width_m: f64) -> Vec<[f64; 2]> {
    let h = 0.5 * width_m;
    vec![[-h, -h], [h, -h], [h, h], [-h, h]]
}

impl FenceSection {
    /// A square of this width, in m, around the origin.
    #[must_use]
    pub fn square(width_m: f64) -> Self {
        Self {
            corners_m: square(width_m),
            ..Self::default()
        }
    }

    /// For the controller.
    ///
    /// # Errors
    ///
    /// A polygon without area, or whose sides cross.
    pub fn fence(&self) -> Result<Fence, ConfigError> {
        let corners: Vec<_> = self
            .corners_m
            .iter()
            .map(|&[x, y]| Position::new(x, y))
            .collect();
        Ok(Fence::new(&corners, self.margin_m)?)
    }
}
