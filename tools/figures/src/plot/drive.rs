//! The drives in a record: inputs and outputs of their ticks, in SI units, over
//! the time since the first driving tick.

use singletrack_control::statistics::Distribution;
use singletrack_control::{Estimate, Time};
use singletrack_pilot::{Event, Mode, Reason};
use singletrack_record::{ConfigurationRecord, Drops, Entry, Log, TickRecord, seconds_since};

/// The drives of a record.
#[derive(Clone, Debug, Default)]
pub struct Recording {
    /// The drives, in order.
    pub drives: Vec<Drive>,
    /// Whenever the mode or its reason changed.
    pub changes: Vec<Change>,
    /// The lines of the log.
    pub log: Vec<Log>,
    /// Configurations that came into force after the start.
    pub configurations: Vec<ConfigurationRecord>,
    /// The number of the newest in force; none for that of the start.
    configuration: Option<u32>,
    /// Ticks, driving or not.
    pub ticks: u64,
    /// Entries that did not reach the record.
    pub entries_dropped: u64,
}

/// Another mode, or another reason for it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Change {
    /// When, in ns of the host's monotonic clock.
    pub time_ns: u64,
    /// The mode from then on.
    pub mode: Mode,
    /// Why.
    pub reason: Option<Reason>,
}

/// One drive: from its first driving tick until the car stands, or the record ends.
#[derive(Clone, Debug, Default)]
pub struct Drive {
    /// The pilot's time of the first driving tick, in ns of the host's monotonic
    /// clock: the zero of all times below.
    pub start_ns: u64,
    /// The samples of its ticks, in order; never empty.
    pub ticks: Vec<TickSample>,
    /// What the board measured.
    pub board: Vec<BoardPoint>,
    /// The number of the configuration in force; none for that of the start.
    pub configuration: Option<u32>,
    /// The mode that the drive led to, and why; none if the record ends before.
    pub ended: Option<(Mode, Option<Reason>)>,
    /// Ground truth; empty unless the car is simulated.
    pub truth: Vec<TruthSample>,
}

impl Recording {
    /// Takes in the next entry of the record.
    pub fn take(&mut self, entry: &Entry) {
        match entry {
            Entry::Tick(tick) => self.take_tick(tick),
            Entry::Log(log) => self.log.push(log.clone()),
            Entry::Configuration(record) => self.configurations.push(record.clone()),
            Entry::Drops(Drops { entries, .. }) => self.entries_dropped = *entries,
            _ => {}
        }
    }

    fn take_tick(&mut self, tick: &TickRecord) {
        let output = &tick.output;
        self.ticks += 1;
        for event in &tick.events {
            if let Event::Reconfigured(number) = event {
                self.configuration = Some(*number);
            }
        }
        let (mode, reason) = (output.mode, output.reason);
        let last = self.changes.last();
        if last.is_none_or(|last| (last.mode, last.reason) != (mode, reason)) {
            self.changes.push(Change {
                time_ns: tick.pilot_time.0,
                mode,
                reason,
            });
        }
        if !mode.commands() {
            if let Some(drive) = self.open_drive() {
                drive.ended = Some((mode, reason));
            }
            return;
        }
        if self.open_drive().is_none() {
            // A record may begin within a drive.
            let driven_ns = output
                .drive_time
                .map_or(0, |time| (time * 1e9).round() as u64);
            self.drives.push(Drive {
                start_ns: tick.pilot_time.0.saturating_sub(driven_ns),
                configuration: self.configuration,
                ..Drive::default()
            });
        }
        if let Some(drive) = self.open_drive() {
            drive.take(tick);
        }
    }

    /// The drive that has not ended.
    fn open_drive(&mut self) -> Option<&mut Drive> {
        self.drives.last_mut().filter(|drive| drive.ended.is_none())
    }

    /// The number of the longest drive, from 1; the first of those as long.
    pub fn longest(&self) -> Option<usize> {
        (1..)
            .zip(&self.drives)
            .reduce(|best, next| {
                let longer = next.1.duration() > best.1.duration();
                if longer { next } else { best }
            })
            .map(|(number, _)| number)
    }
}

impl Drive {
    fn take(&mut self, tick: &TickRecord) {
        let output = &tick.output;
        let missing = tick.events.iter();
        let missing = missing.filter(|event| matches!(event, Event::PoseMissing(_)));
        let reference = output.reference;
        let estimate = output.estimate;
        let of_estimate = |value: fn(&Estimate) -> f64| estimate.as_ref().map_or(f64::NAN, value);
        let seconds = |ns: i64| ns as f64 * 1e-9;
        // What another program has driven has no estimate: the body stands for P.
        let point = match (output.point, estimate) {
            (None, None) => self.body(tick),
            (point, _) => pair(point),
        };
        self.ticks.push(TickSample {
            time: self.time(tick.pilot_time),
            mode: output.mode,
            held: output.held,
            place: pair(estimate.map(|estimate| estimate.position)),
            yaw: of_estimate(|estimate| estimate.yaw),
            point,
            reference: pair(reference.and_then(|reference| reference.position)),
            nominal: [f64::NAN; 2],
            point_velocity: pair(output.point_velocity),
            commanded_speed: output.actuation.speed,
            steering: output.actuation.steering,
            speed: of_estimate(|estimate| estimate.speed),
            sideslip: of_estimate(|estimate| estimate.sideslip),
            yaw_rate: of_estimate(|estimate| estimate.yaw_rate),
            lateness: seconds(tick.lateness_ns()),
            latency: match tick.capture_to_command_ns() {
                // In a held tick the pose is an old one.
                Some(latency) if !output.held => seconds(latency),
                _ => f64::NAN,
            },
            skipped: tick.skipped,
            poses_missing: u32::try_from(missing.count()).unwrap_or(u32::MAX),
        });
        for event in &tick.events {
            if let Event::Board(sample) = event {
                self.board.push(BoardPoint {
                    time: self.time(sample.time),
                    motor_speed: sample.motor_speed,
                    yaw_rate: sample.inertial.map_or(f64::NAN, |sample| sample.yaw_rate),
                });
            }
        }
    }

    /// Where the cameras saw the body last.
    fn body(&self, tick: &TickRecord) -> [f64; 2] {
        let mut newest = tick.events.iter().rev();
        let seen = newest.find_map(|event| match event {
            Event::Pose(pose) => Some(pose.position.into()),
            _ => None,
        });
        let before = || self.ticks.last().map_or([f64::NAN; 2], |tick| tick.point);
        seen.unwrap_or_else(before)
    }

    /// Whether any tick has an estimate; a record of another program's log has none.
    pub fn is_estimated(&self) -> bool {
        self.ticks.iter().any(|tick| tick.place[0].is_finite())
    }

    fn time(&self, time: Time) -> f64 {
        seconds_since(self.start_ns, time.0)
    }

    /// When its last tick was, in s.
    pub fn duration(&self) -> f64 {
        self.ticks.last().map_or(0.0, |tick| tick.time)
    }

    /// Until when the car followed its reference, in s: then it stopped, if at all.
    pub fn followed(&self) -> f64 {
        let mut ticks = self.ticks.iter();
        let driving = ticks.rfind(|tick| tick.mode == Mode::Driving);
        driving.map_or(0.0, |tick| tick.time)
    }

    /// Sets where P should be at each tick: the reference, or for a reference that
    /// is a velocity alone the integral of the velocity that was commanded, from
    /// where P was at first. Not a number once the car no longer follows.
    pub(super) fn set_nominal(&mut self) {
        let (has_positions, is_estimated) = (self.has_positions(), self.is_estimated());
        let mut before: Option<TickSample> = None;
        for tick in &mut self.ticks {
            if has_positions {
                tick.nominal = tick.reference;
                continue;
            }
            if !is_estimated || !matches!(tick.mode, Mode::Driving | Mode::Slowing) {
                continue;
            }
            tick.nominal = before.map_or(tick.point, |before| {
                let elapsed = tick.time - before.time;
                // Nothing is commanded while the car slows down blindly.
                let velocity = |it: f64| if it.is_finite() { it } else { 0.0 };
                [0, 1].map(|axis: usize| {
                    before.nominal[axis] + elapsed * velocity(before.point_velocity[axis])
                })
            });
            before = Some(*tick);
        }
    }

    /// Whether the reference is a position.
    pub fn has_positions(&self) -> bool {
        self.ticks.iter().any(|tick| tick.reference[0].is_finite())
    }

    /// How far the true P is from where it should be at that moment, in m.
    pub fn true_error(&self, sample: &TruthSample) -> f64 {
        let after = self.ticks.partition_point(|tick| tick.time < sample.time);
        let before = self.ticks.get(after.saturating_sub(1));
        let Some((one, other)) = before.zip(self.ticks.get(after)) else {
            return f64::NAN;
        };
        let elapsed = other.time - one.time;
        let part = match elapsed > 0.0 {
            true => (sample.time - one.time) / elapsed,
            false => 0.0,
        };
        let (from, to) = (one.nominal, other.nominal);
        let nominal = [0, 1].map(|axis: usize| from[axis] + part * (to[axis] - from[axis]));
        distance(sample.point, nominal)
    }

    /// Whether the lateness of every tick is zero: time was virtual, or the log does not have it.
    pub fn is_never_late(&self) -> bool {
        self.ticks.iter().all(|tick| tick.lateness == 0.0)
    }

    /// The spans in which the markers were lost, in s.
    pub fn lost_markers(&self) -> Vec<[f64; 2]> {
        lost_markers(&self.ticks)
    }
}

fn pair<V: Into<[f64; 2]>>(vector: Option<V>) -> [f64; 2] {
    vector.map_or([f64::NAN; 2], Into::into)
}

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
/// Intervals without a pose for ticks that had no word of the cameras either: frames that are merely
/// late are not a loss.
const SILENT_INTERVALS: f64 = 5.5;

/// The spans in which no new pose came for longer than usual, because frames had none
/// or because there were no frames: from the first tick
/// that had to hold the last one until the one with the next, in s.
///
/// The usual interval is the median time between ticks with a new pose, so that cameras
/// slower than the control loop are not a loss.
pub(super) fn lost_markers(ticks: &[TickSample]) -> Vec<[f64; 2]> {
    let fresh = ticks.iter().filter(|tick| !tick.held);
    let fresh: Vec<f64> = fresh.map(|tick| tick.time).collect();
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
        let (seen, unseen) = fresh.split_at(before);
        let until = unseen.first().copied().unwrap_or(last.time);
        // At the start of a drive the last pose is at most a tick older.
        let blind = until - seen.last().copied().unwrap_or(first.time);
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
