//! The distance since the last accepted pose.

use singletrack_control::Time;

/// Integrates the farthest distance that the car may have gone since the mid-exposure
/// of the last accepted pose; zero before the first one.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct BlindWatch {
    distance: f64,
    until: Option<Time>,
}

impl BlindWatch {
    /// A pose with its mid-exposure at `capture` was accepted: the distance restarts there.
    pub(crate) const fn seen(&mut self, capture: Time) {
        self.distance = 0.0;
        self.until = Some(capture);
    }

    /// Adds the time up to `now`, at a speed of at most `pace` (m/s).
    pub(crate) fn advance(&mut self, now: Time, pace: f64) {
        if let Some(until) = self.until {
            // A pace that is not finite must not count as standstill.
            let pace = if pace.is_finite() { pace } else { f64::MAX };
            self.distance += pace * now.seconds_since(until);
            self.until = Some(now);
        }
    }

    /// The distance, in m.
    pub(crate) const fn distance(&self) -> f64 {
        self.distance
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_distance_counts_from_mid_exposure_and_a_pose_restarts_it() {
        let at = |ms: u64| Time(ms * 1_000_000);
        let mut blind = BlindWatch::default();
        blind.advance(at(1_000), 1.0);
        assert_eq!(blind.distance(), 0.0, "no pose yet");
        blind.seen(at(990));
        blind.advance(at(1_000), 1.0);
        blind.advance(at(1_020), 2.0);
        assert!((blind.distance() - 0.05).abs() < 1e-12);
        blind.seen(at(1_015));
        blind.advance(at(1_020), 2.0);
        assert!((blind.distance() - 0.01).abs() < 1e-12);
        blind.advance(at(1_030), f64::NAN);
        assert!(blind.distance() > 1e9);
    }
}
