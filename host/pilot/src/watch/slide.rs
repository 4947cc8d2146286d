//! Whether the estimated sideslip is one that a car on its tyres can have.

use libm::{atan, fabs, tan};
use singletrack_control::{Estimate, EstimatorConfig, Limits};

/// What sliding tyres add to the sideslip of a car that rolls, rad: the law is far from singular
/// there.
const SLIDES: f64 = 0.6;
/// The number of ticks in a row beyond it that no estimate recovers from in time.
const TICKS: u32 = 3;

/// Watches the sideslip of every tick. One that is too large is an error of cameras or estimate: the
/// car keeps its command for it, and stops if it lasts.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct SlideWatch {
    beyond: u32,
}

impl SlideWatch {
    /// A tick of a car with these parameters and limits.
    pub(crate) fn tick(
        &mut self,
        estimate: Option<&Estimate>,
        car: &EstimatorConfig,
        limits: &Limits,
    ) {
        let rolls = atan(car.rear_axle_distance / car.wheelbase * tan(limits.max_steering));
        // A NaN is beyond it.
        let fits = estimate.is_none_or(|estimate| fabs(estimate.sideslip) <= rolls + SLIDES);
        self.beyond = if fits {
            0
        } else {
            self.beyond.saturating_add(1)
        };
    }

    /// Whether the sideslip of this tick is too large to act on.
    pub(crate) const fn is_beyond(&self) -> bool {
        self.beyond > 0
    }

    /// Whether it has been for too long.
    pub(crate) const fn is_exceeded(&self) -> bool {
        self.beyond >= TICKS
    }
}

#[cfg(test)]
mod tests {
    use singletrack_control::{Position, Time, VehicleParameters};

    use super::*;

    #[test]
    fn a_sideslip_that_no_car_has_counts_from_the_third_tick_and_is_forgotten_at_once() {
        let vehicle = VehicleParameters::paper();
        let car = EstimatorConfig::for_vehicle(&vehicle);
        let limits = Limits {
            max_steering: 0.45,
            ..Limits::paper()
        };
        let mut watch = SlideWatch::default();
        let mut tick = |sideslip: f64| {
            let estimate = Estimate {
                time: Time(0),
                position: Position::origin(),
                yaw: 0.0,
                yaw_rate: 0.0,
                sideslip,
                speed: 0.4,
                pose_time: Time(0),
            };
            watch.tick(Some(&estimate), &car, &limits);
            (watch.is_beyond(), watch.is_exceeded())
        };
        assert_eq!(tick(0.8), (false, false));
        assert_eq!(tick(-0.9), (true, false));
        assert_eq!(tick(0.9), (true, false));
        assert_eq!(tick(0.2), (false, false));
        for _ in 0..2 {
            assert_eq!(tick(f64::NAN), (true, false));
        }
        assert_eq!(tick(1.2), (true, true));
        assert_eq!(tick(0.0), (false, false));
    }
}
