//! The data of a drive: measured quantities, poses, inertial samples and servo targets, and the
//! stretches of it that can be used.

use nalgebra::{Matrix3, Vector3};
use singletrack_control::statistics::{Line, RootMeanSquare};
use singletrack_control::{words, wrap};

use super::error::{IdentificationError, Result};

words! {
    /// A measured quantity.
    #[derive(PartialOrd, Ord)]
    pub enum Channel {
        /// Position along x.
        X = "x",
        /// Position along y.
        Y = "y",
        /// Yaw from the cameras.
        Yaw = "yaw",
        /// Yaw rate from the gyro.
        YawRate = "yaw_rate",
        /// Acceleration to the left.
        Left = "left_acceleration",
    }
}

/// A pose of the centre of mass from the motion capture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pose {
    /// Mid-exposure, in s.
    pub time_s: f64,
    /// Position of G along x, in m.
    pub x_m: f64,
    /// Position of G along y, in m.
    pub y_m: f64,
    /// Yaw, in rad; may jump by whole turns.
    pub yaw_rad: f64,
}

impl Pose {
    /// Whether the car can't have come here from the pose before.
    fn leaps_from(&self, before: &Self) -> bool {
        let way = (self.x_m - before.x_m).hypot(self.y_m - before.y_m);
        way > LEAP + LEAP_SPEED * (self.time_s - before.time_s)
    }

    /// Whether it is the pose before once more, to the bit.
    fn repeats(&self, before: &Self) -> bool {
        let bits = |pose: &Self| [pose.x_m, pose.y_m, pose.yaw_rad].map(f64::to_bits);
        bits(self) == bits(before)
    }
}

/// A sample of the inertial measurement unit at G, axes forward, left, up. Yaw rate and acceleration to
/// the left are NaN in all samples of a car that does not measure them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Inertial {
    /// Estimated time of the measurement, in s.
    pub time_s: f64,
    /// Angular velocity about the vertical, in rad/s.
    pub yaw_rate_rad_s: f64,
    /// Acceleration forward without gravity, in m/s².
    pub forward_m_s2: f64,
    /// Acceleration to the left without gravity, in m/s².
    pub left_m_s2: f64,
}

/// The servo target of the board at the time of a record.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ServoTarget {
    /// Time of the record, in s.
    pub time_s: f64,
    /// Number of the board's control period, counted from any start.
    pub period: u64,
    /// Steering angle of the pulse by the calibration, left positive, in rad.
    pub angle_rad: f64,
}

/// A drive on one clock; each list is in order of time.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct DriveData {
    /// Poses from the cameras.
    pub poses: Vec<Pose>,
    /// Samples of the inertial measurement unit.
    pub inertial: Vec<Inertial>,
    /// Targets of the servo.
    pub servo: Vec<ServoTarget>,
}

/// A stretch of time, in s.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Span {
    /// Start.
    pub start_s: f64,
    /// End.
    pub end_s: f64,
}

impl Span {
    /// Duration, in s.
    pub fn seconds(&self) -> f64 {
        self.end_s - self.start_s
    }

    pub(super) fn contains(&self, time_s: f64) -> bool {
        (self.start_s..=self.end_s).contains(&time_s)
    }
}

/// Whether a time, in s, is in one of the stretches.
pub(super) fn are_at(spans: &[Span], time_s: f64) -> bool {
    spans.iter().any(|span| span.contains(time_s))
}

/// What a model is replayed along: a drive, the targets that begin a pulse of its servo, and the
/// stretches that are used.
#[derive(Clone, Copy, Debug)]
pub(super) struct Drive<'a> {
    pub(super) data: &'a DriveData,
    pub(super) servo: &'a [ServoTarget],
    pub(super) spans: &'a [Span],
}

/// The sideslip is measured over poses up to this time before and after, in s: with errors
/// of 0.2 mm and 0.1 degrees at 1.5 m/s to 2 mrad.
const AROUND: f64 = 0.036;
/// The smallest number of poses for a sideslip.
const LEAST_POSES: usize = 5;

/// The motion that poses around a moment show.
#[derive(Clone, Copy, Debug)]
pub(super) struct Seen {
    /// Speed, in m/s.
    pub(super) speed: f64,
    /// Course less yaw, in rad.
    pub(super) sideslip: f64,
    /// Yaw rate, in rad/s.
    pub(super) yaw_rate: f64,
}

/// The poses up to `reach`, in s, before and after `time`; none of poses that are not in order.
fn around(poses: &[Pose], reach: f64, time: f64) -> &[Pose] {
    let from = poses.partition_point(|pose| pose.time_s < time - reach);
    let to = poses.partition_point(|pose| pose.time_s <= time + reach);
    poses.get(from..to).unwrap_or(&[])
}

/// The motion from the straight lines through the poses around `time`. None with too few poses.
pub(super) fn seen(poses: &[Pose], time: f64) -> Option<Seen> {
    let around = around(poses, AROUND, time);
    let first = around.first().filter(|_| around.len() >= LEAST_POSES)?;
    let line = |value: &dyn Fn(&Pose) -> f64| {
        Line::through(around.iter().map(|pose| [pose.time_s - time, value(pose)]))
    };
    let yaw = line(&|pose| wrap(pose.yaw_rad - first.yaw_rad));
    let (x, y) = (line(&|pose| pose.x_m).slope, line(&|pose| pose.y_m).slope);
    (yaw.spread > 0.0).then(|| Seen {
        speed: x.hypot(y),
        sideslip: wrap(y.atan2(x) - first.yaw_rad - yaw.middle[1]),
        yaw_rate: yaw.slope,
    })
}

/// The forward acceleration is that of a parabola through the poses up to this time before and after,
/// in s...
const BENT_AROUND: f64 = 0.055;
/// ...or up to as many of the poses' median distances.
const BENT_PERIODS: f64 = 2.6;
/// The acceleration of a parabola is left out if it differs from that of the samples by more than this
/// many standard deviations: a pose of another body bends it.
const FAR: f64 = 5.0;
/// The median of the magnitude of a standard normal variable.
pub(super) const MEDIAN_OF_NORMAL: f64 = 0.674_49;
/// The smallest number of poses of a parabola.
const LEAST_BENT: usize = 5;

/// Acceleration of G along the car's axis in the middle of poses, in m/s², and its standard deviation
/// for each metre of that of a position, in 1/s².
fn forward_acceleration(poses: &[Pose], time: f64) -> Option<[f64; 2]> {
    let first = poses.first().filter(|_| poses.len() >= LEAST_BENT)?;
    let mut normal = Matrix3::zeros();
    let mut sums = [Vector3::zeros(); 3];
    for pose in poses {
        let t = pose.time_s - time;
        let row = Vector3::new(1.0, t, t * t);
        normal += row * row.transpose();
        let turned = wrap(pose.yaw_rad - first.yaw_rad);
        for (sum, value) in sums.iter_mut().zip([pose.x_m, pose.y_m, turned]) {
            *sum += row * value;
        }
    }
    let inverse = normal.try_inverse()?;
    let [x, y, turned] = sums.map(|sum| inverse * sum);
    let (sin, cos) = (first.yaw_rad + turned.x).sin_cos();
    let deviation = 2.0 * inverse.m33.sqrt();
    Some([2.0 * (x.z * cos + y.z * sin), deviation])
}

words! {
    /// Which of the board's control periods begin a pulse of the servo.
    ///
    /// The board records its target at 100 Hz and sends a pulse every 20 ms. The record does
    /// not contain which of two periods begins a pulse.
    pub enum ServoFrames {
        /// Periods with even numbers.
        Even = "even",
        /// Periods with odd numbers.
        Odd = "odd",
        /// Every period: a digital servo at 100 Hz.
        Every = "every",
    }
}

impl ServoFrames {
    const fn begins(self, period: u64) -> bool {
        match self {
            Self::Even => period.is_multiple_of(2),
            Self::Odd => !period.is_multiple_of(2),
            Self::Every => true,
        }
    }

    pub(super) fn of(self, targets: &[ServoTarget]) -> Vec<ServoTarget> {
        let mut taken: Vec<ServoTarget> = Vec::with_capacity(targets.len());
        for target in targets {
            // An unchanged target is no event.
            let same = |last: &ServoTarget| last.angle_rad.to_bits() == target.angle_rad.to_bits();
            if self.begins(target.period) && !taken.last().is_some_and(same) {
                taken.push(*target);
            }
        }
        taken
    }
}

/// A longer gap between poses ends a stretch, in s.
const POSE_GAP: f64 = 0.3;
/// A longer gap between inertial samples ends a stretch, in s.
const INERTIAL_GAP: f64 = 0.055;
/// Unless the samples are rare: a longer one, in their median distance.
const INERTIAL_PERIODS: f64 = 2.5;
/// A car moves by no more than this and [`LEAP_SPEED`] from one pose to the next, in m.
const LEAP: f64 = 0.1;
/// In m/s.
const LEAP_SPEED: f64 = 20.0;
/// Shorter stretches are ignored: the filter needs time to settle, in s.
const LEAST_STRETCH: f64 = 2.0;
/// Number of poses on either side over which the speed is measured.
const REACH: usize = 6;

impl DriveData {
    /// Checks the lists: long enough, finite, and in order of time.
    ///
    /// # Errors
    ///
    /// The first list and sample that is not.
    pub fn validate(&self) -> Result<()> {
        check(
            "poses of the motion capture",
            self.poses
                .iter()
                .map(|p| (p.time_s, [p.x_m, p.y_m, p.yaw_rad])),
        )?;
        let unmeasured = [Channel::YawRate, Channel::Left].map(|channel| !self.measures(channel));
        check(
            "samples of the IMU",
            self.inertial.iter().map(|i| {
                let [no_yaw_rate, no_left] = unmeasured;
                let yaw_rate = if no_yaw_rate { 0.0 } else { i.yaw_rate_rad_s };
                let left = if no_left { 0.0 } else { i.left_m_s2 };
                (i.time_s, [yaw_rate, i.forward_m_s2, left])
            }),
        )?;
        check(
            "servo pulses",
            self.servo
                .iter()
                .map(|s| (s.time_s, [s.angle_rad, 0.0, 0.0])),
        )
    }

    /// Whether any sample of the IMU measures a channel of it; the cameras measure the others.
    pub(super) fn measures(&self, channel: Channel) -> bool {
        let mut inertial = self.inertial.iter();
        match channel {
            Channel::YawRate => inertial.any(|sample| !sample.yaw_rate_rad_s.is_nan()),
            Channel::Left => inertial.any(|sample| !sample.left_m_s2.is_nan()),
            Channel::X | Channel::Y | Channel::Yaw => true,
        }
    }

    /// The stretches at this speed (m/s) or faster, without gaps in poses and inertial
    /// samples.
    pub fn stretches(&self, least_speed: f64) -> Vec<Span> {
        let first_target = self.servo.first().map_or(f64::INFINITY, |s| s.time_s);
        let mut spans: Vec<Span> = Vec::new();
        let mut open: Option<Span> = None;
        let mut inertial = self.inertial.windows(2).peekable();
        let mut last = f64::NEG_INFINITY;
        let mut leapt = None;
        let period = median_period(self.inertial.iter().map(|sample| sample.time_s));
        let longest = INERTIAL_GAP.max(INERTIAL_PERIODS * period);
        for (index, pose) in self.poses.iter().enumerate() {
            let fast = (self.speed_at(index)).is_some_and(|speed| speed >= least_speed);
            // Whether the inertial samples since the last pose have no gap.
            let mut gapless = true;
            while let Some([one, other]) = inertial.next_if(|pair| {
                let [one, _] = pair else { return false };
                one.time_s <= pose.time_s
            }) {
                gapless &= other.time_s - one.time_s <= longest;
            }
            gapless &= inertial.peek().is_some();
            let before = index.checked_sub(1).and_then(|index| self.poses.get(index));
            if before.is_some_and(|before| pose.leaps_from(before)) {
                // The speeds around a leap are not the car's.
                leapt = Some(index);
                if let Some(span) = &mut open {
                    let end = self.poses.get(index.saturating_sub(REACH + 1));
                    span.end_s = end.map_or(span.start_s, |end| end.time_s.max(span.start_s));
                    spans.extend(open.take());
                }
            }
            let goes_on = fast
                && gapless
                && leapt.is_none_or(|leapt| index >= leapt + REACH)
                && pose.time_s - last <= POSE_GAP
                && pose.time_s > first_target;
            // A pose that is held is no new one.
            if before.is_none_or(|before| !pose.repeats(before)) {
                last = pose.time_s;
            }
            match (&mut open, goes_on) {
                (Some(span), true) => span.end_s = pose.time_s,
                (None, true) => {
                    open = Some(Span {
                        start_s: pose.time_s,
                        end_s: pose.time_s,
                    });
                }
                (_, false) => spans.extend(open.take()),
            }
        }
        spans.extend(open);
        spans.retain(|span| span.seconds() >= LEAST_STRETCH);
        spans
    }

    /// Puts the forward acceleration that the poses show in place of that of the samples; without a
    /// sample, into one at each pose. A car without an accelerometer is identified so.
    pub fn take_acceleration_of_poses(&mut self) {
        let unmeasured = |pose: &Pose| Inertial {
            time_s: pose.time_s,
            yaw_rate_rad_s: f64::NAN,
            forward_m_s2: f64::NAN,
            left_m_s2: f64::NAN,
        };
        if self.inertial.is_empty() {
            self.inertial = self.poses.iter().map(unmeasured).collect();
        }
        let (poses, reach) = (&self.poses, self.bent_reach());
        self.inertial.retain_mut(|sample| {
            let forward = bent(poses, reach, sample.time_s);
            sample.forward_m_s2 = forward.map_or(f64::NAN, |[forward, _]| forward);
            forward.is_some()
        });
    }

    /// Half of the time of a parabola through the poses, in s.
    fn bent_reach(&self) -> f64 {
        let period = median_period(self.poses.iter().map(|pose| pose.time_s));
        BENT_AROUND.max(BENT_PERIODS * period)
    }

    /// Puts the forward acceleration of accelerometer and poses together in place of that of the samples,
    /// and returns these data with the density of its noise, in m/s²/√Hz. `position_m` is the standard
    /// deviation of a coordinate of a pose, in m.
    ///
    /// The forward acceleration is an input of the model. Its noise is in the prediction and in the
    /// prediction's derivatives alike, so that a vibrating accelerometer biases the fit by the square of
    /// that noise. A parabola through poses shows the mean acceleration with the weight (h² - t²)²; so
    /// does the mean of the samples with that weight. By how much the two differ says how noisy the
    /// latter is, and both are put together by their variances. None if the poses are the noisier ones.
    pub(super) fn with_fused_acceleration(
        &self,
        position_m: f64,
        spans: &[Span],
    ) -> Option<(Self, f64)> {
        if !self.measures(Channel::Left) {
            return None;
        }
        let (late, reach) = (self.gyro_delay(spans), self.bent_reach());
        let mut fused = self.clone();
        let mut of_poses = RootMeanSquare::default();
        // The acceleration of the poses beyond the mean of the samples.
        let mut beyond = vec![f64::NAN; self.inertial.len()];
        for (index, sample) in fused.inertial.iter_mut().enumerate() {
            let (mut sum, mut weights) = (0.0, 0.0);
            let near = |other: &&Inertial| (other.time_s - sample.time_s).abs() < reach;
            let before = self.inertial[..index].iter().rev().take_while(near);
            for other in before.chain(self.inertial[index..].iter().take_while(near)) {
                let t = (other.time_s - sample.time_s) / reach;
                let weight = (1.0 - t * t).powi(2);
                sum += weight * other.forward_m_s2;
                weights += weight;
            }
            sample.forward_m_s2 = sum / weights;
            if let Some([forward, deviation]) = bent(&self.poses, reach, sample.time_s - late) {
                beyond[index] = forward - sample.forward_m_s2;
                of_poses.add(position_m * deviation);
            }
        }
        let driven = self.inertial.iter().zip(&beyond);
        let driven =
            driven.filter(|(sample, beyond)| are_at(spans, sample.time_s) && !beyond.is_nan());
        let driven: Vec<f64> = driven.map(|(_, beyond)| *beyond).collect();
        let bias = median(driven.clone())?;
        let off = driven.iter().map(|beyond| (beyond - bias).abs());
        let spread = median(off.collect())? / MEDIAN_OF_NORMAL;
        let poses = of_poses.value()?.powi(2);
        let means = spread * spread - poses;
        if means <= poses {
            return None;
        }
        let share = means / (means + poses);
        for (sample, beyond) in fused.inertial.iter_mut().zip(beyond) {
            if (beyond - bias).abs() < FAR * spread {
                sample.forward_m_s2 += share * beyond;
            }
        }
        let variance = (1.0 - share).powi(2) * means + share * share * poses;
        Some((fused, (variance * reach).sqrt()))
    }

    /// The lateness of the gyro's time stamps against those of the poses, in s: where what they differ by
    /// does not go with the change of the yaw rate. Zero without a gyro.
    fn gyro_delay(&self, spans: &[Span]) -> f64 {
        const STEPS: usize = 4;
        /// A longer delay is none of an IMU, in s.
        const LATEST: f64 = 0.2;
        let samples = self.inertial.iter();
        let samples = samples.filter(|one| are_at(spans, one.time_s));
        let mut late = 0.0;
        for _ in 0..STEPS {
            let rows = samples.clone().filter_map(|sample| {
                let at = |offset| Some(seen(&self.poses, sample.time_s - late + offset)?.yaw_rate);
                let rise = (at(AROUND)? - at(-AROUND)?) / (2.0 * AROUND);
                Some([at(0.0)?, sample.yaw_rate_rad_s, rise])
            });
            let rows: Vec<[f64; 3]> = rows.collect();
            let line = Line::through(rows.iter().map(|[camera, gyro, _]| [*camera, *gyro]));
            let (mut along, mut of) = (0.0, 0.0);
            for [camera, gyro, rise] in &rows {
                along += (line.at(*camera) - gyro) * rise;
                of += line.slope * rise * rise;
            }
            late += along / of;
        }
        // Also if nothing turns, and it is not a number.
        if late.abs() < LATEST { late } else { 0.0 }
    }

    /// Speed at the pose with this index from its neighbours, in m/s.
    fn speed_at(&self, index: usize) -> Option<f64> {
        let from = self.poses.get(index.saturating_sub(REACH))?;
        let last = self.poses.len().checked_sub(1)?;
        let to = self.poses.get((index + REACH).min(last))?;
        let seconds = to.time_s - from.time_s;
        (seconds > 0.0).then(|| (to.x_m - from.x_m).hypot(to.y_m - from.y_m) / seconds)
    }

    /// The largest speed of the drive from the cameras, in m/s.
    pub fn fastest(&self) -> f64 {
        self.speeds().fold(0.0, f64::max)
    }

    /// The speed at each pose with neighbours, in m/s.
    pub(super) fn speeds(&self) -> impl Iterator<Item = f64> {
        (0..self.poses.len()).filter_map(|index| self.speed_at(index))
    }
}

/// The forward acceleration of the poses around a time, none where they are not on both sides.
fn bent(poses: &[Pose], reach: f64, time: f64) -> Option<[f64; 2]> {
    let around = around(poses, reach, time);
    let ends = [around.first(), around.last()]
        .map(|pose| pose.is_some_and(|pose| (pose.time_s - time).abs() > 0.6 * reach));
    forward_acceleration(around, time).filter(|_| ends == [true; 2])
}

/// The median distance of times, in s.
fn median_period(times: impl Iterator<Item = f64>) -> f64 {
    let times: Vec<f64> = times.collect();
    let periods = times.windows(2).map(|pair| pair[1] - pair[0]);
    median(periods.collect()).unwrap_or_default()
}

pub(super) fn median(mut values: Vec<f64>) -> Option<f64> {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied()
}

fn check(what: &'static str, samples: impl Iterator<Item = (f64, [f64; 3])>) -> Result<()> {
    let mut count = 0;
    let mut last = f64::NEG_INFINITY;
    for (index, (time_s, values)) in samples.enumerate() {
        if !(time_s.is_finite() && values.iter().all(|value| value.is_finite())) {
            return Err(IdentificationError::NotFinite(what, index));
        }
        if time_s < last {
            return Err(IdentificationError::OutOfOrder(what, index, time_s));
        }
        last = time_s;
        count = index + 1;
    }
    if count < 2 {
        return Err(IdentificationError::TooFew(what, count));
    }
    Ok(())
}

/// The scale of the gyro by the yaw of the cameras, and its standard deviation.
#[derive(Clone, Copy, Debug)]
pub(super) struct GyroScale {
    pub(super) value: f64,
    pub(super) deviation: f64,
    /// Standard deviation of the yaw rate of the cameras, in rad/s.
    pub(super) turning: f64,
}

impl GyroScale {
    /// The regression of the gyro on the yaw rate of the cameras. None without enough turning.
    pub(super) fn of(data: &DriveData, spans: &[Span]) -> Option<Self> {
        if !data.measures(Channel::YawRate) {
            return None;
        }
        let samples = data.inertial.iter();
        let samples = samples.filter(|one| are_at(spans, one.time_s));
        let pairs = samples.filter_map(|sample| {
            let seen = seen(&data.poses, sample.time_s)?;
            Some([seen.yaw_rate, sample.yaw_rate_rad_s])
        });
        let pairs: Vec<[f64; 2]> = pairs.collect();
        let line = Line::through(pairs.iter().copied());
        let count = pairs.len() as f64;
        let errors = pairs.iter();
        let errors = errors.map(|[camera, gyro]| (gyro - line.at(*camera)).powi(2));
        let errors: f64 = errors.sum();
        // The errors of samples of a few hertz that are interpolated are alike over ten of them.
        const ALIKE: f64 = 10.0;
        let deviation = (ALIKE * errors / count / line.spread).sqrt().max(1e-4);
        (line.spread > 0.0 && deviation.is_finite()).then_some(Self {
            value: line.slope,
            deviation,
            turning: (line.spread / count).sqrt(),
        })
    }
}
