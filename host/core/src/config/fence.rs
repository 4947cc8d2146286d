//! `[fence]`: where the car may be.

use singletrack_control::{ConvexArea, Position, VehicleParameters};
use singletrack_pilot::Fence;
use singletrack_settings::section;

use super::ConfigError;

section! {
    /// Where the centre of mass may be, and must be able to stop. A car that has to turn
    /// round first, which takes up to 2.7 m, needs a larger fence than the default, the
    /// paper's carpet.
    "fence" => pub FenceSection;
    [new];

    /// Corners of a polygon, 3 to 16, in order.
    corners_m: Vec<[f64; 2]> = square(2.0), in -1_000.0..=1_000.0;
    /// Distance kept from the sides. The default is half the length of a car, taken as
    /// 1.54 wheelbases: 0.2 m for the paper's.
    margin_m: Option<f64> = None, in 0.0..=10.0, otherwise 0.2;
    // Without a default: only the operator can measure it, and geofence and stop watch need it.
    /// Deceleration that the car really reaches with the motor at neutral. To measure it,
    /// let the car roll out on your floor, from 0.3 m/s and from the highest speed: v over
    /// the distance s gives v * v / (2 * s). Take the lowest of several, less 20 %.
    braking_m_s2: f64, in up_to(50.0), example 0.9;
}

/// The corners of a square of this width, in m, around the origin.
fn square(width_m: f64) -> Vec<[f64; 2]> {
    let h = 0.5 * width_m;
    vec![[-h, -h], [h, -h], [h, h], [-h, h]]
}

impl FenceSection {
    /// A square of this width, in m, around the origin, for a car with this deceleration.
    #[must_use]
    pub fn square(width_m: f64, braking_m_s2: f64) -> Self {
        Self {
            corners_m: square(width_m),
            ..Self::new(braking_m_s2)
        }
    }

    /// The distance kept from the sides, for this car, in m.
    #[must_use]
    pub fn margin_m(&self, vehicle: &VehicleParameters) -> f64 {
        let half = 0.5 * vehicle.body_length_m();
        self.margin_m.unwrap_or((half * 1_000.0).round() / 1_000.0)
    }

    /// Writes the margin for this car out, so that every reader of the configuration has it.
    pub(super) fn resolve(&mut self, vehicle: &VehicleParameters) {
        self.margin_m = Some(self.margin_m(vehicle));
    }

    /// For the controller of this car.
    ///
    /// # Errors
    ///
    /// A polygon without area, or whose sides cross.
    pub fn fence(&self, vehicle: &VehicleParameters) -> Result<Fence, ConfigError> {
        let corners: Vec<_> = self
            .corners_m
            .iter()
            .map(|&[x, y]| Position::new(x, y))
            .collect();
        Ok(Fence::new(&corners, self.margin_m(vehicle))?)
    }

    /// The area of the centre of mass, for a section that needs a convex one.
    ///
    /// # Errors
    ///
    /// As for [`FenceSection::fence`]; the polygon is not convex, or nothing is left of it.
    pub(super) fn convex(
        &self,
        vehicle: &VehicleParameters,
        section: &str,
    ) -> Result<ConvexArea, ConfigError> {
        let fence = self.fence(vehicle)?;
        let margin = self.margin_m(vehicle);
        let area = ConvexArea::new(fence.corners()).map_err(|error| {
            let corners = format!("{:?}", self.corners_m);
            let fix = format!(
                "{error}, and {section} needs a convex polygon; give its largest convex part, or \
                 set {section}.enabled = false"
            );
            ConfigError::value("fence.corners_m", corners, fix)
        })?;
        area.shrunk(margin).map_err(|error| {
            let fix = format!("{error}; lower it, or give a larger fence.corners_m");
            ConfigError::value("fence.margin_m", margin, fix)
        })
    }
}
