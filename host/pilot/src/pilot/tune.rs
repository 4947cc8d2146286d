//! Applies live tuning.

use libm::{copysign, fabs};

use super::{Pilot, PilotConfig};
use crate::tuning::{POINT_DISTANCE_RATE, Tuned, Tuning};

impl Pilot {
    /// Takes over new values. Whoever sent them has checked them; values that the configuration
    /// in force does not allow have no effect, all together.
    pub(super) fn tune(&mut self, tuning: &Tuning) {
        let bounds = self.config.tuning.as_ref();
        if !bounds.is_some_and(|bounds| bounds.allow(tuning)) {
            return;
        }
        if let Some(gain) = tuning.gain {
            self.tracking.set_gain(gain);
        }
        if let Some(distance) = tuning.point_distance {
            self.wanted_point_distance = distance;
        }
    }

    /// A tick begins: p goes on to where it was tuned.
    pub(super) fn slew_point_distance(&mut self) {
        let (now, wanted) = (self.law.law().point_distance(), self.wanted_point_distance);
        if now == wanted {
            return;
        }
        let most = POINT_DISTANCE_RATE * self.config.period;
        let next = if fabs(wanted - now) <= most {
            wanted
        } else {
            now + copysign(most, wanted - now)
        };
        self.set_point_distance(next);
    }

    fn set_point_distance(&mut self, distance: f64) {
        // It is between two values that make a law.
        if let Ok(law) = self.law.law().with_point_distance(distance) {
            self.law.set_law(law);
        }
    }

    /// The values in force; none where nothing can be tuned.
    #[must_use]
    pub fn tuned(&self) -> Option<Tuned> {
        self.config.tuning.as_ref()?;
        Some(Tuned {
            gain: self.tracking.gain(),
            point_distance: self.law.law().point_distance(),
            wanted_point_distance: self.wanted_point_distance,
        })
    }

    /// The tuned values that another configuration leaves as they are.
    pub(super) fn kept_tuning(&self, next: &PilotConfig) -> Tuning {
        let (Some(old), Some(new)) = (&self.config.tuning, &next.tuning) else {
            return Tuning::default();
        };
        let same_gain = old.gain == new.gain && self.config.tracking.gain() == next.tracking.gain();
        let same_distance = old.point_distance == new.point_distance
            && self.config.law.point_distance() == next.law.point_distance();
        Tuning {
            gain: self.tracking.gain().filter(|_| same_gain),
            point_distance: same_distance.then_some(self.wanted_point_distance),
        }
    }

    /// Takes over what [`kept_tuning`](Self::kept_tuning) left; p is there at once, because the car
    /// stands.
    pub(super) fn keep_tuning(&mut self, kept: &Tuning) {
        self.tune(kept);
        self.set_point_distance(self.wanted_point_distance);
    }
}
