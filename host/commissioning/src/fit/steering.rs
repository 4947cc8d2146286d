//! The servo's map from angles that a person has read.

use singletrack_statistics::Line;

use crate::Interval;
use singletrack_control::student_quantile;

/// What the readings say.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Steering {
    /// Pulse for one radian to the left, us/rad.
    pub(crate) gain: Interval,
    /// Pulse that reads zero, us. The error that all readings share is not in it.
    pub(crate) straight: Interval,
    /// Standard deviation of the readings, rad.
    pub(crate) scatter: f64,
}

/// Fits a line through readings, each a pulse in us and an angle in rad.
///
/// A reading scatters by `least_scatter` at least, whatever these say, and all of them share
/// a relative error of `scale` (95 %). `None` if they show no slope.
pub(crate) fn fit_steering(
    readings: &[[f64; 2]],
    least_scatter: f64,
    scale: f64,
) -> Option<Steering> {
    let count = readings.len() as f64;
    if readings.len() < 3 {
        return None;
    }
    let line = Line::through(readings.iter().copied());
    let slope = line.slope;
    let squares: f64 = readings
        .iter()
        .map(|[pulse, angle]| (angle - line.at(*pulse)).powi(2))
        .sum();
    let freedom = readings.len() - 2;
    let scatter = (squares / freedom as f64).sqrt();
    let believed = scatter.max(least_scatter);
    let t = student_quantile(freedom);
    let random = t * believed / line.spread.sqrt();
    let half = random.hypot(scale * slope);
    if line.spread == 0.0 || slope.abs() <= half {
        return None;
    }
    let ends = [1.0 / (slope - half), 1.0 / (slope + half)];
    let zero = line.middle[0] - line.middle[1] / slope;
    let at_zero = believed * (1.0 / count + (zero - line.middle[0]).powi(2) / line.spread).sqrt();
    Some(Steering {
        gain: Interval::between(1.0 / slope, ends),
        straight: Interval::around(zero, t * at_zero / slope.abs()),
        scatter,
    })
}

#[cfg(test)]
mod tests {
    use super::fit_steering;
    use singletrack_statistics::Random;

    #[test]
    fn the_interval_holds_the_gain_in_19_of_20_sets_of_readings() {
        let mut noise = Random::new(1);
        let mut held = [0; 2];
        for _ in 0..1_000 {
            let gain = (600.0 + 500.0 * noise.uniform()) * (1.0_f64).copysign(noise.normal(1.0));
            let centre = 1_450.0 + 100.0 * noise.uniform();
            let scale = 1.0 + 0.01 * noise.normal(1.0);
            let readings: Vec<_> = (0..12)
                .map(|index| {
                    let pulse = 1_200.0 + 50.0 * f64::from(index);
                    let angle = scale * (pulse - centre) / gain;
                    [pulse, angle + 0.0175 * noise.normal(1.0)]
                })
                .collect();
            let fit = fit_steering(&readings, 0.01, 0.02).unwrap();
            held[0] += u32::from(fit.gain.low <= gain && gain <= fit.gain.high);
            held[1] += u32::from((fit.straight.low..=fit.straight.high).contains(&centre));
        }
        assert!(
            held.iter().all(|held| (930..=990).contains(held)),
            "{held:?}"
        );
    }

    #[test]
    fn readings_without_a_slope_give_no_gain() {
        let level = [[1_400.0, 0.1], [1_500.0, 0.11], [1_600.0, 0.09]];
        assert!(fit_steering(&level, 0.0175, 0.02).is_none());
        let same = [[1_500.0, 0.1]; 5];
        assert!(fit_steering(&same, 0.0175, 0.02).is_none());
    }

    #[test]
    fn readings_without_scatter_are_believed_to_the_least_scatter_only() {
        let readings = [-300.0, -150.0, 0.0, 150.0, 300.0].map(|way| [1_500.0 + way, way / 800.0]);
        let fit = fit_steering(&readings, 0.0175, 0.0).unwrap();
        assert!((fit.gain.value - 800.0).abs() < 1e-9);
        assert!(fit.gain.high - fit.gain.low > 50.0, "{:?}", fit.gain);
    }
}
