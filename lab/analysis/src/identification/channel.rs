//! The measured quantities.

use singletrack_words::words;

words! {
    /// A measured quantity.
    #[derive(PartialOrd, Ord)]
    pub enum Channel {
        /// Position along x.
        X = "x",
        /// Position along y.
        Y = "y",
        /// Yaw from the cameras.
        Yaw = "yaw",
        /// Yaw rate from the gyro.
        YawRate = "yaw_rate",
        /// Acceleration to the left.
        Left = "left_acceleration",
    }
}
