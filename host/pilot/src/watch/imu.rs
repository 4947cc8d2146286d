//! Plausibility and stillness of the inertial samples.

use libm::{fabs, hypot};
use singletrack_control::InertialSample;

use super::{config::WatchConfig, count};

/// Whether the inertial samples are plausible.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ImuVerdict {
    /// Within range and changing.
    #[default]
    Good,
    /// Too many samples in a row, or the gyro bias, are out of range.
    Implausible,
    /// Samples repeat to the last bit. A working sensor has noise.
    Stuck,
}

/// Counts implausible, equal and still inertial samples in a row.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct ImuWatch {
    last: Option<InertialSample>,
    impossible: u32,
    equal: u32,
    still: u32,
}

/// The number of still samples in a row after which the car is still: 0.2 s at 100 Hz.
const STILL_SAMPLES: u32 = 20;

impl ImuWatch {
    /// A new sample. Below both limits, for yaw rate (rad/s) and acceleration (m/s²), it
    /// counts as still.
    pub(crate) fn handle(
        &mut self,
        sample: &InertialSample,
        config: &WatchConfig,
        (still_yaw_rate, still_acceleration): (f64, f64),
    ) {
        count(&mut self.impossible, !config.is_possible(sample));
        let equal = self.last.is_some_and(|last| {
            last.yaw_rate == sample.yaw_rate
                && last.forward_acceleration == sample.forward_acceleration
                && last.left_acceleration == sample.left_acceleration
        });
        count(&mut self.equal, equal);
        self.last = Some(*sample);
        // What is not possible says nothing of the car's motion either.
        if !config.is_possible(sample) {
            return;
        }
        let acceleration = hypot(sample.forward_acceleration, sample.left_acceleration);
        let still = fabs(sample.yaw_rate) < still_yaw_rate && acceleration < still_acceleration;
        count(&mut self.still, still);
    }

    /// The verdict on the samples so far and the estimated gyro bias (rad/s).
    pub(crate) fn verdict(&self, gyro_bias: f64, config: &WatchConfig) -> ImuVerdict {
        if config.stuck_samples > 0 && self.equal >= config.stuck_samples {
            ImuVerdict::Stuck
        } else if self.impossible >= config.implausible_samples
            || fabs(gyro_bias) > config.max_gyro_bias
        {
            ImuVerdict::Implausible
        } else {
            ImuVerdict::Good
        }
    }

    /// Whether the last [`STILL_SAMPLES`] samples were still.
    pub(crate) const fn is_still(&self) -> bool {
        self.still >= STILL_SAMPLES
    }
}

#[cfg(test)]
mod tests {
    use singletrack_control::Time;

    use super::*;

    fn sample(yaw_rate: f64, forward_acceleration: f64) -> InertialSample {
        InertialSample {
            time: Time(0),
            yaw_rate,
            forward_acceleration,
            left_acceleration: 0.0,
        }
    }

    fn after(samples: impl IntoIterator<Item = InertialSample>) -> ImuWatch {
        let mut watch = ImuWatch::default();
        for sample in samples {
            watch.handle(&sample, &WatchConfig::paper(), (0.1, 1.0));
        }
        watch
    }

    fn verdict(samples: impl IntoIterator<Item = InertialSample>) -> ImuVerdict {
        after(samples).verdict(0.0, &WatchConfig::paper())
    }

    #[test]
    fn four_impossible_samples_are_tolerated_and_five_in_a_row_are_not() {
        for impossible in [
            sample(10.1, 0.0),
            sample(-10.1, 0.1),
            sample(0.0, 35.1),
            sample(f64::NAN, 0.0),
            sample(0.0, f64::INFINITY),
        ] {
            let good = sample(9.9, 34.9);
            assert_eq!(verdict([impossible; 4]), ImuVerdict::Good);
            assert_eq!(verdict([impossible; 5]), ImuVerdict::Implausible);
            let mixed = (0..40).map(|i| if i % 5 == 4 { good } else { impossible });
            assert_eq!(verdict(mixed), ImuVerdict::Good);
        }
    }

    #[test]
    fn a_gyro_bias_beyond_the_limit_is_implausible() {
        let watch = after([]);
        for (bias, expected) in [
            (0.2, ImuVerdict::Good),
            (-0.2, ImuVerdict::Good),
            (0.201, ImuVerdict::Implausible),
            (-0.201, ImuVerdict::Implausible),
        ] {
            assert_eq!(watch.verdict(bias, &WatchConfig::paper()), expected);
        }
    }

    #[test]
    fn samples_that_repeat_to_the_last_bit_are_stuck() {
        // The first sample is not a repetition.
        assert_eq!(verdict([sample(0.1, 0.2); 25]), ImuVerdict::Good);
        assert_eq!(verdict([sample(0.1, 0.2); 26]), ImuVerdict::Stuck);
        let off = WatchConfig {
            stuck_samples: 0,
            ..WatchConfig::paper()
        };
        assert_eq!(
            after([sample(0.1, 0.2); 99]).verdict(0.0, &off),
            ImuVerdict::Good
        );
        for differing in [
            |i: u32| sample(f64::from(i % 2) * 1e-3, 0.2),
            |i: u32| sample(0.1, f64::from(i % 2) * 1e-3),
            |i: u32| InertialSample {
                left_acceleration: f64::from(i % 2) * 1e-3,
                ..sample(0.1, 0.2)
            },
        ] {
            assert_eq!(verdict((0..100).map(differing)), ImuVerdict::Good);
        }
    }

    #[test]
    fn it_is_still_after_twenty_samples_without_movement() {
        let still = |count| after(std::vec![sample(0.05, -0.5); count]).is_still();
        assert!(!still(19) && still(20));
        let then = |last| {
            let mut samples = std::vec![sample(0.0, 0.0); 100];
            samples.push(last);
            after(samples).is_still()
        };
        assert!(!then(sample(0.1, 0.0)) && !then(sample(0.0, 1.0)));
        // No car can move like this: five of them in a row make the sensor implausible.
        assert!(then(sample(f64::NAN, 0.0)) && then(sample(32.768, 0.0)));
    }
}
