//! Figures over time, and the path of P on the floor.

use super::LOST;
use crate::{
    figure::{Axis, Column, Curve, Figure, Look, Mark, MarkKind, Panel, Scale, Symbol},
    plot::drive::{Drive, Sample, TickSample},
};

/// The lowest tracking error on its logarithmic axis, in mm.
const LEAST_ERROR: f64 = 0.1;

/// Samples farther apart than this were not neighbours, in s: a line between them
/// would be invented.
const GAP: f64 = 0.25;

/// A panel over the time of the drive, with the spans without markers.
fn over_time(drive: &Drive, y: Axis, curves: Vec<Curve>) -> Panel {
    Panel {
        spans: drive.lost_markers(),
        span_name: LOST,
        curves,
        ..Panel::new(Axis::TIME, y)
    }
}

const fn axis(
    quantity: &'static str,
    letter: &'static str,
    below: &'static str,
    unit: &'static str,
) -> Axis {
    Axis::new(quantity, Some(Symbol::new(letter, below)), unit)
}

/// A number for each sample, with a gap where samples are missing.
fn column<S: Sample>(samples: &[S], value: impl Fn(&S) -> f64) -> Column {
    let neighbours = samples.chunk_by(|one, next| next.time() - one.time() <= GAP);
    let mut column = Vec::new();
    for run in neighbours {
        if !column.is_empty() {
            column.push(f64::NAN);
        }
        column.extend(run.iter().map(&value));
    }
    column.into()
}

/// A line through a number of each sample.
fn line<S: Sample>(
    samples: &[S],
    name: &'static str,
    look: Look,
    value: impl Fn(&S) -> f64,
) -> Curve {
    let time = column(samples, Sample::time);
    Curve::new(name, look, &time, column(samples, value))
}

/// A line through a place of each sample.
fn path<S: Sample>(
    samples: &[S],
    name: &'static str,
    look: Look,
    place: impl Fn(&S) -> [f64; 2],
) -> Curve {
    let [x, y] = [0, 1].map(|axis: usize| column(samples, |sample| place(sample)[axis]));
    Curve {
        time: Some(column(samples, Sample::time)),
        ..Curve::new(name, look, &x, y)
    }
}

/// A part of a caption that is not always true.
const fn only_if(is_so: bool, part: &str) -> &str {
    if is_so { part } else { "" }
}

pub(super) fn commanded_velocity(drive: &Drive) -> Figure {
    let panel = |below, along: usize| {
        let y = axis("velocity", "v", below, "m/s");
        let velocity = |tick: &TickSample| tick.point_velocity[along];
        let curves = vec![line(&drive.ticks, "commanded", Look::Actual, velocity)];
        over_time(drive, y, curves)
    };
    Figure::page(
        "Commanded velocity of P",
        "The velocity that the position loop, or the reference alone, asks of the \
         point P along x and y: the input of the linearising law.",
        vec![panel("Px", 0), panel("Py", 1)],
    )
}

pub(super) fn steering(drive: &Drive) -> Figure {
    let curves = vec![
        line(&drive.ticks, "commanded", Look::Actual, |it| it.steering),
        line(&drive.truth, "true", Look::Truth, |it| it.steering),
    ];
    Figure::column(
        "Steering angle commanded by the law",
        "The steering angle that the linearising law asks for, after the limits of \
         angle and rate; left is positive.",
        vec![over_time(drive, axis("steering", "δ", "", "rad"), curves)],
    )
}

pub(super) fn speed(drive: &Drive) -> Figure {
    let (ticks, board) = (&drive.ticks, &drive.board);
    let curves = vec![
        line(ticks, "reference", Look::Nominal, |it| it.commanded_speed),
        line(ticks, "actual", Look::Actual, |it| it.speed),
        // Above what is estimated from them, which would hide them.
        line(board, "motor pulses", Look::Measured, |it| it.motor_speed),
        line(&drive.truth, "true", Look::Truth, |it| it.speed),
    ];
    let pulses = ", and of the rear axle as the motor's pulses measure it";
    let pulses = only_if(!drive.board.is_empty(), pulses);
    Figure::column(
        "Reference and actual speed",
        format!(
            "The speed of the centre of mass that the law asks for, after limits, and the car's: \
             as estimated{pulses}."
        ),
        vec![over_time(drive, axis("speed", "v", "", "m/s"), curves)],
    )
}

pub(super) fn position(drive: &Drive) -> Figure {
    let panel = |letter, along: usize| {
        let (ticks, truth) = (&drive.ticks, &drive.truth);
        let curves = vec![
            line(ticks, "nominal", Look::Nominal, |it| it.nominal[along]),
            line(ticks, "actual", Look::Actual, |it| it.point[along]),
            line(truth, "true", Look::Truth, |it| it.point[along]),
        ];
        over_time(drive, axis("position", letter, "P", "m"), curves)
    };
    let wanted = match drive.has_positions() {
        true => "Where the reference wants P",
        false => "Where P would be if it integrated its commanded velocity",
    };
    let held = "; while the markers are lost the last pose is held and the curves stay level though \
                the car moves";
    let held = only_if(!drive.lost_markers().is_empty(), held);
    Figure::page(
        "Position of P over time",
        format!("{wanted}, and where P was{held}."),
        vec![panel("x", 0), panel("y", 1)],
    )
}

pub(super) fn sideslip_and_yaw_rate(drive: &Drive) -> Figure {
    let sideslip = vec![
        line(&drive.ticks, "estimated", Look::Actual, |it| it.sideslip),
        line(&drive.truth, "true", Look::Truth, |it| it.sideslip),
    ];
    let gyro = line(&drive.board, "gyro", Look::Measured, |it| it.yaw_rate);
    let has_gyro = !gyro.is_empty();
    let yaw_rate = vec![
        gyro,
        line(&drive.ticks, "estimated", Look::Actual, |it| it.yaw_rate),
        line(&drive.truth, "true", Look::Truth, |it| it.yaw_rate),
    ];
    Figure::page(
        "Sideslip angle and yaw rate",
        format!(
            "The estimated angle from the car's axis to the velocity of its centre of mass, and \
             its yaw rate{}; left is positive.",
            only_if(has_gyro, " over the gyro's samples")
        ),
        vec![
            over_time(drive, axis("sideslip", "β", "", "rad"), sideslip),
            over_time(drive, axis("yaw rate", "r", "", "rad/s"), yaw_rate),
        ],
    )
}

pub(super) fn tracking_error(drive: &Drive) -> Figure {
    let true_errors = drive.truth.iter().map(|sample| drive.true_error(sample));
    let errors = drive.ticks.iter().map(TickSample::error).chain(true_errors);
    let errors: Vec<f64> = errors.filter(|error| error.is_finite()).collect();
    let least = errors.iter().copied().fold(f64::INFINITY, f64::min);
    let most = errors.iter().copied().fold(0.0, f64::max);
    // The approach and the last millimetres on one axis; but errors of one size as they are.
    let is_wide = most > 10.0 * least;
    let y = Axis {
        scale: if is_wide { Scale::Log } else { Scale::Linear },
        include: (!is_wide).then_some(0.0),
        ..axis("tracking error", "e", "P", "mm")
    };
    let is_below = |error: f64| error * 1000.0 < LEAST_ERROR;
    let is_cut = is_below(least);
    // A comparison keeps the gaps, which `max` fills.
    let mm = |error: f64| match is_below(error) {
        true => LEAST_ERROR,
        false => error * 1000.0,
    };
    let (ticks, truth) = (&drive.ticks, &drive.truth);
    let curves = vec![
        line(ticks, "estimated", Look::Actual, |it| mm(it.error())),
        line(truth, "true", Look::Truth, |it| mm(drive.true_error(it))),
    ];
    Figure::column(
        "Tracking error of P",
        format!(
            "Distance from P to where it should be at that moment{}{}.",
            only_if(is_wide, ", on a logarithmic axis"),
            only_if(is_cut && is_wide, "; what is below 0.1 mm is drawn there")
        ),
        vec![over_time(drive, y, curves)],
    )
}

pub(super) fn trajectory(drive: &Drive) -> Figure {
    let what = match drive.is_estimated() {
        true => "P",
        false => "the rigid body",
    };
    let end = match drive.ended {
        Some(_) => "drive ended",
        None => "record ends",
    };
    let places = drive.ticks.iter().map(|tick| tick.point);
    let mut seen = places.filter(|point| point[0].is_finite());
    let start = seen.next();
    let ends = [
        ("start", MarkKind::Start, start),
        ("end", MarkKind::End, seen.next_back().or(start)),
    ];
    let mark = |(name, kind, point): (_, _, Option<_>)| {
        Some(Mark {
            name,
            kind,
            point: point?,
        })
    };
    Figure::column(
        format!("Trajectory of {what}"),
        format!(
            "Where {what} should be and where it was on the floor, from the triangle to the circle, \
             where the {end}."
        ),
        vec![Panel {
            height_mm: 90.0,
            curves: vec![
                lost(drive),
                path(&drive.ticks, "nominal", Look::Nominal, |it| it.nominal),
                path(&drive.ticks, "actual", Look::Actual, |it| it.point),
                path(&drive.truth, "true", Look::Truth, |it| it.point),
            ],
            marks: ends.into_iter().filter_map(mark).collect(),
            ..Panel::floor("P")
        }],
    )
}

/// The path while the markers were lost: the true one if it is known, or what
/// the estimate held and then jumped to.
fn lost(drive: &Drive) -> Curve {
    let path: Vec<(f64, [f64; 2])> = match drive.truth.is_empty() {
        false => drive.truth.iter().map(|it| (it.time, it.point)).collect(),
        true => drive.ticks.iter().map(|it| (it.time, it.point)).collect(),
    };
    let mut points = Vec::new();
    for [from, to] in drive.lost_markers() {
        let first = path.partition_point(|(time, _)| *time < from);
        let end = path.partition_point(|(time, _)| *time <= to);
        // With the last point that was seen.
        points.extend(path.iter().take(end).skip(first.saturating_sub(1)));
        points.push((to, [f64::NAN; 2]));
    }
    let column = |axis: usize| -> Column { points.iter().map(|(_, point)| point[axis]).collect() };
    Curve {
        time: Some(points.iter().map(|(time, _)| *time).collect()),
        ..Curve::new(LOST, Look::Lost, &column(0), column(1))
    }
}
