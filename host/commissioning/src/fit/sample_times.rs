//! When the IMU measured what the board has read.
//!
//! The sensor makes a sample every 10 ms of its own clock, and the board reads it every 10 ms
//! of the board's clock: a sample waits in the sensor for up to a period before it is read, and
//! the stamp is that of the reading. The wait drifts with the difference of the two clocks. No
//! sample is lost, so that the number of a sample is known, and no reading is earlier than its
//! sample: the measurements lie on the line that supports the readings from below.

/// Length of the pieces in which the sensor's clock counts as even, s.
const PIECE: f64 = 20.0;

/// The sensor filters and computes for up to 2 ms before a sample can be read: half of it, s.
pub(crate) const SENSOR: f64 = 0.001;

/// A wait that varies less is that of a board which reads every sample as it comes, s.
const AT_ONCE: f64 = 0.000_5;

/// The times of samples.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SampleTimes {
    /// When each was measured, s.
    pub times: Vec<f64>,
    /// Bound on an error that all have in common, s.
    pub systematic: f64,
}

/// The times of the measurements from those of the readings, s, in their order.
#[must_use]
pub fn sample_times(readings: &[f64]) -> SampleTimes {
    let duration = readings.last().unwrap_or(&0.0) - readings.first().unwrap_or(&0.0);
    let pieces = (duration / PIECE).round().max(1.0) as usize;
    let length = readings.len().div_ceil(pieces).max(1);
    let mut times = Vec::with_capacity(readings.len());
    let mut unknown: f64 = 0.0;
    for piece in readings.chunks(length) {
        let (found, rest) = of_piece(piece);
        times.extend(found.iter().map(|time| time - rest - SENSOR));
        unknown = unknown.max(rest);
    }
    SampleTimes {
        times,
        systematic: SENSOR.hypot(unknown),
    }
}

/// The line below the readings, and half of the wait that they may all have had beyond it.
fn of_piece(readings: &[f64]) -> (Vec<f64>, f64) {
    let mut steps: Vec<f64> = readings.windows(2).map(|two| two[1] - two[0]).collect();
    steps.sort_by(f64::total_cmp);
    let Some(&period) = steps.get(steps.len() / 2).filter(|period| **period > 0.0) else {
        return (readings.to_vec(), 0.0);
    };
    // A reading comes up to half a period early or late.
    let mut number = 0.0;
    let mut points = vec![[0.0, readings[0]]];
    for two in readings.windows(2) {
        number += ((two[1] - two[0]) / period + 0.25).floor().max(1.0);
        points.push([number, two[1]]);
    }
    let line = supporting(&points, number / 2.0);
    let waits = points.iter().map(|[number, time]| time - line(*number));
    let longest = waits.fold(0.0, f64::max);
    if longest < AT_ONCE {
        // The stamps scatter by the steps of the protocol only.
        return (
            points.iter().map(|[number, _]| line(*number)).collect(),
            0.0,
        );
    }
    if longest > 1.3 * period {
        // Samples are missing: their numbers are not known.
        return (readings.to_vec(), 0.5 * period);
    }
    let rest = 0.5 * (period - longest).max(0.0);
    (
        points.iter().map(|[number, _]| line(*number)).collect(),
        rest,
    )
}

/// The line through two of the points, in the order of their first coordinates, that has none
/// below it and is the highest one at `at`.
fn supporting(points: &[[f64; 2]], at: f64) -> impl Fn(f64) -> f64 {
    let mut hull: Vec<[f64; 2]> = Vec::new();
    for point in points {
        while let [.., a, b] = hull[..] {
            let turn = (b[0] - a[0]) * (point[1] - a[1]) - (b[1] - a[1]) * (point[0] - a[0]);
            if turn > 0.0 {
                break;
            }
            hull.pop();
        }
        hull.push(*point);
    }
    let after = hull.partition_point(|point| point[0] < at);
    let after = after.clamp(1, hull.len().max(2) - 1);
    let begin = hull.get(after - 1).copied().unwrap_or_default();
    let end = hull.get(after).copied().unwrap_or(begin);
    let slope = if end[0] > begin[0] {
        (end[1] - begin[1]) / (end[0] - begin[0])
    } else {
        0.0
    };
    move |number| begin[1] + slope * (number - begin[0])
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Readings every 10 ms of a clock that is fast by `fast`, of samples every 10 ms.
    fn read(fast: f64, offset: f64) -> (Vec<f64>, Vec<f64>) {
        let (mut readings, mut samples) = (Vec::new(), Vec::new());
        let mut poll = offset;
        let mut next = 0;
        while poll < 30.0 {
            let newest = (poll / 0.01).floor() as i64;
            if newest >= next {
                assert_eq!(newest, next, "a sample is lost");
                readings.push(poll);
                samples.push(0.01 * newest as f64);
                next = newest + 1;
                // It looks again early from time to time, or a fast sensor would get ahead.
                let early = next % 10 == 5;
                poll += if early { 0.005 } else { 0.01 } * (1.0 - fast);
            } else {
                poll += 0.005 * (1.0 - fast);
            }
        }
        (readings, samples)
    }

    #[test]
    fn samples_that_wait_are_dated_back_to_their_measurement() {
        for (fast, offset) in [
            (0.003, 0.002),
            (-0.003, 0.009),
            (0.001, 0.0),
            (0.005, 0.004),
        ] {
            let (readings, samples) = read(fast, offset);
            let found = sample_times(&readings);
            let errors: Vec<f64> = found
                .times
                .iter()
                .zip(&samples)
                .map(|(found, truth)| found - (truth - SENSOR))
                .collect();
            let most = errors
                .iter()
                .fold(0.0, |most: f64, error| most.max(error.abs()));
            assert!(most <= found.systematic + 1e-4, "{fast}: {most} {found:?}");
            let waited = readings.iter().zip(&samples).map(|(r, s)| r - s);
            let mean = waited.sum::<f64>() / samples.len() as f64;
            assert!(mean > 0.001, "{fast}: {mean}");
        }
    }

    #[test]
    fn samples_that_are_read_at_once_keep_their_times() {
        // The age has steps of 0.1 ms.
        let readings: Vec<f64> = (0..2_000)
            .map(|n| (0.010_003 * f64::from(n) * 1e4).floor() / 1e4)
            .collect();
        let found = sample_times(&readings);
        assert_eq!(found.systematic, SENSOR);
        for (n, time) in found.times.iter().enumerate() {
            let truth = 0.010_003 * n as f64 - SENSOR;
            assert!((time - truth).abs() < 2e-4, "{n}");
        }
    }

    #[test]
    fn samples_that_are_lost_leave_a_wide_bound() {
        let mut readings: Vec<f64> = (0..1_000)
            .map(|n| 0.01 * f64::from(n) + 0.000_9 * f64::from(n % 10))
            .collect();
        for n in [300, 500, 700] {
            for reading in &mut readings[n..] {
                // By one and a half periods: neither one nor two.
                *reading += 0.015;
            }
        }
        let found = sample_times(&readings);
        assert!(found.systematic > 0.004, "{}", found.systematic);
        assert!(sample_times(&[]).times.is_empty());
        assert_eq!(sample_times(&[1.0]).times, [1.0 - SENSOR]);
    }
}
