//! Figures of tracking: how closely P followed a circle.

use std::{f64::consts::TAU, fmt};

use serde::Serialize;
use singletrack_control::statistics::{Distribution, RootMeanSquare};

/// How far P was from its reference, in m.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct TrackingError {
    /// Root mean square.
    pub rms_m: f64,
    /// The largest.
    pub max_m: f64,
    /// The last one.
    pub end_m: f64,
}

impl TrackingError {
    /// The error by these distances from P to its reference, in m; `None` without any.
    pub fn of(distances: &[f64]) -> Option<Self> {
        let sorted = Distribution::of(distances.iter().copied());
        Some(Self {
            rms_m: sorted.root_mean_square()?,
            max_m: sorted.max()?,
            end_m: *distances.last()?,
        })
    }
}

impl fmt::Display for TrackingError {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [rms, max, end] = [self.rms_m, self.max_m, self.end_m].map(|error| error * 1e3);
        write!(
            formatter,
            "distance of P from its reference: {rms:.1} mm (rms), at most {max:.1} mm, {end:.1} mm at \
             the end"
        )
    }
}

/// P and its reference at one time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample {
    /// Seconds since the first driving tick.
    pub time: f64,
    /// The true P, in m.
    pub point: [f64; 2],
    /// The reference of P, in m.
    pub reference: [f64; 2],
}

/// Figures of the last full turn.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Tracking {
    /// Amplitude of P's motion at the reference's frequency, in m.
    pub amplitude_m: f64,
    /// Lag of P's motion behind the reference, in rad.
    pub lag_rad: f64,
    /// Root mean square of the distance from P to its reference, in m.
    pub rms_error_m: f64,
}

/// The figures of the last full turn about `centre` (m) at
/// `angular_velocity` (rad/s), from evenly spaced samples in order of time;
/// `None` without a full turn.
///
/// Amplitude and lag come from a least-squares fit of a circle at the reference's
/// frequency to P.
pub fn last_turn(samples: &[Sample], centre: [f64; 2], angular_velocity: f64) -> Option<Tracking> {
    let turn = TAU / angular_velocity.abs();
    let end = samples.last()?.time;
    if end < turn {
        return None;
    }
    let first = samples.partition_point(|sample| sample.time <= end - turn);
    let samples = &samples[first..];
    let count = samples.len() as f64;

    let (mut along, mut across) = (0.0, 0.0);
    for sample in samples {
        let [x, y] = [0, 1].map(|axis| sample.point[axis] - centre[axis]);
        let [rx, ry] = [0, 1].map(|axis| sample.reference[axis] - centre[axis]);
        let radius = libm::hypot(rx, ry);
        along += (x * rx + y * ry) / radius;
        across += (x * ry - y * rx) / radius;
    }
    let (along, across) = (along / count, across / count);
    Some(Tracking {
        amplitude_m: libm::hypot(along, across),
        lag_rad: libm::atan2(across, along) * angular_velocity.signum(),
        rms_error_m: rms_error(samples)?,
    })
}

/// Root mean square of the distance from P to its reference, in m; `None` without a sample.
pub fn rms_error(samples: &[Sample]) -> Option<f64> {
    let mut errors = RootMeanSquare::default();
    for Sample {
        point: [x, y],
        reference: [rx, ry],
        ..
    } in samples
    {
        errors.add_square((x - rx).powi(2) + (y - ry).powi(2));
    }
    errors.value()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn drive(amplitude: f64, lag: f64, angular_velocity: f64, duration: f64) -> Vec<Sample> {
        (0..=(duration * 100.0) as u32)
            .map(|tick| {
                let time = f64::from(tick) * 0.01;
                let phase = angular_velocity * time;
                let at = |radius: f64, phase: f64| {
                    [
                        2.0 + radius * libm::cos(phase),
                        -1.0 + radius * libm::sin(phase),
                    ]
                };
                Sample {
                    time,
                    point: at(amplitude, phase - lag * angular_velocity.signum()),
                    reference: at(1.0, phase),
                }
            })
            .collect()
    }

    #[test]
    fn amplitude_and_lag_are_found_in_both_directions() {
        for angular_velocity in [0.5, -0.5] {
            let samples = drive(0.894, 0.464, angular_velocity, 20.0);
            let tracking = last_turn(&samples, [2.0, -1.0], angular_velocity).unwrap();
            assert!((tracking.amplitude_m - 0.894).abs() < 1e-9);
            assert!((tracking.lag_rad - 0.464).abs() < 1e-9);
            let error = (1.0_f64 + 0.894_f64.powi(2) - 2.0 * 0.894 * libm::cos(0.464_f64)).sqrt();
            assert!((tracking.rms_error_m - error).abs() < 1e-9);
        }
    }

    #[test]
    fn there_are_no_figures_without_a_full_turn() {
        assert_eq!(last_turn(&drive(1.0, 0.0, 0.5, 12.0), [0.0; 2], 0.5), None);
        assert_eq!(last_turn(&[], [0.0; 2], 0.5), None);
    }
}
