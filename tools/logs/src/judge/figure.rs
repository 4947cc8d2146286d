//! The page of figures.

use singletrack_control::{PoseVerdict, Time};
use singletrack_figures::figure::{
    Axis, Column, Curve, Figure, Look, Mark, MarkKind, Panel, Symbol, Width,
};

use super::{
    run::{Judged, Run},
    score::Compared,
    truth,
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
                Some((at(judged.seen.time), innovation.log10()))
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
            "The estimate beside the cameras, smoothed with what came after, and the normalised \
                  innovation squared of each accepted pose."
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
        ],
    }
}

fn spans(run: &Run, begin: Time) -> Vec<[f64; 2]> {
    truth::ghosts_of(run.poses.iter().map(|judged| judged.seen))
        .into_iter()
        .map(|ghost| ghost.map(|time| time.seconds_since(begin)))
        .collect()
}
