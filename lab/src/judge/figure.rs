//! The page of figures.

use core::f64::consts::PI;

use singletrack_control::{PoseVerdict, Time};
use singletrack_figures::figure::{
    Axis, Column, Curve, Figure, Look, Mark, MarkKind, Panel, Scale, Symbol, Width,
};

use super::{
    run::{Judged, Run},
    score::{self, Compared},
    spectrum::density,
    truth::{self, Seen},
};

/// Time from the first pose, the same on every panel.
const FROM_START: Axis = Axis {
    include: Some(0.0),
    ..Axis::TIME
};

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
    let judged = |chosen: &dyn Fn(&Judged) -> bool| -> (Column, Column) {
        let points: Vec<(f64, f64)> = run
            .poses
            .iter()
            .filter(|judged| chosen(judged))
            .filter_map(|judged| {
                let innovation = judged.innovation?.max(1e-3);
                Some((at(judged.seen.time), libm::log10(innovation)))
            })
            .collect();
        (
            points.iter().map(|point| point.0).collect(),
            points.iter().map(|point| point.1).collect(),
        )
    };
    let (x, y) = judged(&|judged| judged.verdict == Some(PoseVerdict::Accepted));
    let mut innovations = Panel {
        begins_row: true,
        height_mm: 30.0,
        curves: vec![Curve::new("estimate", Look::Nominal, &x, y)],
        ..Panel::new(
            Axis::TIME,
            Axis::new("NIS of a pose, power of ten", None, ""),
        )
    };
    innovations.marks = run
        .stops
        .iter()
        .map(|stop| Mark {
            name: "stop",
            point: [stop.t_s, 0.0],
            kind: MarkKind::Found,
        })
        .collect();
    Figure {
        title: "What the pilot would have said".to_owned(),
        caption:
            "The estimate beside the cameras, smoothed with what came after; the normalised innovation \
                  squared of each accepted pose, and how often it is larger than a value, beside what it \
                  is for innovations as stated; and the noise of accelerometer and gyro while the car \
                  moves, by what they measure beyond the cameras."
                .to_owned(),
        width: Width::Page,
        panels: vec![
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
    }
}

/// How often the NIS of a pose is larger than a value.
fn distribution(run: &Run) -> Panel {
    const POINTS: i32 = 60;
    let mut found: Vec<f64> = run
        .poses
        .iter()
        .filter(|judged| judged.settled && score::counts(judged.seen.kind))
        .filter_map(|judged| judged.innovation)
        .collect();
    found.sort_by(f64::total_cmp);
    let values: Column = (0..=POINTS)
        .map(|point| libm::pow(10.0, -1.0 + 3.5 * f64::from(point) / f64::from(POINTS)))
        .collect();
    let least = 1.0 / found.len().max(1) as f64;
    let larger = |value: f64| {
        let smaller = found.partition_point(|innovation| *innovation <= value);
        1.0 - smaller as f64 * least
    };
    let shown = |share: f64| if share < least { f64::NAN } else { share };
    let share = values.iter().map(|value| shown(larger(*value))).collect();
    let stated = values.iter().map(|value| shown(chi_square_3(*value)));
    let logarithmic = |quantity| Axis {
        scale: Scale::Log,
        ..Axis::new(quantity, None, "")
    };
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
    let seen: Vec<Seen> = run.poses.iter().map(|judged| judged.seen).collect();
    let rows = score::differences(&seen, &run.samples);
    let curve = |name, look, axis: usize| {
        let moving = rows.iter().filter(|row| row.2.forward > score::SLOWEST);
        let samples: Vec<(Time, f64)> = moving
            .filter_map(|(time, _, _, differences)| Some((*time, *differences.get(axis)?)))
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
            Axis {
                scale: Scale::Log,
                ..Axis::new("noise", None, "1/\u{221a}Hz")
            },
        )
    }
}

fn spans(run: &Run, begin: Time) -> Vec<[f64; 2]> {
    truth::ghosts_of(run.poses.iter().map(|judged| judged.seen))
        .into_iter()
        .map(|ghost| ghost.map(|time| time.seconds_since(begin)))
        .collect()
}
