//! The noise levels under which a drive is most likely.

use super::{
    channel::Channel,
    filter::FilterRun,
    noise::{LEAST_FORCE, NoiseLevels},
};

impl NoiseLevels {
    /// These levels, scaled so that the innovations of `run` have their predicted variance.
    fn rescaled(&self, run: &FilterRun) -> Self {
        let factor = |channels: &[Channel]| {
            let (mut sum, mut count) = (0.0, 0.0);
            for innovation in &run.innovations {
                if channels.contains(&innovation.channel) {
                    sum += innovation.value * innovation.value / innovation.variance;
                    count += 1.0;
                }
            }
            if count > 0.0 {
                f64::clamp(sum / count, 0.01, 100.0).sqrt()
            } else {
                1.0
            }
        };
        Self {
            position_m: self.position_m * factor(&[Channel::X, Channel::Y]),
            yaw_rad: self.yaw_rad * factor(&[Channel::Yaw]),
            yaw_rate_rad_s: self.yaw_rate_rad_s * factor(&[Channel::YawRate]),
            left_m_s2: self.left_m_s2 * factor(&[Channel::Left]),
            ..*self
        }
    }

    /// These levels, with those of the sensors within a factor of those
    /// [from the samples](Self::with_measured_sensors): a wrong model must make a sensor neither
    /// perfect nor useless.
    fn limited_to(self, sampled: &Self) -> Self {
        let limit = |level: f64, sampled: f64| level.clamp(0.6 * sampled, 2.0 * sampled);
        Self {
            position_m: limit(self.position_m, sampled.position_m),
            yaw_rad: limit(self.yaw_rad, sampled.yaw_rad),
            yaw_rate_rad_s: limit(self.yaw_rate_rad_s, sampled.yaw_rate_rad_s),
            left_m_s2: limit(self.left_m_s2, sampled.left_m_s2),
            ..self
        }
    }

    /// The levels with the largest likelihood, from these as a start.
    ///
    /// The sensors' levels stay near `sampled`. `run` runs the filter with given levels.
    pub(super) fn most_likely(
        self,
        sampled: &Self,
        rounds: u32,
        mut run: impl FnMut(&Self) -> Option<FilterRun>,
    ) -> Option<Self> {
        let mut levels = self;
        for round in 0..rounds {
            for _ in 0..2 {
                levels = levels.rescaled(&run(&levels)?).limited_to(sampled);
            }
            let spread = if round == 0 { 6.0 } else { 2.0 };
            for scale in [Self::scale_forward, Self::scale_force] {
                let mut at = |power: f64| {
                    let tried = scale(levels, f64::powf(spread, power));
                    run(&tried).map(|run| run.likelihood())
                };
                let (less, same, more) = (at(-1.0)?, at(0.0)?, at(1.0)?);
                // The maximum of the parabola through the three, limited to twice their distance.
                let bend = less - 2.0 * same + more;
                let power = if bend < 0.0 {
                    (0.5 * (less - more) / bend).clamp(-2.0, 2.0)
                } else if more > less {
                    2.0
                } else {
                    -2.0
                };
                levels = scale(levels, f64::powf(spread, power));
            }
        }
        Some(levels.rescaled(&run(&levels)?).limited_to(sampled))
    }

    fn scale_forward(mut self, factor: f64) -> Self {
        self.forward_density *= factor;
        self
    }

    fn scale_force(mut self, factor: f64) -> Self {
        self.force_density = (self.force_density * factor).max(LEAST_FORCE);
        self
    }
}
