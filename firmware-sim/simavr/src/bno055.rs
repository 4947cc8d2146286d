//! The IMU as its bus sees it.

use serde::{Deserialize, Serialize};

/// What the IMU measures along its own axes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Motion {
    /// Acceleration without gravity, in mm/s².
    pub linear_acceleration_mm_s2: [i16; 3],
    /// Angular velocity, in mrad/s.
    pub angular_velocity_mrad_s: [i16; 3],
    /// Attitude as a unit quaternion w, x, y, z, scaled by 2^14.
    pub attitude_q14: [i16; 4],
}

/// A BNO055: its registers and its state.
#[derive(Clone, Debug, Default)]
pub struct Bno055 {
    motion: Motion,
}

impl Bno055 {
    /// What it measures from now on.
    pub const fn measure(&mut self, motion: Motion) {
        self.motion = motion;
    }
}
