//! What is plotted of a record: samples, the truth of a simulation, and when the cameras lost the
//! markers.

use singletrack_pilot::Mode;
use singletrack_statistics::Distribution;

/// Ground truth at one time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TruthSample {
    /// Since the first driving tick, in s.
    pub time: f64,
    /// The true P, world frame, in m.
    pub point: [f64; 2],
    /// Steering angle of the front wheels, in rad.
    pub steering: f64,
    /// Speed of G, in m/s.
    pub speed: f64,
    /// Sideslip of G, in rad.
    pub sideslip: f64,
    /// Yaw rate, in rad/s.
    pub yaw_rate: f64,
}

/// Inputs and outputs of a tick.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TickSample {
    /// Since the first driving tick, in s.
    pub time: f64,
    /// The mode after the tick.
    pub mode: Mode,
    /// Whether no new pose came since the tick before.
    pub held: bool,
    /// G as estimated, world frame, in m.
    pub place: [f64; 2],
    /// Yaw as estimated, in rad.
    pub yaw: f64,
    /// P as estimated, world frame, in m.
    pub point: [f64; 2],
    /// Where P should be, in m; not a number for a reference that is a velocity alone.
    pub reference: [f64; 2],
    /// Where P should be, in m: the reference, or the integral of one that is a velocity alone.
    pub nominal: [f64; 2],
    /// The velocity commanded of P, in m/s.
    pub point_velocity: [f64; 2],
    /// Speed of G that was asked for, after limits, in m/s.
    pub commanded_speed: f64,
    /// Steering angle that was asked for, after limits, in rad.
    pub steering: f64,
    /// Speed of G as estimated, in m/s.
    pub speed: f64,
    /// Sideslip as estimated, in rad.
    pub sideslip: f64,
    /// Yaw rate as estimated, in rad/s.
    pub yaw_rate: f64,
    /// How late the tick began, in s.
    pub lateness: f64,
    /// From the mid-exposure of a new pose to the command that rests on it, in s.
    pub latency: f64,
    /// Points of the control grid skipped just before it.
    pub skipped: u32,
    /// Frames since the tick before that had no valid pose.
    pub poses_missing: u32,
}

impl TickSample {
    /// How far P is from where it should be, in m.
    pub fn error(&self) -> f64 {
        distance(self.point, self.nominal)
    }
}

/// Measurements of the board.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BoardPoint {
    /// Since the first driving tick, in s.
    pub time: f64,
    /// Speed of the rear axle by the motor's pulses, in m/s.
    pub motor_speed: f64,
    /// Yaw rate by the gyro, in rad/s; not a number without a new sample.
    pub yaw_rate: f64,
}

/// What is plotted over its time.
pub(super) trait Sample {
    /// Since the first driving tick, in s.
    fn time(&self) -> f64;
}

impl Sample for TickSample {
    fn time(&self) -> f64 {
        self.time
    }
}

impl Sample for BoardPoint {
    fn time(&self) -> f64 {
        self.time
    }
}

impl Sample for TruthSample {
    fn time(&self) -> f64 {
        self.time
    }
}

/// From one point to another; not a number if one of them is none.
pub(super) fn distance(one: [f64; 2], other: [f64; 2]) -> f64 {
    let ([x, y], [other_x, other_y]) = (one, other);
    (x - other_x).hypot(y - other_y)
}

/// How many usual intervals between new poses may pass: one tick without a pose is
/// the beat of two clocks, two are a loss.
const INTERVALS: f64 = 2.5;
/// The same for ticks that had no word of the cameras either: frames that are merely
/// late are not a loss.
const SILENT_INTERVALS: f64 = 5.5;

/// The spans in which no new pose came for longer than usual, because frames had none
/// or because there were no frames: from the first tick
/// that had to hold the last one until the one with the next, in s.
///
/// The usual interval is the median time between ticks with a new pose, so that cameras
/// slower than the control loop are not a loss.
pub(super) fn lost_markers(ticks: &[TickSample]) -> Vec<[f64; 2]> {
    let fresh: Vec<f64> = ticks
        .iter()
        .filter(|tick| !tick.held)
        .map(|tick| tick.time)
        .collect();
    let intervals = Distribution::of(fresh.windows(2).map(|pair| pair[1] - pair[0]));
    let usual = intervals.sorted().get(intervals.count() / 2).copied();

    let mut spans = Vec::new();
    for run in ticks.chunk_by(|one, other| one.held == other.held) {
        let (Some(first), Some(last)) = (run.first(), run.last()) else {
            continue;
        };
        if !first.held {
            continue;
        }
        let before = fresh.partition_point(|time| *time < first.time);
        let seen = before
            .checked_sub(1)
            .and_then(|index| fresh.get(index))
            .copied();
        let until = fresh.get(before).copied().unwrap_or(last.time);
        // At the start of a drive the last pose is at most a tick older.
        let blind = until - seen.unwrap_or(first.time);
        let told = run.iter().any(|tick| tick.poses_missing > 0);
        let intervals = if told { INTERVALS } else { SILENT_INTERVALS };
        if usual.is_none_or(|usual| blind > intervals * usual) && until > first.time {
            spans.push([first.time, until]);
        }
    }
    spans
}

#[cfg(test)]
mod tests {
    use singletrack_pilot::Mode;

    use super::*;

    /// Ticks 10 ms apart: with a new pose, with a frame that has none (x), or with no
    /// frame at all (-).
    fn ticks(pattern: &str) -> Vec<TickSample> {
        pattern
            .chars()
            .zip(0_u32..)
            .map(|(kind, index)| TickSample {
                time: f64::from(index) / 100.0,
                mode: Mode::Driving,
                held: kind != '.',
                place: [0.0; 2],
                yaw: 0.0,
                point: [0.0; 2],
                reference: [0.0; 2],
                nominal: [0.0; 2],
                point_velocity: [0.0; 2],
                commanded_speed: 0.0,
                steering: 0.0,
                speed: 0.0,
                sideslip: 0.0,
                yaw_rate: 0.0,
                lateness: 0.0,
                latency: 0.0,
                skipped: 0,
                poses_missing: u32::from(kind == 'x'),
            })
            .collect()
    }

    #[test]
    fn a_single_held_tick_is_no_loss_and_two_are() {
        assert_eq!(lost_markers(&ticks(".....x.....x....")), [[0.0; 2]; 0]);
        assert_eq!(lost_markers(&ticks(".....xx.........")), [[0.05, 0.07]]);
    }

    #[test]
    fn frames_that_are_late_are_no_loss_and_silence_is() {
        assert_eq!(lost_markers(&ticks("......---........")), [[0.0; 2]; 0]);
        assert_eq!(lost_markers(&ticks("......-----......")), [[0.06, 0.11]]);
        assert_eq!(lost_markers(&ticks("......-x---......")), [[0.06, 0.11]]);
    }

    #[test]
    fn every_loss_has_its_own_span_up_to_the_end() {
        let spans = lost_markers(&ticks("....xxxx......xxx...xxx"));
        assert_eq!(spans, [[0.04, 0.08], [0.14, 0.17], [0.20, 0.22]]);
    }

    #[test]
    fn slow_cameras_are_not_a_loss_but_their_losses_are() {
        assert_eq!(lost_markers(&ticks(".xxx.xxx.xxx.xxx.xx")), [[0.0; 2]; 0]);
        assert_eq!(
            lost_markers(&ticks(".xxx.xxx.xxx.xxxxxxxxxxx.xxx.xxx")),
            [[0.13, 0.24]]
        );
    }

    #[test]
    fn a_drive_that_saw_nothing_is_one_loss() {
        assert_eq!(lost_markers(&ticks("xxxxx")), [[0.0, 0.04]]);
        assert_eq!(lost_markers(&[]), [[0.0; 2]; 0]);
    }
}
