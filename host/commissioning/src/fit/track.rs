//! The readings of a drive over the time in s, and the pulses that servo and ESC got.
//!
//! The board begins a pulse for each of the two every 20 ms since its start, and makes a record
//! every 10 ms: the native board at multiples of 10 ms, the Arduino's image 5 ms after them. A
//! pulse is as long as the last record says that was made until then.

use singletrack_control::statistics::Line;
use singletrack_control::{interpolate, unwrap_near};

use super::sample_times;
use crate::{BoardReading, Inertial, observed::Readings};

/// A drive at the time of a pose.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Moment {
    /// Time by the clock of the gyro, s.
    pub(crate) time: f64,
    /// Position of the rigid body, m.
    pub(crate) position: [f64; 2],
    /// Yaw of the rigid body, smoothed with the gyro, rad.
    pub(crate) yaw: f64,
    /// Yaw rate, rad/s.
    pub(crate) yaw_rate: f64,
}

/// The motion of a drive, in the order of time.
#[derive(Clone, Debug)]
pub(crate) struct Motion(pub(crate) Vec<Moment>);

/// What is averaged to smooth the yaw: poses on both sides. The gyro bridges them.
const SMOOTHED: usize = 15;

/// The duration of the windows that find the latency, s: the gyro wanders in longer ones.
const WINDOW: f64 = 2.0;

impl Readings {
    /// The pulses of the servo.
    pub(crate) fn servo(&self) -> Frames {
        self.frames(|board| board.servo_us)
    }

    /// The pulses of the ESC.
    pub(crate) fn esc(&self) -> Frames {
        self.frames(|board| board.esc_us)
    }

    fn frames(&self, pulse: fn(&BoardReading) -> u16) -> Frames {
        let record =
            |board: &BoardReading| (self.at(board.time), board.board_us, pulse(board).into());
        Frames::of(&self.boards.iter().map(record).collect::<Vec<_>>())
    }

    /// The angular velocity about the vertical, rad/s, when it was measured, and a bound on an error
    /// that these times have in common, s.
    pub(crate) fn rate(&self) -> (Signal, f64) {
        let reading = |sample: Inertial| (self.at(sample.time), sample.board_us);
        let readings: Vec<_> = self.inertial().map(reading).collect();
        let (times, systematic) = sample_times(&readings);
        let rates = self.inertial().map(|sample| sample.angular_velocity[2]);
        let samples = times.into_iter().zip(rates);
        let signal = samples.map(|(time, rate)| [time, rate]).collect();
        (Signal(signal), systematic)
    }

    /// The yaw of the rigid body by the stamp, rad, not wrapped.
    pub(crate) fn yaws(&self) -> Vec<[f64; 2]> {
        let mut yaw = 0.0;
        let unwrapped = self.poses.iter().map(|pose| {
            yaw = unwrap_near(pose.yaw, yaw);
            [self.at(pose.capture), yaw]
        });
        unwrapped.collect()
    }

    /// The integral of the motor's speed, m.
    pub(crate) fn way(&self) -> Signal {
        let boards = self.boards.iter();
        let speeds = boards.map(|board| [self.at(board.time), board.motor_speed]);
        Signal(speeds.collect()).integral()
    }

    /// The lateness of the poses' stamps against the gyro, s; zero without motion.
    pub(crate) fn latency(&self) -> f64 {
        let (rate, _) = self.rate();
        let smooth = rate.smoothed(2);
        let turned = rate.integral();
        let [mut product, mut square] = [0.0; 2];
        let yaws = self.yaws();
        let mut rest = &yaws[..];
        while let [[start, _], ..] = rest {
            let within = |[time, _]: &&[f64; 2]| *time < start + WINDOW;
            let length = rest.iter().take_while(within).count();
            let (window, after) = rest.split_at(length.max(1));
            rest = after;
            if (length as f64) < 50.0 * WINDOW {
                continue;
            }
            let times = window.iter().map(|[time, _]| time - start);
            let lead = window.iter().map(|[time, yaw]| turned.at(*time) - yaw);
            let rates = window.iter().map(|[time, _]| smooth.at(*time));
            let pairs = detrended(times.clone(), lead).into_iter();
            for (lead, rate) in pairs.zip(detrended(times, rates)) {
                product += lead * rate;
                square += rate * rate;
            }
        }
        if square > 0.0 { product / square } else { 0.0 }
    }

    /// The motion at the poses, whose stamps are late by `latency` s.
    pub(crate) fn motion(&self, latency: f64) -> Motion {
        let turned = self.rate().0.integral();
        let lead = self.yaws().into_iter().map(|[stamp, yaw]| {
            let time = stamp - latency;
            [time, yaw - turned.at(time)]
        });
        let Signal(lead) = Signal(lead.collect()).smoothed(SMOOTHED);
        let smooth = lead.into_iter();
        let smooth = smooth.map(|[time, lead]| [time, turned.at(time) + lead]);
        let smooth: Vec<[f64; 2]> = smooth.collect();
        let moments = self.poses.iter().zip(slopes(&smooth, 1)).zip(&smooth);
        let moments = moments.map(|((pose, yaw_rate), &[time, yaw])| Moment {
            time,
            position: [pose.position[0], pose.position[1]],
            yaw,
            yaw_rate,
        });
        Motion(moments.collect())
    }
}

/// The change of values over the time, over `span` of them on both sides.
fn slopes(values: &[[f64; 2]], span: usize) -> Vec<f64> {
    let slopes = (0..values.len()).map(|index| {
        let [begin, before] = values[index.saturating_sub(span)];
        let [end, after] = values[(index + span).min(values.len() - 1)];
        match end > begin {
            true => (after - before) / (end - begin),
            false => 0.0,
        }
    });
    slopes.collect()
}

/// Values without their mean and trend over time.
fn detrended(
    times: impl Iterator<Item = f64> + Clone,
    values: impl Iterator<Item = f64> + Clone,
) -> Vec<f64> {
    let points = times.zip(values).map(|(t, v)| [t, v]);
    let line = Line::through(points.clone());
    points.map(|[t, v]| v - line.at(t)).collect()
}

/// A value over time, linear between its samples: time in s and value.
#[derive(Clone, Debug, Default)]
pub(crate) struct Signal(pub(crate) Vec<[f64; 2]>);

impl Signal {
    /// The value at a time; the first or the last one outside.
    pub(crate) fn at(&self, time: f64) -> f64 {
        interpolate(&self.0, time)
    }

    /// The integral since the first sample.
    pub(crate) fn integral(&self) -> Self {
        let mut sum = 0.0;
        let mut last: Option<[f64; 2]> = None;
        let integrated = self.0.iter().map(|&[time, value]| {
            if let Some([before, earlier]) = last.replace([time, value]) {
                sum += (time - before) * f64::midpoint(value, earlier);
            }
            [time, sum]
        });
        Self(integrated.collect())
    }

    /// The mean of every sample and `around` on both sides.
    fn smoothed(&self, around: usize) -> Self {
        let all = &self.0;
        let mean = |index: usize| {
            let around = around.min(index).min(all.len() - 1 - index);
            let near = &all[index - around..=index + around];
            let sum: f64 = near.iter().map(|[_, value]| value).sum();
            [all[index][0], sum / near.len() as f64]
        };
        Self((0..all.len()).map(mean).collect())
    }
}

impl Motion {
    /// The part between two times.
    pub(crate) fn between(&self, [begin, end]: [f64; 2]) -> Self {
        let mut part = self.clone();
        part.0.retain(|moment| (begin..end).contains(&moment.time));
        part
    }

    /// The displacement of the rigid body from pose to pose, along and across a car whose yaw is
    /// that of the body less `body_yaw`, m.
    pub(crate) fn displacement(&self, body_yaw: f64) -> Vec<[f64; 2]> {
        let steps = self.0.windows(2).map(|pair| {
            let [dx, dy] = [0, 1].map(|axis| pair[1].position[axis] - pair[0].position[axis]);
            let yaw = f64::midpoint(pair[0].yaw, pair[1].yaw) - body_yaw;
            let (sin, cos) = yaw.sin_cos();
            [dx * cos + dy * sin, dy * cos - dx * sin]
        });
        steps.collect()
    }

    /// The way of the rear axle since the first pose, m, at the times of the poses, when the pivot is
    /// `left` m to the left of the car's middle.
    pub(crate) fn rear_way(&self, body_yaw: f64, left: f64) -> Vec<[f64; 2]> {
        let mut way = 0.0;
        let begin = self.0.first().map(|first| [first.time, 0.0]);
        let steps = self
            .displacement(body_yaw)
            .into_iter()
            .zip(self.0.windows(2));
        let ways = steps.map(|([along, _], pair)| {
            way += along + left * (pair[1].yaw - pair[0].yaw);
            [pair[1].time, way]
        });
        begin.into_iter().chain(ways).collect()
    }

    /// The speed of the rear axle at every pose, over `span` poses on both sides, m/s.
    pub(crate) fn rear_speed(&self, body_yaw: f64, left: f64, span: usize) -> Vec<f64> {
        slopes(&self.rear_way(body_yaw, left), span)
    }
}

/// Microseconds between two pulses, and between two records.
const FRAME_US: u64 = 20_000;
const RECORD_US: u64 = 10_000;

/// Records are made at multiples of this since the board's start.
const GRID_US: u64 = 5_000;

/// The most by which a record is late that names the pulse which begins with it.
const LATE_US: u64 = 1_000;

/// After the 71 minutes in which the board's clock has counted through, records no longer come
/// at multiples of 5 ms: by that they show how often it has.
const MOST_TURNS: u64 = 3;

/// The pulses of an output.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Frames(
    /// When each began, s, and its length, µs.
    pub(crate) Vec<(f64, f64)>,
);

/// A record: when it was made, s, the same on the board's clock, µs, and the pulse that it names,
/// µs.
pub(super) type Record = (f64, u32, f64);

impl Frames {
    /// The pulses that these records announce.
    pub(super) fn of(records: &[Record]) -> Self {
        // Since the last pulse began.
        let since = |board_us: u32, turns: u64| ((turns << 32) + u64::from(board_us)) % FRAME_US;
        let off = |board_us: u32, turns: u64| {
            let since_us = since(board_us, turns) % GRID_US;
            since_us.min(GRID_US - since_us)
        };
        let far = |turns: &u64| -> u64 {
            let records = records.iter();
            records.map(|(_, board_us, _)| off(*board_us, *turns)).sum()
        };
        let turns = (0..=MOST_TURNS).min_by_key(far).unwrap_or(0);
        // Until the pulse begins that the record names; none if a later record names it.
        let wait_us = |board_us: u32| match since(board_us, turns) {
            since_us @ ..=LATE_US => Some(-(since_us as f64)),
            since_us if FRAME_US - since_us < RECORD_US - LATE_US => {
                Some((FRAME_US - since_us) as f64)
            }
            _ => None,
        };
        let pulses = records.iter().filter_map(|(time, board_us, pulse)| {
            wait_us(*board_us).map(|wait_us| (time + 1e-6 * wait_us, *pulse))
        });
        Self(pulses.collect())
    }

    /// The pulse that acts at a time: the last one that has begun, or the first one.
    pub(crate) fn at(&self, time: f64) -> f64 {
        self.last(time).map_or(0.0, |(_, pulse)| pulse)
    }

    /// The mean over a time, which ends at `end` and is shorter than the time between two pulses.
    pub(crate) fn mean(&self, end: f64, lasts: f64) -> f64 {
        let Some((begin, pulse)) = self.last(end) else {
            return 0.0;
        };
        let share = ((end - begin) / lasts).clamp(0.0, 1.0);
        if share == 1.0 {
            return pulse;
        }
        share * pulse + (1.0 - share) * self.at(end - lasts)
    }

    fn last(&self, time: f64) -> Option<(f64, f64)> {
        let after = self.0.partition_point(|(begin, _)| *begin <= time);
        self.0.get(after.saturating_sub(1)).copied()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Records of a pulse that grows by 1 us with every record, `turns` after the board's start,
    /// made `after_us` after multiples of 10 ms.
    fn records(turns: u64, after_us: u64) -> Vec<Record> {
        (0..50_u32)
            .map(|n| {
                let since_start_us = (turns << 32) / 20_000 * 20_000 + 40_000;
                let late_us = after_us + 100 * u64::from(n % 3);
                let board_us = (since_start_us + 10_000 * u64::from(n) + late_us) as u32;
                let time = 1e-2 * f64::from(n) + 1e-6 * late_us as f64;
                (time, board_us, f64::from(n))
            })
            .collect()
    }

    #[test]
    fn a_pulse_is_that_of_the_last_record_before_it() {
        for turns in 0..=MOST_TURNS {
            let native = Frames::of(&records(turns, 0));
            for (time, pulse) in [(0.001, 0.0), (0.019, 0.0), (0.0205, 2.0), (0.117, 10.0)] {
                assert_eq!(native.at(time), pulse, "{turns}: {time}");
            }
            let image = Frames::of(&records(turns, 5_000));
            for (time, pulse) in [(0.021, 1.0), (0.039, 1.0), (0.0405, 3.0), (0.117, 9.0)] {
                assert_eq!(image.at(time), pulse, "{turns}: {time}");
            }
        }
        assert_eq!(Frames::default().at(1.0), 0.0);
        let frames = Frames(vec![(0.0, 10.0), (0.02, 20.0)]);
        for (end, mean) in [(0.019, 10.0), (0.021, 15.0), (0.022, 20.0), (-1.0, 10.0)] {
            assert!((frames.mean(end, 0.002) - mean).abs() < 1e-9, "{end}");
        }
    }
}
