//! How far the car has gone since it was last seen.

use singletrack_control::Time;

/// The way since the mid-exposure of the last accepted pose.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct BlindWatch {
    distance: f64,
    until: Option<Time>,
}

impl BlindWatch {
    /// The car was seen at `capture`.
    pub(crate) const fn seen(&mut self, capture: Time) {
        self.distance = 0.0;
        self.until = Some(capture);
    }

    /// Time has gone on to `now`, at a speed of `pace` (m/s) at most.
    pub(crate) fn advance(&mut self, now: Time, pace: f64) {
        if let Some(until) = self.until {
            // A pace that is no number is no reason to believe in standstill.
            let pace = if pace.is_finite() { pace } else { f64::MAX };
            self.distance += pace * now.seconds_since(until);
            self.until = Some(now);
        }
    }

    /// The way so far, in m.
    pub(crate) const fn distance(&self) -> f64 {
        self.distance
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_way_counts_from_mid_exposure_and_a_pose_takes_it_back() {
        let at = |ms: u64| Time(ms * 1_000_000);
        let mut blind = BlindWatch::default();
        blind.advance(at(1_000), 1.0);
        assert_eq!(blind.distance(), 0.0, "never seen: others say so");
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
