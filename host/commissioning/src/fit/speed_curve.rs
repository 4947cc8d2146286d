//! The speed of the wheels over the pulse beyond neutral.
//!
//! Beyond an edge the settled speed is `v = g x / (1 + x / s)`, with `x` the way of the pulse
//! beyond the edge: a line that bends. Its inverse `x = a v / (1 - w v)` has two parameters
//! that enter linearly, the edge and `a = 1 / g`, and the bend `w`, which is searched.

use nalgebra::Vector3;

use super::{LeastSquares, least_squares, least_squares::inverted, student_quantile};
use crate::Interval;

/// Highest bend that is searched, s/m: speeds reach 0.9 m/s, and 1/w is the highest of all.
const MAX_BEND: f64 = 0.8;

/// Steps of the search.
const BENDS: u32 = 160;

/// The bend of drive trains, and its standard deviation, s/m: what is known before. Without it
/// slow speeds alone, or few, say nothing of the edge.
pub(crate) const USUAL_BEND: f64 = 0.25;
const BEND_SPREAD: f64 = 0.2;

/// What a pulse rounds to: the least scatter that is believed, us.
const LEAST_SCATTER_US: f64 = 0.3;

/// A curve of settled speeds.
#[derive(Clone, Copy, Debug)]
pub(crate) struct SpeedCurve {
    /// Pulse beyond neutral up to which the wheels stand, us.
    pub(crate) edge: Interval,
    /// Pulse beyond the edge for each m/s, at the speed that was asked for, us/(m/s).
    pub(crate) feed_forward: Interval,
    /// Standard deviation of the pulses around the curve, us.
    pub(crate) scatter: f64,
    slope: f64,
    bend: f64,
}

impl SpeedCurve {
    /// The pulse beyond neutral that settles at this speed, us.
    pub(crate) fn pulse(&self, speed: f64) -> f64 {
        self.edge.value + self.slope * bent(speed, self.bend)
    }
}

fn bent(speed: f64, bend: f64) -> f64 {
    speed / (1.0 - bend * speed)
}

/// Fits settled speeds, each after its pulse beyond neutral, in us and m/s, both positive.
///
/// `systematic_us` is what all of them may be off by: the wheels of some drive trains begin to
/// turn later than they stop. The feed-forward is that at `at_speed`. `None` of fewer than five
/// readings, or if they show no curve.
pub(crate) fn fit_speed_curve(
    readings: &[[f64; 2]],
    systematic_us: f64,
    at_speed: f64,
) -> Option<SpeedCurve> {
    let freedom = readings.len().checked_sub(3).filter(|left| *left >= 2)?;
    let of_bend = |bend: f64| {
        let rows = readings
            .iter()
            .map(move |[pulse, speed]| ([1.0, bent(*speed, bend)], *pulse));
        least_squares(rows).filter(|fit| fit.parameters[1] > 0.0)
    };
    let unlikely = |(bend, fit): &(f64, LeastSquares<2>)| {
        fit.count as f64 * (fit.residual / LEAST_SCATTER_US).powi(2)
            + ((bend - USUAL_BEND) / BEND_SPREAD).powi(2)
    };
    let (bend, fit) = (0..=BENDS)
        .map(|step| MAX_BEND * f64::from(step) / f64::from(BENDS))
        .filter(|bend| readings.iter().all(|[_, speed]| bend * speed < 0.95))
        .filter_map(|bend| Some((bend, of_bend(bend)?)))
        .min_by(|a, b| unlikely(a).total_cmp(&unlikely(b)))?;
    let [edge, slope] = fit.parameters;
    let scatter = fit.residual * (fit.count as f64 / freedom as f64).sqrt();
    // Linear around the solution, the bend with it.
    let believed = scatter.max(LEAST_SCATTER_US);
    let known = Vector3::new(0.0, 0.0, believed / BEND_SPREAD);
    let mut normal = known * known.transpose();
    for [_, speed] in readings {
        let by = bent(*speed, bend);
        let row = Vector3::new(1.0, by, slope * by * by);
        normal += row * row.transpose();
    }
    let covariance = inverted(&normal)?;
    let error_along = |towards: Vector3<f64>| towards.dot(&(covariance * towards)).max(0.0).sqrt();
    let half = student_quantile(freedom) * believed;
    let at = bent(at_speed, bend);
    let towards = Vector3::new(0.0, at / at_speed, slope * at * at / at_speed);
    Some(SpeedCurve {
        edge: Interval::around(edge, half * error_along(Vector3::x())).widened(systematic_us),
        feed_forward: Interval::around(slope * at / at_speed, half * error_along(towards))
            .widened(systematic_us / at_speed),
        scatter,
        slope,
        bend,
    })
}

#[cfg(test)]
mod tests {
    use super::fit_speed_curve;
    use singletrack_statistics::Random;

    fn speed(gain: f64, saturation: f64, beyond: f64) -> f64 {
        gain * beyond / (1.0 + beyond / saturation)
    }

    #[test]
    fn the_interval_holds_edge_and_feed_forward_in_19_of_20_sets() {
        let mut noise = Random::new(2);
        let mut held = [0; 2];
        for _ in 0..500 {
            let gain = 0.006 + 0.01 * noise.uniform();
            let saturation = 300.0 + 500.0 * noise.uniform();
            let edge = 20.0 + 30.0 * noise.uniform();
            let mut readings = Vec::new();
            let mut pulse = edge.ceil() + 6.0;
            while speed(gain, saturation, pulse - edge) < 0.75 {
                for _ in 0..2 {
                    let settled = speed(gain, saturation, pulse - edge);
                    readings.push([pulse, settled + 0.004 * noise.normal(1.0)]);
                }
                pulse += 9.0;
            }
            let fit = fit_speed_curve(&readings, 0.0, 0.5).unwrap();
            // Half of the linear speed is reached at a speed of gain times saturation.
            let needed = 0.5 / gain / (1.0 - 0.5 / (gain * saturation));
            held[0] += u32::from(fit.edge.contains(edge));
            held[1] += u32::from(fit.feed_forward.contains(needed / 0.5));
        }
        assert!(held.iter().all(|held| *held >= 460), "{held:?}");
    }

    #[test]
    fn the_pulse_of_a_speed_is_that_of_the_curve() {
        let readings: Vec<_> = (1..9)
            .map(|step| {
                let pulse = 40.0 + 10.0 * f64::from(step);
                [pulse, speed(0.01, 400.0, pulse - 30.0)]
            })
            .collect();
        let fit = fit_speed_curve(&readings, 0.0, 0.5).unwrap();
        assert!((fit.edge.value - 30.0).abs() < 0.5, "{fit:?}");
        assert!((fit.pulse(readings[3][1]) - readings[3][0]).abs() < 0.3);
        assert!(fit.scatter < 0.1);
    }

    #[test]
    fn too_few_readings_or_none_that_rise_give_no_curve() {
        let flat: Vec<_> = (0..8).map(|step| [f64::from(step), 0.3]).collect();
        assert!(fit_speed_curve(&flat, 0.0, 0.5).is_none());
        let falls: Vec<_> = (0..8)
            .map(|step| [50.0 - f64::from(step), 0.1 + 0.05 * f64::from(step)])
            .collect();
        assert!(fit_speed_curve(&falls, 0.0, 0.5).is_none());
        assert!(fit_speed_curve(&[[40.0, 0.1], [50.0, 0.2]], 0.0, 0.5).is_none());
    }
}
