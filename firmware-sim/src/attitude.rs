//! Attitude of a car on a floor: yaw and a small tilt.

use libm::{cos, sin, sqrt};

/// The unit quaternion w, x, y, z of a yaw after a small roll and pitch, in rad.
pub(crate) fn quaternion_wxyz(yaw: f64, roll: f64, pitch: f64) -> [f64; 4] {
    let (c, s) = (cos(yaw / 2.0), sin(yaw / 2.0));
    let (a, b) = (roll / 2.0, pitch / 2.0);
    let norm = sqrt(1.0 + a * a + b * b);
    [
        c / norm,
        (a * c - b * s) / norm,
        (a * s + b * c) / norm,
        s / norm,
    ]
}

#[cfg(test)]
mod tests {
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
}
