//! The delay between two sensors that see the same motion, and when the IMU measured what the board
//! has read.
//!
//! The sensor makes a sample about every 10 ms of its own clock, and the board reads it every 10
//! ms of the board's clock: a sample waits in the sensor for up to a period before it is read,
//! and its stamp is that of the reading. The wait drifts with the difference of the two clocks.
//! Once in ten samples the board also looks half a period after a reading, and keeps what it
//! finds if it is new. That tells in which half of its period the sensor is: the wait is known to
//! a quarter of a period, and while it drifts through both halves its mean is known better.

use crate::{
    Interval,
    fit::{jackknife, least_squares},
};

/// Result of [`stamp_delay`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Delay {
    /// The time by which the stamps of the angles are too late, in s.
    pub(crate) late: Interval,
    /// Angle of the cameras over angle of the gyro.
    pub(crate) scale: Interval,
}

/// The largest delay that is looked for, in s.
const RANGE: f64 = 0.25;
/// Its steps, in s: shorter than a quarter of a period of a twist.
const STEP: f64 = 0.025;
/// Steps of Gauss and Newton; each squares the error.
const STEPS: usize = 6;
/// Blocks for the interval.
const BLOCKS: usize = 10;

/// The time by which the stamps of `angles` (s, rad, unwrapped) are too late, from angular velocities
/// (s, rad/s) of the same motion. A constant bias of the velocities does not matter.
/// `systematic` bounds the error of the stamps of the velocities, in s. None if the motion does
/// not tell.
pub(crate) fn stamp_delay(
    angles: &[[f64; 2]],
    velocities: &[[f64; 2]],
    systematic: f64,
) -> Option<Delay> {
    let turned = Turned::new(velocities)?;
    // All delays are compared on the same angles.
    let usable = angles.iter().copied();
    let usable: Vec<[f64; 2]> = usable
        .filter(|[time, _]| turned.covers(time - RANGE) && turned.covers(time + RANGE))
        .collect();
    if usable.len() < 10 * BLOCKS {
        return None;
    }
    let steps = (RANGE / STEP) as i32;
    let (_, first) = (-steps..=steps)
        .filter_map(|step| {
            let late = f64::from(step) * STEP;
            let fit = least_squares(usable.iter().map(|[time, angle]| {
                let (turned, _) = turned.at(time - late);
                ([1.0, *time, turned], *angle)
            }))?;
            Some((fit.residual, late))
        })
        .min_by(|left, right| left.0.total_cmp(&right.0))?;
    let solve = |blocks: &[&&[[f64; 2]]]| {
        let mut late = first;
        let mut scale = 1.0;
        for _ in 0..STEPS {
            let rows = blocks.iter().flat_map(|block| block.iter());
            let fit = least_squares(rows.map(|[time, angle]| {
                let (turned, velocity) = turned.at(time - late);
                ([1.0, *time, turned, -velocity], *angle)
            }))?;
            scale = fit.parameters[2];
            late = (late + fit.parameters[3] / scale).clamp(-2.0 * RANGE, 2.0 * RANGE);
        }
        Some([late, scale])
    };
    let blocks: Vec<&[[f64; 2]]> = usable.chunks_exact(usable.len() / BLOCKS).collect();
    let [late, scale] = jackknife(&blocks, [systematic, 0.0], solve)?;
    Some(Delay { late, scale })
}

/// The integral of angular velocities.
struct Turned {
    /// Time, velocity and angle.
    points: Vec<(f64, f64, f64)>,
}

impl Turned {
    fn new(velocities: &[[f64; 2]]) -> Option<Self> {
        let mut points: Vec<(f64, f64, f64)> = Vec::new();
        for &[time, velocity] in velocities {
            let angle = match points.last() {
                None => 0.0,
                Some((last, ..)) if time <= *last => continue,
                Some((last, other, angle)) => {
                    angle + (time - last) * f64::midpoint(velocity, *other)
                }
            };
            points.push((time, velocity, angle));
        }
        (points.len() > 1).then_some(Self { points })
    }

    fn covers(&self, time: f64) -> bool {
        let ends = self.points.first().zip(self.points.last());
        ends.is_some_and(|(first, last)| (first.0..last.0).contains(&time))
    }

    /// Angle and velocity at a time.
    fn at(&self, time: f64) -> (f64, f64) {
        let after = self.points.partition_point(|point| point.0 <= time);
        let after = after.clamp(1, self.points.len() - 1);
        let (begin, begin_velocity, begin_angle) = self.points[after - 1];
        let (end, end_velocity, _) = self.points[after];
        let since = time - begin;
        let slope = (end_velocity - begin_velocity) / (end - begin);
        (
            begin_angle + since * (begin_velocity + since * slope / 2.0),
            begin_velocity + since * slope,
        )
    }
}

/// The sensor filters and computes for up to 2 ms before a sample can be read: half of it, s.
const SENSOR: f64 = 0.001;

/// The period of the sensor, s.
const PERIOD: f64 = 0.01;

/// The main loop of the board, in which it reads the sensor, µs, and how well the stamps keep
/// it.
const ROUND_US: u32 = 5_000;
const KEPT_US: u32 = 200;

/// Number of readings in which the board has looked between two samples.
const LOOKS: usize = 10;

/// When a sample of the IMU was read, s, and its time on the board's clock, µs.
pub(crate) type Reading = (f64, u32);

/// The times of the measurements, s, from those of the readings, in their order; and a bound on an
/// error that all have in common, s.
pub(crate) fn sample_times(readings: &[Reading]) -> (Vec<f64>, f64) {
    let times: Vec<f64> = readings.iter().map(|(time, _)| *time).collect();
    let (waits, unknown) = match is_polled(readings) {
        true => waits(&times),
        false => (vec![0.0; times.len()], 0.0),
    };
    let readings = times.iter().zip(waits);
    let measured = readings.map(|(time, wait)| time - wait - SENSOR);
    (measured.collect(), SENSOR.hypot(unknown))
}

/// Whether the board reads in its own time: otherwise it reads a sample as it comes.
fn is_polled(readings: &[Reading]) -> bool {
    readings.first().is_some_and(|(_, first_us)| {
        let kept = readings.iter().filter(|(_, board_us)| {
            let off = board_us.wrapping_sub(*first_us) % ROUND_US;
            off.min(ROUND_US - off) <= KEPT_US
        });
        kept.count() * 10 >= readings.len() * 9
    })
}

/// How long each sample waited for its reading, and a bound on the error of their mean, s.
fn waits(times: &[f64]) -> (Vec<f64>, f64) {
    let step = |index: usize| times[index] - times[index - 1];
    // Readings half a period after one, until the board is back at its usual time.
    let mut is_between = false;
    let between: Vec<bool> = (0..times.len())
        .map(|index| {
            if index > 0 {
                let step = step(index);
                is_between = step < 0.75 * PERIOD || is_between && step < 1.25 * PERIOD;
            }
            is_between
        })
        .collect();
    // In the second half of the sensor's period one is found between two.
    let mut last = None;
    let mut second: Vec<bool> = vec![false; times.len()];
    for (index, _) in between.iter().enumerate().filter(|(_, between)| **between) {
        let near = last.filter(|last| index - last <= 2 * LOOKS);
        second[near.unwrap_or(index)..=index].fill(true);
        last = Some(index);
    }
    // At the limit of the two it changes to and fro.
    let lasting = |half: &&[bool]| half.len() > 5 * LOOKS;
    let halves = second.chunk_by(|one, other| one == other).filter(lasting);
    let changes = halves.count().saturating_sub(1);
    let waits = second.iter().zip(between);
    let waits = waits.map(|(second, between)| match (second, between) {
        (true, false) => 0.75 * PERIOD,
        _ => 0.25 * PERIOD,
    });
    (waits.collect(), 0.25 * PERIOD / changes.max(1) as f64)
}

#[cfg(test)]
mod tests {
    use core::f64::consts::TAU;

    use singletrack_control::statistics::Random;

    use super::*;

    /// A twist by hand, seen by a gyro and by cameras whose stamps are too late.
    fn twist(seed: u64, late: f64, sign: f64) -> Option<Delay> {
        let mut noise = Random::new(seed);
        let period = 0.9 + 0.4 * noise.uniform();
        let yaw = |time: f64| 0.5 * (TAU * time / period).sin() + 0.2 * (0.7 * time).sin();
        let rate = |time: f64| (yaw(time + 1e-4) - yaw(time - 1e-4)) / 2e-4;
        let bias = 0.01 * noise.normal(1.0);
        let velocities: Vec<_> = (0..1_200)
            .map(|index| {
                let time = 0.01 * f64::from(index) + 0.003;
                // Rounded to the steps of the protocol.
                let read = rate(time) + bias + 0.003 * noise.normal(1.0);
                [time, sign * (read * 1e3).round() / 1e3]
            })
            .collect();
        let angles: Vec<_> = (0..1_200)
            .map(|index| {
                let time = 0.01 * f64::from(index);
                [time, yaw(time - late) + 0.001_7 * noise.normal(1.0)]
            })
            .collect();
        stamp_delay(&angles, &velocities, 0.0)
    }

    #[test]
    fn a_gyro_of_the_other_sign_has_a_scale_of_the_other_sign() {
        let delay = twist(1, 0.01, -1.0).unwrap();
        assert!((delay.scale.value + 1.0).abs() < 0.01, "{delay:?}");
    }

    #[test]
    fn a_car_that_stands_tells_no_delay() {
        let still: Vec<_> = (0..1_200)
            .map(|index| [0.01 * f64::from(index), 0.0])
            .collect();
        assert_eq!(stamp_delay(&still, &still, 0.0), None);
        assert_eq!(stamp_delay(&[], &[], 0.0), None);
    }

    /// Left out of `cargo verify`, not of `--all`: they take seconds of processor time each.
    mod thorough {
        use super::*;

        #[test]
        fn delays_of_either_sign_are_inside_their_intervals() {
            let mut held = 0;
            let trials = 200;
            for seed in 0..trials {
                let late = 0.06 * (Random::new(seed + 7_000).uniform() - 0.5);
                let delay = twist(seed, late, 1.0).unwrap();
                assert!(
                    (delay.late.value - late).abs() < 0.002,
                    "{delay:?} for {late}"
                );
                assert!(delay.late.half_width() < 0.002, "{delay:?}");
                assert!((delay.scale.value - 1.0).abs() < 0.01, "{delay:?}");
                held += u64::from(delay.late.contains(late));
            }
            assert!(held * 100 >= trials * 90, "{held} of {trials}");
        }
    }

    /// A board whose clock is fast reads samples that come every 10 ms from `phase` on: the
    /// readings, and the samples.
    fn read(fast: f64, phase: f64) -> (Vec<Reading>, Vec<f64>) {
        let (mut readings, mut samples) = (Vec::new(), Vec::new());
        // A reading takes a while: it may begin with one sample and end with the next.
        let at = |time: f64| ((time - phase) / 0.01).floor();
        let mut kept = [f64::NAN; 2];
        let mut count = 0;
        // In rounds of the board.
        let mut round = 0_u32;
        while round < 2_400 {
            let time = 0.005 * f64::from(round) / (1.0 + fast);
            let read = [at(time), at(time + 0.000_7)];
            let is_new = read != kept;
            kept = read;
            if is_new {
                count += 1;
                samples.push(phase + 0.01 * read[0]);
                readings.push((time, 5_000 * round));
            }
            round += if count % 10 == 0 && is_new {
                // Together with its records again.
                2 + round % 2
            } else if !is_new || count % 10 == 5 {
                1
            } else {
                2
            };
        }
        (readings, samples)
    }

    #[test]
    fn samples_that_wait_are_dated_back_to_their_measurement_on_the_average() {
        for fast in [0.003, -0.003, 0.001, 0.005, -0.000_5, 0.000_1, 0.0] {
            for phase in [0.001, 0.003, 0.005, 0.007, 0.009] {
                let (readings, samples) = read(fast, phase);
                let (times, systematic) = sample_times(&readings);
                let errors: Vec<f64> = times
                    .iter()
                    .zip(&samples)
                    .map(|(found, truth)| found - (truth - SENSOR))
                    .collect();
                let mean = errors.iter().sum::<f64>() / errors.len() as f64;
                // Of the reading itself, in which a sample may come.
                let most = systematic.hypot(0.000_3);
                assert!(mean.abs() < most, "{fast}, {phase}: {mean} {times:?}");
                if fast.abs() > 0.002 {
                    assert!(systematic < 0.001_2, "{fast}: {systematic}");
                }
                let waited = readings.iter().zip(&samples);
                let waited = waited.map(|((time, _), sample)| time - sample);
                let waited = waited.sum::<f64>() / samples.len() as f64;
                assert!(fast.abs() < 0.002 || waited > 0.003, "{fast}: {waited}");
            }
        }
    }

    #[test]
    fn samples_that_are_read_at_once_keep_their_times() {
        let readings: Vec<Reading> = (0..2_000)
            .map(|n| (0.01 * f64::from(n), 10_030 * n as u32 / 100 * 100))
            .collect();
        let (times, systematic) = sample_times(&readings);
        assert_eq!(systematic, SENSOR);
        for ((read, _), time) in readings.iter().zip(&times) {
            assert_eq!(*time, read - SENSOR);
        }
    }

    #[test]
    fn few_readings_are_no_error() {
        assert!(sample_times(&[]).0.is_empty());
        assert_eq!(sample_times(&[(1.0, 7)]).0.len(), 1);
    }
}
