//! The noise levels under which a drive is most likely.

use super::{
    channel::Channel,
    filter::Passage,
    noise::{LEAST_FORCE, NoiseLevels},
};

impl NoiseLevels {
    /// The levels under which the innovations of a passage have the variance that
    /// they should have.
    fn rescaled(&self, passage: &Passage) -> Self {
        let factor = |channels: &[Channel]| {
            let (mut sum, mut count) = (0.0, 0.0);
            for innovation in &passage.innovations {
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

    /// These levels with those of the sensors no farther than a factor from what was
    /// [seen](Self::seen): a wrong model must not make a sensor perfect, nor useless.
    fn near(self, seen: &Self) -> Self {
        let near = |level: f64, seen: f64| level.clamp(0.6 * seen, 2.0 * seen);
        Self {
            position_m: near(self.position_m, seen.position_m),
            yaw_rad: near(self.yaw_rad, seen.yaw_rad),
            yaw_rate_rad_s: near(self.yaw_rate_rad_s, seen.yaw_rate_rad_s),
            left_m_s2: near(self.left_m_s2, seen.left_m_s2),
            ..self
        }
    }

    /// The levels under which a passage is most likely, starting from these; those of
    /// the sensors near what was seen. `pass` goes along the drive with given levels.
    pub(super) fn most_likely(
        self,
        seen: &Self,
        rounds: u32,
        mut pass: impl FnMut(&Self) -> Option<Passage>,
    ) -> Option<Self> {
        let mut levels = self;
        for round in 0..rounds {
            for _ in 0..2 {
                levels = levels.rescaled(&pass(&levels)?).near(seen);
            }
            let spread = if round == 0 { 6.0 } else { 2.0 };
            for scale in [Self::scale_forward, Self::scale_force] {
                let mut at = |power: f64| {
                    let tried = scale(levels, f64::powf(spread, power));
                    pass(&tried).map(|passage| passage.likelihood())
                };
                let (less, same, more) = (at(-1.0)?, at(0.0)?, at(1.0)?);
                // The top of the parabola through the three, within its reach.
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
        Some(levels.rescaled(&pass(&levels)?).near(seen))
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
