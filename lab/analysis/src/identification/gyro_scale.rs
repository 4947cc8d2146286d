//! The scale of the gyro, from the cameras.

use singletrack_statistics::Line;

use super::{
    data::{DriveData, Span},
    simulation::seen,
};

/// The scale of the gyro by the yaw of the cameras, and its standard deviation.
#[derive(Clone, Copy, Debug)]
pub(super) struct GyroScale {
    pub(super) value: f64,
    pub(super) deviation: f64,
    /// Standard deviation of the yaw rate of the cameras, in rad/s.
    pub(super) turning: f64,
}

impl GyroScale {
    /// The regression of the gyro on the yaw rate of the cameras. None without enough turning.
    pub(super) fn of(data: &DriveData, spans: &[Span]) -> Option<Self> {
        let samples = data.inertial.iter();
        let samples = samples.filter(|one| spans.iter().any(|span| span.contains(one.time_s)));
        let pairs: Vec<[f64; 2]> = samples
            .filter_map(|sample| {
                let seen = seen(&data.poses, sample.time_s)?;
                Some([seen.yaw_rate, sample.yaw_rate_rad_s])
            })
            .collect();
        let line = Line::through(pairs.iter().copied());
        let count = pairs.len() as f64;
        let errors: f64 = pairs
            .iter()
            .map(|[camera, gyro]| (gyro - line.at(*camera)).powi(2))
            .sum();
        // The errors of samples of a few hertz that are interpolated are alike over ten of them.
        const ALIKE: f64 = 10.0;
        let deviation = (ALIKE * errors / count / line.spread).sqrt().max(1e-4);
        (line.spread > 0.0 && deviation.is_finite()).then_some(Self {
            value: line.slope,
            deviation,
            turning: (line.spread / count).sqrt(),
        })
    }
}
