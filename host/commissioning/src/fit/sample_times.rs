//! When the IMU measured what the board has read.
//!
//! The sensor makes a sample about every 10 ms of its own clock, and the board reads it every 10
//! ms of the board's clock: a sample waits in the sensor for up to a period before it is read,
//! and its stamp is that of the reading. The wait drifts with the difference of the two clocks.
//! Once in ten samples the board also looks half a period after a reading, and keeps what it
//! finds if it is new. That tells in which half of its period the sensor is: the wait is known to
//! a quarter of a period, and while it drifts through both halves its mean is known better.

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

/// A sample of the IMU was read.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Reading {
    /// When, s.
    pub(crate) time: f64,
    /// The same on the board's clock, µs.
    pub(crate) board_us: u32,
}

/// The times of samples.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct SampleTimes {
    /// When each was measured, s.
    pub(crate) times: Vec<f64>,
    /// Bound on an error that all have in common, s.
    pub(crate) systematic: f64,
}

/// The times of the measurements from those of the readings, in their order.
pub(crate) fn sample_times(readings: &[Reading]) -> SampleTimes {
    let times: Vec<f64> = readings.iter().map(|reading| reading.time).collect();
    let (waits, unknown) = if is_polled(readings) {
        waits(&times)
    } else {
        (vec![0.0; times.len()], 0.0)
    };
    let readings = times.iter().zip(waits);
    let measured = readings.map(|(time, wait)| time - wait - SENSOR);
    SampleTimes {
        times: measured.collect(),
        systematic: SENSOR.hypot(unknown),
    }
}

/// Whether the board reads in its own time: otherwise it reads a sample as it comes.
fn is_polled(readings: &[Reading]) -> bool {
    let Some(first) = readings.first() else {
        return false;
    };
    let kept = readings.iter().filter(|reading| {
        let off = reading.board_us.wrapping_sub(first.board_us) % ROUND_US;
        off.min(ROUND_US - off) <= KEPT_US
    });
    kept.count() * 10 >= readings.len() * 9
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
        let near = last
            .filter(|last| index - last <= 2 * LOOKS)
            .unwrap_or(index);
        second[near..=index].fill(true);
        last = Some(index);
    }
    // At the limit of the two it changes to and fro.
    let lasting = |half: &&[bool]| half.len() > 5 * LOOKS;
    let halves = second.chunk_by(|one, other| one == other).filter(lasting);
    let changes = halves.count().saturating_sub(1);
    let waits = second
        .iter()
        .zip(between)
        .map(|(second, between)| match (second, between) {
            (true, false) => 0.75 * PERIOD,
            _ => 0.25 * PERIOD,
        })
        .collect();
    (waits, 0.25 * PERIOD / changes.max(1) as f64)
}

#[cfg(test)]
mod tests {
    use super::*;

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
                readings.push(Reading {
                    time,
                    board_us: 5_000 * round,
                });
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
                let found = sample_times(&readings);
                let errors: Vec<f64> = found
                    .times
                    .iter()
                    .zip(&samples)
                    .map(|(found, truth)| found - (truth - SENSOR))
                    .collect();
                let mean = errors.iter().sum::<f64>() / errors.len() as f64;
                // Of the reading itself, in which a sample may come.
                let most = found.systematic.hypot(0.000_3);
                assert!(mean.abs() < most, "{fast}, {phase}: {mean} {found:?}");
                if fast.abs() > 0.002 {
                    assert!(found.systematic < 0.001_2, "{fast}: {}", found.systematic);
                }
                let waited = readings.iter().zip(&samples).map(|(r, s)| r.time - s);
                let waited = waited.sum::<f64>() / samples.len() as f64;
                assert!(fast.abs() < 0.002 || waited > 0.003, "{fast}: {waited}");
            }
        }
    }

    #[test]
    fn samples_that_are_read_at_once_keep_their_times() {
        let readings: Vec<Reading> = (0..2_000)
            .map(|n| Reading {
                time: 0.01 * f64::from(n),
                board_us: 10_030 * n as u32 / 100 * 100,
            })
            .collect();
        let found = sample_times(&readings);
        assert_eq!(found.systematic, SENSOR);
        for (reading, time) in readings.iter().zip(&found.times) {
            assert_eq!(*time, reading.time - SENSOR);
        }
    }

    #[test]
    fn few_readings_are_no_error() {
        assert!(sample_times(&[]).times.is_empty());
        let one = Reading {
            time: 1.0,
            board_us: 7,
        };
        assert_eq!(sample_times(&[one]).times.len(), 1);
    }
}
