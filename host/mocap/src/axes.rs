//! The axes of the stream and those of the world frame.

use singletrack_words::words;

words! {
    /// The axis that points up in the server's stream: a setting of the server that
    /// is not on the wire.
    pub enum UpAxis: serde {
        /// y points up (Motive's default). World x is the stream's x, world y its -z.
        Y = "y",
        /// z points up, as in the world frame.
        Z = "z",
    }
}

impl UpAxis {
    /// A vector of the stream in the world frame. The vector part of a quaternion
    /// turns in the same way.
    #[must_use]
    pub const fn to_z_up(self, [x, y, z]: [f64; 3]) -> [f64; 3] {
        match self {
            Self::Y => [x, -z, y],
            Self::Z => [x, y, z],
        }
    }
}
