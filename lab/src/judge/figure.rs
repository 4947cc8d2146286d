//! The page of figures, and the spectra on it.

use core::f64::consts::{PI, TAU};

use singletrack_commissioning::seen::ghosts_of;
use singletrack_control::statistics::Distribution;
use singletrack_control::{PoseVerdict, Time};
use singletrack_figures::figure::{
    Axis, Column, Curve, Figure, Look, Mark, MarkKind, Panel, Symbol,
};

use super::{
    run::{Compared, Judged, Run, SLOWEST},
    score,
};

/// Time from the first pose, the same on every panel.
const FROM_START: Axis = Axis::TIME.including(0.0);

/// Estimate and cameras, and the innovations of the poses.
pub(super) fn of(run: &Run) -> Figure {
    let begin = run.poses.first().map_or(Time(0), |judged| judged.seen.time);
    let at = |time: Time| time.seconds_since(begin);
    let time: Column = run.compared.iter().map(|one| at(one.time)).collect();
    let column =
        |value: &dyn Fn(&Compared) -> f64| -> Column { run.compared.iter().map(value).collect() };
    let panel = |axis: Axis, truth: Column, estimate: Column| Panel {
        begins_row: true,
        height_mm: 30.0,
        curves: vec![
            Curve::new("estimate", Look::Nominal, &time, estimate),
            Curve::new("cameras, smoothed", Look::Actual, &time, truth),
        ],
        spans: spans(run, begin),
        span_name: "another body",
        ..Panel::new(FROM_START, axis)
    };
    let fast = |value: &dyn Fn(&Compared) -> f64| {
        column(&|one| if one.is_fast() { value(one) } else { f64::NAN })
    };
    let accepted = |judged: &&Judged| judged.verdict == Some(PoseVerdict::Accepted);
    let accepted = run.poses.iter().filter(accepted).filter_map(|judged| {
        let innovation = judged.innovation?.max(1e-3);
        Some((at(judged.seen.time), libm::log10(innovation)))
    });
    let (x, y): (Vec<f64>, Vec<f64>) = accepted.unzip();
    let stops = run.stops.iter().map(|stop| Mark {
        name: "stop",
        point: [stop.t_s, 0.0],
        kind: MarkKind::Found,
    });
    let nis = Axis::new("NIS of a pose, power of ten", None, "");
    let innovations = Panel {
        begins_row: true,
        height_mm: 30.0,
        curves: vec![Curve::new("estimate", Look::Nominal, &x.into(), y.into())],
        marks: stops.collect(),
        ..Panel::new(Axis::TIME, nis)
    };
    Figure::page(
        "What the pilot would have said",
        "The estimate beside the cameras, smoothed with what came after; the normalised innovation \
         squared of each accepted pose, and how often it is larger than a value, beside what it \
         is for innovations as stated; and the noise of accelerometer and gyro while the car \
         moves, by what they measure beyond the cameras.",
        vec![
            panel(
                Axis::new("speed", Some(Symbol::new("v", "")), "m/s"),
                column(&|one| one.truth.speed()),
                column(&|one| one.speed),
            ),
            panel(
                Axis::new("yaw rate", Some(Symbol::new("r", "")), "rad/s"),
                column(&|one| one.truth.yaw_rate),
                column(&|one| one.yaw_rate),
            ),
            panel(
                Axis::new("sideslip", Some(Symbol::new("β", "")), "rad"),
                fast(&|one| one.truth.sideslip()),
                fast(&|one| one.sideslip),
            ),
            innovations,
            distribution(run),
            spectra(run),
        ],
    )
}

/// How often the NIS of a pose is larger than a value.
fn distribution(run: &Run) -> Panel {
    const POINTS: i32 = 60;
    let poses = run.poses.iter();
    let counted = poses.filter(|judged| judged.settled && score::counts(judged.seen.kind));
    let found = Distribution::of(counted.filter_map(|judged| judged.innovation));
    let values: Column = (0..=POINTS)
        .map(|point| libm::pow(10.0, -1.0 + 3.5 * f64::from(point) / f64::from(POINTS)))
        .collect();
    let least = 1.0 / found.count().max(1) as f64;
    let larger = |value: f64| 1.0 - found.count_up_to(value) as f64 * least;
    let shown = |share: f64| if share < least { f64::NAN } else { share };
    let share = values.iter().map(|value| shown(larger(*value))).collect();
    let stated = values.iter().map(|value| shown(chi_square_3(*value)));
    let logarithmic = |quantity| Axis::new(quantity, None, "").logarithmic();
    Panel {
        begins_row: true,
        height_mm: 40.0,
        curves: vec![
            Curve::new("poses", Look::Actual, &values, share),
            Curve::new("as stated", Look::Other, &values, stated.collect()),
        ],
        ..Panel::new(logarithmic("NIS"), logarithmic("share of larger ones"))
    }
}

/// The share of a chi-square distribution with three degrees of freedom above a value.
fn chi_square_3(value: f64) -> f64 {
    libm::erfc((0.5 * value).sqrt()) + (2.0 * value / PI).sqrt() * libm::exp(-0.5 * value)
}

/// The noise of the IMU over the frequency.
fn spectra(run: &Run) -> Panel {
    let rows = score::differences(&run.track, &run.samples);
    let curve = |name, look, axis: usize| {
        let moving = rows.iter().filter(|row| row.2.forward > SLOWEST);
        let samples: Vec<(Time, f64)> = moving
            .map(|(time, _, _, differences)| (*time, differences[axis]))
            .filter(|(_, difference)| difference.is_finite())
            .collect();
        let (frequency, density): (Vec<f64>, Vec<f64>) = density(&samples).into_iter().unzip();
        Curve::new(name, look, &frequency.into(), density.into())
    };
    Panel {
        height_mm: 40.0,
        curves: vec![
            curve("forward, m/s\u{b2}", Look::Actual, 0),
            curve("to the left, m/s\u{b2}", Look::Other, 1),
            curve("gyro, rad/s", Look::Nominal, 2),
        ],
        ..Panel::new(
            Axis::new("frequency", Some(Symbol::new("f", "")), "Hz"),
            Axis::new("noise", None, "1/\u{221a}Hz").logarithmic(),
        )
    }
}

fn spans(run: &Run, begin: Time) -> Vec<[f64; 2]> {
    ghosts_of(run.poses.iter().map(|judged| judged.seen))
        .into_iter()
        .map(|ghost| ghost.map(|time| time.seconds_since(begin)))
        .collect()
}

/// Samples of a segment.
const SEGMENT: usize = 64;
/// Samples that are farther apart than this many times the usual interval begin a new segment.
const APART: f64 = 1.5;

/// The one-sided density of a signal over the frequency, in Hz and in its unit per root of a Hz: the
/// mean over half-overlapping segments with a Hann window (Welch). Empty without a whole segment.
pub(super) fn density(samples: &[(Time, f64)]) -> Vec<(f64, f64)> {
    let mut intervals: Vec<f64> = samples
        .windows(2)
        .map(|pair| pair[1].0.seconds_since(pair[0].0))
        .collect();
    intervals.sort_by(f64::total_cmp);
    let Some(&interval) = intervals.get(intervals.len() / 2) else {
        return Vec::new();
    };
    let mut sums = [0.0; SEGMENT / 2];
    let mut segments = 0.0;
    for segment in samples.windows(SEGMENT).step_by(SEGMENT / 2) {
        let mut steps = segment.windows(2);
        let whole = steps.all(|pair| pair[1].0.seconds_since(pair[0].0) < APART * interval);
        if !whole {
            continue;
        }
        segments += 1.0;
        let mean = segment.iter().map(|(_, value)| value).sum::<f64>() / SEGMENT as f64;
        for (bin, sum) in sums.iter_mut().enumerate() {
            let (mut real, mut imaginary) = (0.0, 0.0);
            for (index, (_, value)) in segment.iter().enumerate() {
                let turn = TAU * index as f64 / SEGMENT as f64;
                let windowed = (value - mean) * 0.5 * (1.0 - libm::cos(turn));
                let (sine, cosine) = libm::sincos(bin as f64 * turn);
                real += windowed * cosine;
                imaginary -= windowed * sine;
            }
            *sum += real * real + imaginary * imaginary;
        }
    }
    if segments == 0.0 {
        return Vec::new();
    }
    // The mean square of the window is 3/8.
    let power = 2.0 * interval / (segments * 0.375 * SEGMENT as f64);
    let frequency = 1.0 / (interval * SEGMENT as f64);
    sums.iter()
        .enumerate()
        .skip(1)
        .map(|(bin, sum)| (bin as f64 * frequency, (sum * power).sqrt()))
        .collect()
}

#[cfg(test)]
mod tests {
    use singletrack_control::statistics::Random;

    use super::*;

    fn signal(every_ms: u64, value: impl Fn(f64) -> f64) -> Vec<(Time, f64)> {
        (0..4_000)
            .map(|index| {
                let time = Time(index * every_ms * 1_000_000);
                (time, value((index * every_ms) as f64 * 1e-3))
            })
            .collect()
    }

    #[test]
    fn white_noise_has_its_density_at_every_frequency() {
        // Uniform between -1 and 1, ten and a hundred times a second: 1/3 over half the rate.
        for (every_ms, density_of_it) in [
            (100, (1.0_f64 / 15.0).sqrt()),
            (10, (1.0_f64 / 150.0).sqrt()),
        ] {
            let random = core::cell::RefCell::new(Random::new(1));
            let noise = signal(every_ms, |_| random.borrow_mut().between(-1.0, 1.0));
            let found = density(&noise);
            assert_eq!(found.len(), SEGMENT / 2 - 1);
            let mean =
                found.iter().map(|(_, value)| value * value).sum::<f64>() / found.len() as f64;
            let ratio = mean.sqrt() / density_of_it;
            assert!((ratio - 1.0).abs() < 0.1, "{every_ms} ms: {ratio}");
        }
    }

    #[test]
    fn a_vibration_stands_at_its_frequency_and_segments_do_not_cross_gaps() {
        let mut shaken = signal(10, |time| libm::sin(TAU * 12.5 * time));
        let found = density(&shaken);
        let highest = found.iter().max_by(|one, other| one.1.total_cmp(&other.1));
        assert!((highest.unwrap().0 - 12.5).abs() < 0.1);
        shaken.retain(|(time, _)| time.0 % 300_000_000 != 0);
        assert_eq!(density(&shaken), []);
        assert_eq!(density(&[]), []);
    }
}
