//! Whether motor pulses and cameras tell the same speed.

use libm::fabs;

use super::WatchConfig;
use singletrack_control::{Position, Time, direction};

/// Compares the two over spans of some tenths of a second.
///
/// The estimator can't tell: it fuses both. A pulse sensor that counts double
/// makes the board drive at half the speed; one that misses pulses at more than
/// was asked for.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct SpeedWatch {
    span: Option<Span>,
    /// Spans in a row that did not match.
    mismatches: u32,
    /// Ticks in a row that were too fast.
    too_fast: u32,
}

/// From one pose on.
#[derive(Clone, Copy, Debug)]
struct Span {
    start: Time,
    position: Position,
    /// The pose that came last.
    newest: Time,
    /// Sum of the motor's speeds, and their number.
    motor_speed: f64,
    samples: u32,
}

/// How long a span is, s.
const SPAN: f64 = 0.2;
/// A gap between poses beyond this ends the span: the way between is not known.
const GAP: f64 = 0.1;
/// So many spans in a row make a mismatch.
const MISMATCHES: u32 = 2;
/// So many ticks in a row are too fast.
const TOO_FAST: u32 = 5;

impl SpeedWatch {
    /// The motor's speed by its pulses, in m/s.
    pub(crate) fn motor(&mut self, speed: f64) {
        if let Some(span) = &mut self.span {
            span.motor_speed += speed;
            span.samples += 1;
        }
    }

    /// An accepted pose of the centre of mass.
    pub(crate) fn pose(&mut self, time: Time, position: Position, yaw: f64, config: &WatchConfig) {
        let fresh = Span {
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
            let told = span.motor_speed / f64::from(span.samples);
            let allowed =
                config.speed_margin + config.speed_ratio * f64::max(fabs(seen), fabs(told));
            // False for what is no number, too.
            self.mismatches = if fabs(seen - told) <= allowed {
                0
            } else {
                self.mismatches.saturating_add(1)
            };
        }
        self.span = Some(fresh);
    }

    /// A tick with the speed believed and the highest allowed, in m/s.
    pub(crate) fn tick(&mut self, speed: f64, max_speed: f64, config: &WatchConfig) {
        self.too_fast = if fabs(speed) > max_speed + config.overspeed_margin {
            self.too_fast.saturating_add(1)
        } else {
            0
        };
    }

    /// Forgets what a drive before has shown.
    pub(crate) const fn reset(&mut self) {
        self.span = None;
        self.mismatches = 0;
        self.too_fast = 0;
    }

    /// Whether the two tell different speeds.
    pub(crate) const fn is_mismatched(&self) -> bool {
        self.mismatches >= MISMATCHES
    }

    /// Whether the car is much faster than it may be.
    pub(crate) const fn is_overspeed(&self) -> bool {
        self.too_fast >= TOO_FAST
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A second of a car that really moves at `seen` while its motor tells `told`.
    fn after_a_second(seen: f64, told: f64) -> SpeedWatch {
        let mut watch = SpeedWatch::default();
        for tick in 0..100_u64 {
            watch.motor(told);
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
    fn doubled_missing_and_reversed_pulses_are_noticed() {
        for (seen, told) in [
            (0.4, 0.8),
            (0.2, 0.4),
            (0.8, 0.4),
            (0.4, 0.0),
            (-0.3, 0.3),
            (0.0, 0.3),
            (0.4, f64::NAN),
        ] {
            assert!(after_a_second(seen, told).is_mismatched(), "{seen} {told}");
        }
    }

    #[test]
    fn what_slip_tyre_and_delay_explain_is_not() {
        for (seen, told) in [
            (0.0, 0.0),
            (0.4, 0.45),
            (0.45, 0.4),
            (1.5, 1.2),
            (-0.3, -0.35),
        ] {
            assert!(!after_a_second(seen, told).is_mismatched(), "{seen} {told}");
        }
    }

    #[test]
    fn one_span_is_not_enough_and_one_that_matches_clears() {
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
        assert!(!mismatched[39] && mismatched[41] && !mismatched[99]);
    }

    #[test]
    fn a_gap_between_poses_is_no_span() {
        // Beyond 100 ms nothing is known of the way between.
        for (apart_ms, mismatched) in [(100, true), (101, false), (110, false)] {
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
    fn cameras_alone_contradict_nobody() {
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
    fn a_reset_forgets_everything_that_was_noticed() {
        let mut watch = after_a_second(0.4, 0.8);
        for _ in 0..5 {
            watch.tick(2.0, 1.5, &WatchConfig::paper());
        }
        assert!(watch.is_mismatched() && watch.is_overspeed());
        watch.reset();
        assert!(!watch.is_mismatched() && !watch.is_overspeed());
    }

    #[test]
    fn a_car_that_stays_too_fast_is_noticed_in_either_direction() {
        for speed in [2.0, -2.0] {
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
    fn a_car_at_the_margin_is_not_too_fast() {
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
}
