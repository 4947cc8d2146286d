//! The scale of the gyro, from the cameras.

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
        let count = pairs.len() as f64;
        let mean = |index: usize| pairs.iter().map(|pair| pair[index]).sum::<f64>() / count;
        let (camera, gyro) = (mean(0), mean(1));
        let (mut square, mut product) = (0.0, 0.0);
        for [one, other] in &pairs {
            square += (one - camera) * (one - camera);
            product += (one - camera) * (other - gyro);
        }
        let value = product / square;
        let errors: f64 = pairs
            .iter()
            .map(|[one, other]| (other - gyro - value * (one - camera)).powi(2))
            .sum();
        // The errors of samples of a few hertz that are interpolated are alike over ten of them.
        const ALIKE: f64 = 10.0;
        let deviation = (ALIKE * errors / count / square).sqrt().max(1e-4);
        (value.is_finite() && deviation.is_finite()).then_some(Self {
            value,
            deviation,
            turning: (square / count).sqrt(),
        })
    }
}
