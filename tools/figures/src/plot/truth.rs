//! Ground truth, for simulated drives.

/// Ground truth at one time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TruthSample {
    /// Since the first driving tick, in s.
    pub time: f64,
    /// The true P, world frame, in m.
    pub point: [f64; 2],
    /// Steering angle of the front wheels, in rad.
    pub steering: f64,
    /// Speed of G, in m/s.
    pub speed: f64,
    /// Sideslip of G, in rad.
    pub sideslip: f64,
    /// Yaw rate, in rad/s.
    pub yaw_rate: f64,
}
