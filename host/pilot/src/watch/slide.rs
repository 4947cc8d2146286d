//! Whether the estimated sideslip is one that a car on its tyres can have.

use libm::{atan, fabs, sin, tan};
use singletrack_control::{Estimate, EstimatorConfig, Limits};

/// What sliding tyres add to the sideslip of a car that rolls, rad: the law is far from singular
/// there.
const SLIDES: f64 = 0.6;
/// The speed across the car up to which the noise of an IMU may make it while the markers are lost, m/s:
/// a tick below counts a tenth.
const NOISE: f64 = 0.2;
/// By how many more tenths of ticks the sideslip may be beyond the limit than within.
const TENTHS: u32 = 20;

/// Watches the sideslip of every tick. One that is too large is an error of cameras or estimate: the
/// car keeps its command for it, and stops if it lasts.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct SlideWatch {
    beyond: bool,
    /// The ticks beyond it less those within, in tenths.
    more: u32,
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
        self.beyond = !fits;
        let across = estimate.map_or(0.0, |estimate| {
            fabs(estimate.speed * sin(estimate.sideslip))
        });
        self.more = if fits {
            self.more.saturating_sub(10)
        } else if across <= NOISE {
            self.more.saturating_add(1)
        } else {
            self.more.saturating_add(10)
        };
    }

    /// Whether the sideslip of this tick is too large to act on.
    pub(crate) const fn is_beyond(&self) -> bool {
        self.beyond
    }

    /// Whether it has been for too long, or too often.
    pub(crate) const fn is_exceeded(&self) -> bool {
        self.more > TENTHS
    }
}

#[cfg(test)]
mod tests {
    use singletrack_control::{Position, Time, VehicleParameters};

    use super::*;

    #[test]
    fn a_sideslip_that_no_car_has_counts_from_the_third_tick_also_with_others_between() {
        let mut tick = ticks(0.4);
        assert_eq!(tick(0.8), (false, false));
        assert_eq!(tick(-0.9), (true, false));
        assert_eq!(tick(0.9), (true, false));
        assert_eq!(tick(0.2), (false, false));
        assert_eq!(tick(f64::NAN), (true, false));
        assert_eq!(tick(1.2), (true, true));
        assert_eq!(tick(0.0), (false, false));
    }

    #[test]
    fn a_slow_car_whose_sideslip_is_noise_has_a_fifth_of_a_second() {
        let mut tick = ticks(0.15);
        for _ in 0..20 {
            assert_eq!(tick(1.0), (true, false));
        }
        assert_eq!(tick(1.0), (true, true));
    }

    /// Ticks of the paper's car at a speed, in m/s.
    fn ticks(speed: f64) -> impl FnMut(f64) -> (bool, bool) {
        let vehicle = VehicleParameters::paper();
        let car = EstimatorConfig::for_vehicle(&vehicle);
        let limits = Limits {
            max_steering: 0.45,
            ..Limits::paper()
        };
        let mut watch = SlideWatch::default();
        move |sideslip: f64| {
            let estimate = Estimate {
                time: Time(0),
                position: Position::origin(),
                yaw: 0.0,
                yaw_rate: 0.0,
                sideslip,
                speed,
                pose_time: Time(0),
            };
            watch.tick(Some(&estimate), &car, &limits);
            (watch.is_beyond(), watch.is_exceeded())
        }
    }
}
