//! Attitude of a car on a floor: yaw and a small tilt; and of what is mounted on it.

use libm::{sincos, sqrt};
use singletrack_protocol::{ImuAxes, ImuAxis};

/// A tilt beyond this is not small, in rad.
const SMALL: f64 = 0.1;

/// The unit quaternion w, x, y, z of a yaw after a roll and a pitch, in rad, of which only
/// one is not small.
pub(crate) fn quaternion_wxyz(yaw: f64, roll: f64, pitch: f64) -> [f64; 4] {
    let (s, c) = sincos(yaw / 2.0);
    let (mut a, mut b) = (roll / 2.0, pitch / 2.0);
    let half = libm::hypot(a, b);
    if 2.0 * half > SMALL {
        let scale = libm::tan(half) / half;
        (a, b) = (a * scale, b * scale);
    }
    let norm = sqrt(1.0 + a * a + b * b);
    [
        c / norm,
        (a * c - b * s) / norm,
        (a * s + b * c) / norm,
        s / norm,
    ]
}

/// How a sensor is turned on the car.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Rotation {
    quaternion_wxyz: [f64; 4],
}

impl Rotation {
    /// Roll, pitch and yaw, in degrees; `None` if all are zero.
    pub(crate) fn from_degrees(angles: [f64; 3]) -> Option<Self> {
        if angles == [0.0; 3] {
            return None;
        }
        let [(sr, cr), (sp, cp), (sy, cy)] = angles.map(|angle| sincos(angle.to_radians() / 2.0));
        let about_z = [cy, 0.0, 0.0, sy];
        let about_y = [cp, 0.0, sp, 0.0];
        let about_x = [cr, sr, 0.0, 0.0];
        Some(Self {
            quaternion_wxyz: product(product(about_z, about_y), about_x),
        })
    }

    /// A vector of the car along the turned axes.
    pub(crate) fn into_turned(self, [x, y, z]: [f64; 3]) -> [f64; 3] {
        let [w, a, b, c] = self.quaternion_wxyz;
        let inverse = [w, -a, -b, -c];
        let [_, x, y, z] = product(product(inverse, [0.0, x, y, z]), self.quaternion_wxyz);
        [x, y, z]
    }

    /// The attitude of the turned axes on a car with this attitude.
    pub(crate) fn after(self, car_wxyz: [f64; 4]) -> [f64; 4] {
        product(car_wxyz, self.quaternion_wxyz)
    }
}

/// The angles of a sensor whose axes are mounted so.
pub(crate) fn mounting_deg(axes: ImuAxes) -> [f64; 3] {
    let direction = |axis: ImuAxis| -> [f64; 3] {
        core::array::from_fn(
            |i| match (usize::from(axis.index()) == i, axis.is_negative()) {
                (false, _) => 0.0,
                (true, true) => -1.0,
                (true, false) => 1.0,
            },
        )
    };
    let right_angles = || [0.0, 90.0, 180.0, 270.0].into_iter();
    let mut mountings = right_angles().flat_map(|roll| {
        right_angles().flat_map(move |pitch| right_angles().map(move |yaw| [roll, pitch, yaw]))
    });
    mountings
        .find(|&angles| {
            // Without a rotation the axes are those of the car.
            let turned = |axis: [f64; 3]| {
                Rotation::from_degrees(angles).map_or(axis, |mounting| mounting.into_turned(axis))
            };
            [
                ([1.0, 0.0, 0.0], axes.forward),
                ([0.0, 1.0, 0.0], axes.left),
                ([0.0, 0.0, 1.0], axes.up),
            ]
            .into_iter()
            .all(|(axis, chip)| {
                let error = turned(axis).into_iter().zip(direction(chip));
                error.into_iter().all(|(a, b)| (a - b).abs() < 1e-6)
            })
        })
        // A left-handed set of axes, which the board refuses.
        .unwrap_or_default()
}

/// The product of two quaternions w, x, y, z.
fn product([a, b, c, d]: [f64; 4], [e, f, g, h]: [f64; 4]) -> [f64; 4] {
    [
        a * e - b * f - c * g - d * h,
        a * f + b * e + c * h - d * g,
        a * g - b * h + c * e + d * f,
        a * h + b * g - c * f + d * e,
    ]
}

#[cfg(test)]
mod tests {
    use libm::{cos, sin};

    use super::*;

    #[test]
    fn the_quaternion_has_unit_length_and_rotates_by_the_yaw() {
        for yaw in [-3.0, -0.5, 0.0, 1.0, 2.5, 7.0] {
            let [w, x, y, z] = quaternion_wxyz(yaw, 0.01, -0.02);
            assert!((w * w + x * x + y * y + z * z - 1.0).abs() < 1e-12);
            // The forward axis, rotated.
            let forward = [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z)];
            assert!((forward[0] - cos(yaw)).abs() < 1e-3);
            assert!((forward[1] - sin(yaw)).abs() < 1e-3);
        }
    }

    #[test]
    fn all_mountings_at_right_angles_have_angles() {
        use singletrack_protocol::ImuAxis::{MinusX, MinusY, MinusZ, PlusX, PlusY, PlusZ};
        let axes = [PlusX, MinusX, PlusY, MinusY, PlusZ, MinusZ];
        let mut found = 0;
        for forward in axes {
            for left in axes {
                for up in axes {
                    let mounting = ImuAxes { forward, left, up };
                    found += u32::from(mounting_deg(mounting) != [0.0; 3]);
                }
            }
        }
        // And the one without a turn.
        assert_eq!(found, 23);
        let turned = ImuAxes {
            forward: MinusY,
            left: PlusX,
            up: PlusZ,
        };
        assert_eq!(mounting_deg(turned), [0.0, 0.0, 90.0]);
    }
}
