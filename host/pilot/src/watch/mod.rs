//! Plausibility of the sensors, tick timing, and the distance since the last accepted pose.
//!
//! One monitor per kind of failure. A monitor is fed with samples or ticks and then
//! queried; it decides nothing. The supervisor turns its verdict into a reason.

mod attitude;
mod consistency;
mod imu;
mod proving;
mod roll_out;
mod speed;
mod steering;
mod steps;
mod stop;

use libm::{fabs, hypot};
use singletrack_control::{InertialSample, Time};

pub(crate) use attitude::{AttitudeWatch, PushWatch};
pub(crate) use consistency::{FrozenWatch, InnovationWatch, SideslipWatch, SlideWatch};
pub use imu::ImuVerdict;
pub(crate) use imu::{GyroWatch, ImuWatch, StartWatch};
pub use proving::{FIRST_METRE, FirstMetre};
pub(crate) use proving::{Proving, WAVE};
pub(crate) use speed::SpeedWatch;
pub(crate) use steering::SteeringWatch;
pub(crate) use steps::Steps;
pub(crate) use stop::{Speeds, StopLimits, StopWatch};

/// The limits of plausible sensors and of tick timing, in SI units.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WatchConfig {
    /// The largest plausible yaw rate, rad/s.
    pub max_yaw_rate: f64,
    /// The largest plausible acceleration, m/s².
    pub max_acceleration: f64,
    /// The largest plausible gyro bias, rad/s.
    pub max_gyro_bias: f64,
    /// The number of samples in a row out of range that make the IMU implausible.
    pub implausible_samples: u32,
    /// The number of repetitions of one sample that make the IMU stuck; 0 disables the
    /// check.
    pub stuck_samples: u32,
    /// Speeds from motor and cameras may differ by this, m/s, and by a motor pulse in a
    /// span...
    pub speed_margin: f64,
    /// ...plus this fraction of the larger one.
    pub speed_ratio: f64,
    /// The car may exceed its speed limit by this, m/s.
    pub overspeed_margin: f64,
    /// The way of a motor pulse, m: a speed is known after two of them.
    pub pulse_distance: f64,
    /// The time for which poses may repeat to the last bit, s; 0 disables the check.
    pub frozen_poses: f64,
    /// The largest tilt of the IMU before the car is armed, rad.
    pub max_tilt: f64,
    /// The largest difference of roll or pitch between IMU and cameras before the car is
    /// armed, rad.
    pub max_tilt_difference: f64,
    /// The height band of the rigid body's origin, m.
    pub height: [f64; 2],
    /// The largest angle between the motion of the rear axle and the yaw, rad.
    pub max_sideslip: f64,
    /// The turn of the car may differ from that of its steering by this share.
    pub steering_ratio: f64,
    /// The largest bias of the accelerometer, m/s².
    pub max_acceleration_bias: f64,
    /// The largest normalised innovation squared of the poses, as a mean over 0.5 s.
    pub max_innovation: f64,
    /// The largest bound on the error of the poses' mid-exposure, s.
    pub max_capture_uncertainty: f64,
    /// The longest time between two ticks, s.
    pub max_gap: f64,
    /// The number of ticks that may be missed in a second.
    pub max_missed: u32,
}

impl WatchConfig {
    /// Whether a car can turn and accelerate like this. A sample that is not possible is an error of
    /// the sensor or of its bus, which has no checksum: nothing may be computed from it.
    pub fn is_possible(&self, sample: &InertialSample) -> bool {
        let acceleration = hypot(sample.forward_acceleration, sample.left_acceleration);
        // NaN is not possible either: the comparison is false.
        fabs(sample.yaw_rate) <= self.max_yaw_rate && acceleration <= self.max_acceleration
    }

    /// For the paper's car.
    pub const fn paper() -> Self {
        Self {
            max_yaw_rate: 10.0,
            max_acceleration: 35.0,
            max_gyro_bias: 0.2,
            implausible_samples: 5,
            stuck_samples: 25,
            speed_margin: 0.05,
            speed_ratio: 0.2,
            overspeed_margin: 0.4,
            pulse_distance: 0.003,
            frozen_poses: 0.3,
            max_tilt: 0.15,
            max_tilt_difference: 0.15,
            height: [f64::NEG_INFINITY, f64::INFINITY],
            max_sideslip: 0.14,
            steering_ratio: 0.5,
            max_acceleration_bias: 2.5,
            max_innovation: 200.0,
            max_capture_uncertainty: 0.02,
            max_gap: 0.08,
            max_missed: 20,
        }
    }
}

/// Counts repetitions; restarts from zero.
pub(crate) const fn count(counter: &mut u32, again: bool) {
    *counter = if again { counter.saturating_add(1) } else { 0 };
}

/// Measures gaps and missed ticks from the times of the ticks alone.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct TickWatch {
    last: Option<Time>,
    /// The time between the last two ticks, s.
    gap: f64,
    /// Ticks missed, less `max_missed` for each second since.
    missed: f64,
}

impl TickWatch {
    /// A tick at `now`. Punctual ticks are one `period` (s) apart.
    pub(crate) fn tick(&mut self, now: Time, period: f64, config: &WatchConfig) {
        let Some(last) = self.last.replace(now) else {
            return;
        };
        self.gap = now.seconds_since(last);
        // A tick that is late by less than half a period counts as punctual.
        let missed = libm::floor(self.gap / period - 0.5).max(0.0);
        let limit = f64::from(config.max_missed);
        let forgiven = self.gap * limit;
        // The cap makes a pause of any length expire a second after it.
        self.missed = ((self.missed - forgiven).max(0.0) + missed).min(2.0 * limit);
    }

    /// Whether the last gap was longer than `max_gap`, or more than `max_missed` ticks
    /// were missed in about a second.
    pub(crate) fn is_late(&self, config: &WatchConfig) -> bool {
        self.gap > config.max_gap || self.missed > f64::from(config.max_missed)
    }
}

/// Integrates the farthest distance that the car may have gone since the mid-exposure
/// of the last accepted pose; zero before the first one.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct BlindWatch {
    /// In m.
    pub(crate) distance: f64,
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
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Whether the watch is late after each tick, for these intervals in ms.
    fn late(intervals: impl IntoIterator<Item = u64>) -> std::vec::Vec<bool> {
        let config = WatchConfig::paper();
        let mut watch = TickWatch::default();
        let mut now = Time(1_000_000_000);
        watch.tick(now, 0.01, &config);
        intervals
            .into_iter()
            .map(|interval| {
                now = Time(now.0 + interval * 1_000_000);
                watch.tick(now, 0.01, &config);
                watch.is_late(&config)
            })
            .collect()
    }

    #[test]
    fn one_long_gap_is_late_until_the_next_tick() {
        assert_eq!(
            late([10, 80, 10, 81, 10]),
            [false, false, false, true, false]
        );
    }

    #[test]
    fn a_long_pause_expires_a_second_later() {
        let late = late([5_000].into_iter().chain([10; 200]));
        let last = late.iter().rposition(|late| *late).unwrap();
        assert!((98..=101).contains(&last), "{last}");
    }

    #[test]
    fn the_allowed_number_of_ticks_may_be_missed_at_once() {
        let config = WatchConfig {
            max_gap: 1.0,
            ..WatchConfig::paper()
        };
        for (missed, late) in [(20, false), (21, true)] {
            let mut watch = TickWatch::default();
            watch.tick(Time(1_000_000_000), 0.01, &config);
            watch.tick(
                Time(1_000_000_000 + (missed + 1) * 10_000_000),
                0.01,
                &config,
            );
            assert_eq!(watch.is_late(&config), late, "{missed}");
        }
    }

    #[test]
    fn jitter_of_less_than_half_a_period_is_never_late() {
        assert!(!late((0..10_000).map(|i| if i % 2 == 0 { 6 } else { 14 })).contains(&true));
    }

    #[test]
    fn a_sixth_of_the_ticks_may_be_missed_and_half_may_not() {
        // 60 ms for 5 ticks: one sixth is missed, 16.7 per second.
        let sixth = (0..1_000).map(|i| if i % 5 == 0 { 20 } else { 10 });
        assert!(!late(sixth).contains(&true));
        let half = late([20; 200]);
        let first = half.iter().position(|late| *late).unwrap();
        // 50 missed per second, of which 20 expire: 20 after 0.67 s.
        assert!((32..=34).contains(&first), "{first}");
        assert!(half[first..].iter().all(|late| *late));
    }

    #[test]
    fn the_distance_counts_from_mid_exposure_and_a_pose_restarts_it() {
        let at = |ms: u64| Time(ms * 1_000_000);
        let mut blind = BlindWatch::default();
        blind.advance(at(1_000), 1.0);
        assert_eq!(blind.distance, 0.0, "no pose yet");
        blind.seen(at(990));
        blind.advance(at(1_000), 1.0);
        blind.advance(at(1_020), 2.0);
        assert!((blind.distance - 0.05).abs() < 1e-12);
        blind.seen(at(1_015));
        blind.advance(at(1_020), 2.0);
        assert!((blind.distance - 0.01).abs() < 1e-12);
        blind.advance(at(1_030), f64::NAN);
        assert!(blind.distance > 1e9);
    }
}
