//! The path of P on the floor.

use super::LOST;
use crate::{
    figure::{Column, Curve, Figure, Look, Mark, MarkKind, Panel, Width},
    plot::drive::Drive,
};

pub(super) fn trajectory(drive: &Drive) -> Figure {
    let time = drive.column(|tick| tick.time);
    let nominal = drive.nominal();
    let nominal = |axis: usize| drive.spread(nominal.iter().map(|point| point[axis]));
    let actual = |axis: usize| drive.column(|tick| tick.point[axis]);
    let truth = |axis: usize| drive.truth_column(|sample| sample.point[axis]);
    let over = |time: &Column, name, look, coordinate: &dyn Fn(usize) -> Column| Curve {
        time: Some(time.clone()),
        ..Curve::new(name, look, &coordinate(0), coordinate(1))
    };
    let true_time = drive.truth_column(|sample| sample.time);
    let curves = vec![
        lost(drive),
        over(&time, "nominal", Look::Nominal, &nominal),
        over(&time, "actual", Look::Actual, &actual),
        over(&true_time, "true (simulation)", Look::Truth, &truth),
    ];
    let seen = || {
        drive
            .ticks
            .iter()
            .map(|tick| tick.point)
            .filter(|point| point[0].is_finite())
    };
    let ends = [
        ("start", MarkKind::Start, seen().next()),
        ("end", MarkKind::End, seen().next_back()),
    ];
    Figure {
        title: "Trajectory of P".to_owned(),
        caption: format!(
            "Where P should be and where it was on the floor, from the triangle to the circle, \
             where the {}.",
            if drive.ended.is_some() {
                "drive ended"
            } else {
                "record ends"
            }
        ),
        width: Width::Column,
        panels: vec![Panel {
            height_mm: 90.0,
            curves,
            marks: ends
                .into_iter()
                .filter_map(|(name, kind, point)| point.map(|point| Mark { name, point, kind }))
                .collect(),
            ..Panel::floor("P")
        }],
    }
}

/// The path while the markers were lost: the true one if it is known, or what
/// the estimate held and then jumped to.
fn lost(drive: &Drive) -> Curve {
    let spans = drive.lost_markers();
    let true_path = drive
        .truth
        .iter()
        .flatten()
        .map(|sample| (sample.time, sample.point));
    let estimated = drive.ticks.iter().map(|tick| (tick.time, tick.point));
    let path: Vec<(f64, [f64; 2])> = if drive.truth.is_some() {
        true_path.collect()
    } else {
        estimated.collect()
    };
    let mut points = Vec::new();
    for [from, to] in spans {
        let first = path.partition_point(|(time, _)| *time < from);
        let end = path.partition_point(|(time, _)| *time <= to);
        // With the last point that was seen.
        points.extend(path.iter().take(end).skip(first.saturating_sub(1)));
        points.push((to, [f64::NAN; 2]));
    }
    let column = |axis: usize| {
        points
            .iter()
            .map(|(_, point)| point[axis])
            .collect::<Column>()
    };
    Curve {
        time: Some(points.iter().map(|(time, _)| *time).collect()),
        ..Curve::new(LOST, Look::Lost, &column(0), column(1))
    }
}
