//! The car by the configuration in force: its wheelbase, and its description for viewers.

use core::f64::consts::FRAC_PI_2;

/// Distances of the axles from the centre of mass, in m.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Car {
    front: f64,
    rear: f64,
}

impl Car {
    /// The car of a configuration with every key; none if the axles are not in it.
    pub(crate) fn of(configuration: &str) -> Option<Self> {
        let configuration: toml::Table = configuration.parse().ok()?;
        let axle = |key| configuration.get("vehicle")?.get(key)?.as_float();
        Some(Self {
            front: axle("front_axle_distance_m")?,
            rear: axle("rear_axle_distance_m")?,
        })
    }

    /// Distance between the axles, in m.
    pub(crate) fn wheelbase(self) -> f64 {
        self.front + self.rear
    }

    /// The URDF: one link, so that viewers need no transform but that of the car. Body and wheels are
    /// those of a usual 1:10 car at this wheelbase.
    pub(crate) fn urdf(self, base: &str) -> String {
        let scale = self.wheelbase() / 0.26;
        let [length, width, radius, tyre] = [0.4, 0.19, 0.033, 0.026].map(|size| size * scale);
        let visual = |[x, y, z]: [f64; 3], turned: f64, shape: String, colour: &str| {
            format!(
                "    <visual>\n      <origin xyz=\"{x:.4} {y:.4} {z:.4}\" rpy=\"{turned:.6} 0 0\"/>\n      \
                 <geometry><{shape}/></geometry>\n      <material name=\"{colour}\"/>\n    </visual>\n"
            )
        };
        let body = format!("box size=\"{length:.4} {width:.4} {:.4}\"", 2.0 * radius);
        let middle = [0.5 * (self.front - self.rear), 0.0, 2.0 * radius];
        let mut visuals = visual(middle, 0.0, body, "body");
        for x in [self.front, -self.rear] {
            for y in [0.5, -0.5].map(|side| side * (width - tyre)) {
                let wheel = format!("cylinder radius=\"{radius:.4}\" length=\"{tyre:.4}\"");
                visuals += &visual([x, y, radius], FRAC_PI_2, wheel, "tyre");
            }
        }
        format!(
            "<?xml version=\"1.0\"?>\n<robot name=\"singletrack\">\n  \
             <material name=\"body\"><color rgba=\"0.1 0.3 0.8 1\"/></material>\n  \
             <material name=\"tyre\"><color rgba=\"0.1 0.1 0.1 1\"/></material>\n  \
             <link name=\"{base}\">\n{visuals}  </link>\n</robot>\n"
        )
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test may fail")]
mod tests {
    use super::*;

    #[test]
    fn the_description_has_the_axles_of_the_configuration() {
        let text = "[vehicle]\nfront_axle_distance_m = 0.1368\nrear_axle_distance_m = 0.1232\n";
        let car = Car::of(text).unwrap();
        assert!((car.wheelbase() - 0.26).abs() < 1e-12);
        let urdf = car.urdf("car7/base_link");
        assert!(urdf.contains("<link name=\"car7/base_link\">"));
        assert_eq!(urdf.matches("xyz=\"0.1368 ").count(), 2, "{urdf}");
        assert_eq!(urdf.matches("xyz=\"-0.1232 ").count(), 2, "{urdf}");
        assert_eq!(Car::of("[vehicle]\n"), None);
        assert_eq!(Car::of("not toml"), None);
    }
}
