//! Comparison of the speeds from motor pulses and cameras, and overspeed.

use libm::fabs;
use singletrack_control::{Position, Time, direction};

use super::{WatchConfig, count};

/// Compares the two speeds over spans of [`SPAN`].
///
/// The estimator fuses both and so can't detect a difference. With a pulse sensor that
/// counts double, the board drives at half the commanded speed; with one that misses
/// pulses, faster than commanded.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct SpeedWatch {
    span: Option<SpeedSpan>,
    /// Spans in a row that did not match.
    mismatches: u32,
    /// The speed of the motor over that of the cameras in the last span that did not match.
    ratio: f64,
    /// Ticks in a row with too high a speed.
    too_fast: u32,
}

/// A span of poses, from the one at `start`.
#[derive(Clone, Copy, Debug)]
struct SpeedSpan {
    start: Time,
    position: Position,
    /// The time of the latest pose.
    newest: Time,
    /// Sum of the speeds from the motor, in m/s, and their number.
    motor_speed: f64,
    samples: u32,
}

/// The shortest span, s.
const SPAN: f64 = 0.2;
/// The longest gap between two poses of a span, s, as for the steps: beyond it the path between
/// them is unknown, and a new span begins.
const GAP: f64 = 0.12;
/// The number of differing spans in a row that make a mismatch.
const MISMATCHES: u32 = 2;
/// The number of fast ticks in a row that make an overspeed.
const TOO_FAST: u32 = 5;
/// A motor that shows less than this share of the cameras' speed has no sensor.
const NO_SENSOR: f64 = 0.25;

impl SpeedWatch {
    /// A speed of the rear axle from the motor pulses, in m/s.
    pub(crate) fn motor(&mut self, speed: f64) {
        if let Some(span) = &mut self.span {
            span.motor_speed += speed;
            span.samples += 1;
        }
    }

    /// An accepted pose: position of the centre of mass in m, yaw in rad. The camera
    /// speed of a span is the displacement along the yaw over its duration.
    pub(crate) fn pose(&mut self, time: Time, position: Position, yaw: f64, config: &WatchConfig) {
        let fresh = SpeedSpan {
            start: time,
            position,
            newest: time,
            motor_speed: 0.0,
            samples: 0,
        };
        let Some(span) = &mut self.span else {
            self.span = Some(fresh);
            return;
        };
        if time.seconds_since(span.newest) > GAP {
            *span = fresh;
            return;
        }
        span.newest = time;
        let duration = time.seconds_since(span.start);
        if duration < SPAN {
            return;
        }
        if span.samples > 0 {
            let seen = (position - span.position).dot(&direction(yaw)) / duration;
            let measured = span.motor_speed / f64::from(span.samples);
            let allowed = config.speed_margin
                + config.pulse_distance / SPAN
                + config.speed_ratio * f64::max(fabs(seen), fabs(measured));
            // A NaN counts as a mismatch: the comparison is false.
            let fits = fabs(seen - measured) <= allowed;
            count(&mut self.mismatches, !fits);
            if !fits {
                self.ratio = fabs(measured) / fabs(seen);
            }
        }
        self.span = Some(fresh);
    }

    /// A tick with the estimated speed and the speed limit, in m/s.
    pub(crate) fn tick(&mut self, speed: f64, max_speed: f64, config: &WatchConfig) {
        // A NaN is too fast: the comparison is false.
        let fits = fabs(speed) <= max_speed + config.overspeed_margin;
        count(&mut self.too_fast, !fits);
    }

    /// Whether the speeds differ.
    pub(crate) const fn is_mismatched(&self) -> bool {
        self.mismatches >= MISMATCHES
    }

    /// What the motor shows of the cameras' speed if they differ and it shows less, else 1. A
    /// motor that shows almost nothing has no sensor, or its wheels stand: that says nothing of
    /// the cameras.
    pub(crate) fn motor_share(&self) -> f64 {
        if self.is_mismatched() && (NO_SENSOR..1.0).contains(&self.ratio) {
            self.ratio
        } else {
            1.0
        }
    }

    /// Whether the car exceeds its limit by more than the margin.
    pub(crate) const fn is_overspeed(&self) -> bool {
        self.too_fast >= TOO_FAST
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// One second of a car that moves at `seen` while its pulses show `counted`, in m/s.
    fn after_a_second(seen: f64, counted: f64) -> SpeedWatch {
        let mut watch = SpeedWatch::default();
        for tick in 0..100_u64 {
            watch.motor(counted);
            let position = Position::new(0.0, seen * 0.01 * tick as f64);
            watch.pose(
                Time(tick * 10_000_000),
                position,
                core::f64::consts::FRAC_PI_2,
                &WatchConfig::paper(),
            );
        }
        watch
    }

    #[test]
    fn doubled_missing_and_reversed_pulses_are_a_mismatch() {
        for (seen, counted) in [
            (0.4, 0.8),
            (0.2, 0.4),
            (0.8, 0.4),
            (0.4, 0.0),
            (-0.3, 0.3),
            (0.0, 0.3),
            (0.4, f64::NAN),
        ] {
            assert!(
                after_a_second(seen, counted).is_mismatched(),
                "{seen} {counted}"
            );
        }
    }

    #[test]
    fn differences_from_slip_tyre_and_delay_are_no_mismatch() {
        for (seen, counted) in [
            (0.0, 0.0),
            (0.4, 0.45),
            (0.45, 0.4),
            (1.5, 1.2),
            (-0.3, -0.35),
        ] {
            assert!(
                !after_a_second(seen, counted).is_mismatched(),
                "{seen} {counted}"
            );
        }
    }

    #[test]
    fn a_mismatch_needs_two_spans_and_one_matching_span_clears_it() {
        let mut watch = SpeedWatch::default();
        let mut mismatched = std::vec::Vec::new();
        for tick in 0..100_u64 {
            watch.motor(if tick < 50 { 0.5 } else { 0.0 });
            watch.pose(
                Time(tick * 10_000_000),
                Position::origin(),
                0.0,
                &WatchConfig::paper(),
            );
            mismatched.push(watch.is_mismatched());
        }
        // Spans of 0.2 s: from the first pose to those of the ticks 20 and 40.
        assert!(!mismatched[39] && mismatched[40] && !mismatched[99]);
    }

    #[test]
    fn a_gap_between_poses_begins_a_new_span() {
        // Beyond 120 ms the path between two poses is unknown.
        for (apart_ms, mismatched) in [(120, true), (121, false), (130, false)] {
            let mut watch = SpeedWatch::default();
            for pose in 0..20_u64 {
                watch.motor(1.0);
                watch.pose(
                    Time(pose * apart_ms * 1_000_000),
                    Position::origin(),
                    0.0,
                    &WatchConfig::paper(),
                );
            }
            assert_eq!(watch.is_mismatched(), mismatched, "{apart_ms} ms");
        }
    }

    #[test]
    fn poses_without_motor_samples_are_no_mismatch() {
        let mut watch = SpeedWatch::default();
        for tick in 0..100_u64 {
            watch.pose(
                Time(tick * 10_000_000),
                Position::origin(),
                0.0,
                &WatchConfig::paper(),
            );
        }
        assert!(!watch.is_mismatched());
    }

    #[test]
    fn a_reset_clears_mismatch_and_overspeed() {
        let mut watch = after_a_second(0.4, 0.8);
        for _ in 0..5 {
            watch.tick(2.0, 1.5, &WatchConfig::paper());
        }
        assert!(watch.is_mismatched() && watch.is_overspeed());
        watch = SpeedWatch::default();
        assert!(!watch.is_mismatched() && !watch.is_overspeed());
    }

    #[test]
    fn five_fast_ticks_are_an_overspeed_in_either_direction_and_so_is_a_nan() {
        for speed in [2.0, -2.0, f64::NAN] {
            let mut watch = SpeedWatch::default();
            for _ in 0..4 {
                watch.tick(speed, 1.5, &WatchConfig::paper());
            }
            assert!(!watch.is_overspeed());
            watch.tick(speed, 1.5, &WatchConfig::paper());
            assert!(watch.is_overspeed());
            watch.tick(1.8, 1.5, &WatchConfig::paper());
            assert!(!watch.is_overspeed());
        }
    }

    #[test]
    fn a_car_at_the_margin_is_no_overspeed() {
        let config = WatchConfig {
            overspeed_margin: 0.5,
            ..WatchConfig::paper()
        };
        let mut watch = SpeedWatch::default();
        for _ in 0..10 {
            watch.tick(2.0, 1.5, &config);
        }
        assert!(!watch.is_overspeed());
    }

    #[test]
    fn margin_and_share_and_a_pulse_in_a_span_are_allowed() {
        // 0.05 m/s, 0.003 m in 0.2 s, and a fifth of the larger speed.
        for (seen, counted, mismatched) in [
            (0.0, 0.081, false),
            (0.0, 0.0815, true),
            (0.4, 0.256, false),
            (0.4, 0.254, true),
            (0.256, 0.4, false),
            (0.254, 0.4, true),
        ] {
            assert_eq!(
                after_a_second(seen, counted).is_mismatched(),
                mismatched,
                "{seen} {counted}"
            );
        }
    }

    #[test]
    fn a_motor_that_shows_less_than_the_cameras_has_its_share_if_it_has_a_sensor() {
        for (seen, counted, share) in [
            (1.0, 1.0, 1.0),
            // Within the tolerance.
            (1.0, 0.8, 1.0),
            (1.0, 0.6, 0.6),
            (1.0, -0.6, 0.6),
            (1.0, 0.26, 0.26),
            (1.0, 0.24, 1.0),
            (1.0, 0.0, 1.0),
            (0.6, 1.0, 1.0),
            (1.0, f64::NAN, 1.0),
        ] {
            let found = after_a_second(seen, counted).motor_share();
            assert!((found - share).abs() < 1e-9, "{seen} {counted}: {found}");
        }
    }
}
