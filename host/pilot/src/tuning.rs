//! Live tuning: gains and p of a pilot that runs.

use singletrack_control::Velocity;

/// The fastest change of p, in m/s: P moves at most so fast by itself.
pub const POINT_DISTANCE_RATE: f64 = 0.05;

/// New values of what can be tuned; a value that is left out stays.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Tuning {
    /// The gains of the proportional loop along x and y, per second. They act at once.
    pub gain: Option<Velocity>,
    /// The distance p, in m. The pilot goes there with [`POINT_DISTANCE_RATE`].
    pub point_distance: Option<f64>,
}

impl Tuning {
    /// These values, and those of `earlier` where this one has none.
    #[must_use]
    pub fn or(self, earlier: Self) -> Self {
        Self {
            gain: self.gain.or(earlier.gain),
            point_distance: self.point_distance.or(earlier.point_distance),
        }
    }
}

/// Within which bounds values may be tuned, both ends included: `[least, most]`.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct TuningBounds {
    /// Bounds of each gain, per second; none if gains may not be tuned.
    pub gain: Option<[f64; 2]>,
    /// Bounds of p, in m; none if p may not be tuned. A governor reckons ahead with the p of its
    /// configuration: with one, this must be none.
    pub point_distance: Option<[f64; 2]>,
}

impl TuningBounds {
    /// Whether every value of `tuning` may be tuned and is within its bounds; not so for a value
    /// that is not a number.
    pub fn allow(&self, tuning: &Tuning) -> bool {
        let within = |bounds: Option<[f64; 2]>, value: f64| {
            bounds.is_some_and(|[least, most]| (least..=most).contains(&value))
        };
        let gain = tuning
            .gain
            .is_none_or(|gain| gain.iter().all(|gain| within(self.gain, *gain)));
        let point_distance = tuning.point_distance;
        gain && point_distance.is_none_or(|value| within(self.point_distance, value))
    }
}

/// The values in force, where tuning is enabled.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tuned {
    /// The gains of the proportional loop, per second; none for another loop.
    pub gain: Option<Velocity>,
    /// The distance p that the law uses now, in m.
    pub point_distance: f64,
    /// Where p goes to, in m.
    pub wanted_point_distance: f64,
}

impl Tuned {
    /// Whether the values of `tuning` are in force already, or on the way.
    pub fn has(&self, tuning: &Tuning) -> bool {
        tuning.gain.is_none_or(|gain| self.gain == Some(gain))
            && tuning
                .point_distance
                .is_none_or(|distance| self.wanted_point_distance == distance)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_numbers_within_bounds_are_allowed_and_only_what_has_bounds() {
        let bounds = TuningBounds {
            gain: Some([0.5, 4.0]),
            point_distance: None,
        };
        let gains = |x, y| Tuning {
            gain: Some(Velocity::new(x, y)),
            point_distance: None,
        };
        assert!(bounds.allow(&Tuning::default()));
        assert!(bounds.allow(&gains(0.5, 4.0)));
        for (x, y) in [
            (0.49, 1.0),
            (1.0, 4.01),
            (f64::NAN, 1.0),
            (1.0, f64::INFINITY),
        ] {
            assert!(!bounds.allow(&gains(x, y)), "{x} {y}");
        }
        let distance = Tuning {
            gain: None,
            point_distance: Some(0.35),
        };
        assert!(!bounds.allow(&distance));
        assert!(!bounds.allow(&distance.or(gains(1.0, 1.0))));
    }

    #[test]
    fn a_later_tuning_keeps_what_it_leaves_out() {
        let earlier = Tuning {
            gain: Some(Velocity::new(1.0, 1.0)),
            point_distance: Some(0.3),
        };
        let later = Tuning {
            gain: Some(Velocity::new(2.0, 2.0)),
            point_distance: None,
        };
        assert_eq!(
            later.or(earlier),
            Tuning {
                gain: later.gain,
                point_distance: Some(0.3)
            }
        );
    }
}
