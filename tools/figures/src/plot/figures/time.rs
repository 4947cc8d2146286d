//! Figures over time, and the path of P on the floor.

use super::LOST;
use crate::{
    figure::{Axis, Column, Curve, Figure, Look, Mark, MarkKind, Panel, Scale, Symbol},
    plot::{
        drive::{BoardPoint, Drive, TickSample},
        sample::TruthSample,
    },
};

/// The lowest tracking error on its logarithmic axis, in mm.
const LEAST_ERROR: f64 = 0.1;

/// A panel over the time of the drive, with the spans without markers.
fn over_time(drive: &Drive, y: Axis, curves: Vec<Curve>) -> Panel {
    Panel {
        spans: drive.lost_markers(),
        span_name: LOST,
        curves,
        ..Panel::new(Axis::TIME, y)
    }
}

/// A line through a number of each tick.
fn curve(
    drive: &Drive,
    name: &'static str,
    look: Look,
    value: impl Fn(&TickSample) -> f64,
) -> Curve {
    let time = drive.column(|tick| tick.time);
    Curve::new(name, look, &time, drive.column(value))
}

/// A line through a number of each of the board's samples.
fn measured(drive: &Drive, name: &'static str, value: fn(&BoardPoint) -> f64) -> Curve {
    let time = drive.board_column(|sample| sample.time);
    Curve::new(name, Look::Measured, &time, drive.board_column(value))
}

/// Ground truth, if the car is simulated.
fn truth(drive: &Drive, value: impl Fn(&TruthSample) -> f64) -> Curve {
    true_curve(drive, drive.truth_column(value))
}

fn true_curve(drive: &Drive, values: Column) -> Curve {
    let time = drive.truth_column(|sample| sample.time);
    Curve::new("true", Look::Truth, &time, values)
}

/// A part of a caption that is not always true.
const fn only_if(is_so: bool, part: &str) -> &str {
    if is_so { part } else { "" }
}

pub(super) fn commanded_velocity(drive: &Drive) -> Figure {
    let panel = |below, axis: usize| {
        let y = Axis::new("velocity", Some(Symbol::new("v", below)), "m/s");
        let velocity = curve(drive, "commanded", Look::Actual, |tick| {
            tick.point_velocity[axis]
        });
        over_time(drive, y, vec![velocity])
    };
    Figure::page(
        "Commanded velocity of P",
        "The velocity that the position loop, or the reference alone, asks of the \
         point P along x and y: the input of the linearising law.",
        vec![panel("Px", 0), panel("Py", 1)],
    )
}

pub(super) fn steering(drive: &Drive) -> Figure {
    let y = Axis::new("steering", Some(Symbol::new("δ", "")), "rad");
    let curves = vec![
        curve(drive, "commanded", Look::Actual, |tick| tick.steering),
        truth(drive, |sample| sample.steering),
    ];
    Figure::column(
        "Steering angle commanded by the law",
        "The steering angle that the linearising law asks for, after the limits of \
         angle and rate; left is positive.",
        vec![over_time(drive, y, curves)],
    )
}

pub(super) fn speed(drive: &Drive) -> Figure {
    let y = Axis::new("speed", Some(Symbol::new("v", "")), "m/s");
    let curves = vec![
        curve(drive, "reference", Look::Nominal, |tick| {
            tick.commanded_speed
        }),
        curve(drive, "actual", Look::Actual, |tick| tick.speed),
        // Above what is estimated from them, which would hide them.
        measured(drive, "motor pulses", |sample| sample.motor_speed),
        truth(drive, |sample| sample.speed),
    ];
    Figure::column(
        "Reference and actual speed",
        format!(
            "The speed of the centre of mass that the law asks for, after limits, and the car's: \
             as estimated{}.",
            only_if(
                !drive.board.is_empty(),
                ", and of the rear axle as the motor's pulses measure it"
            )
        ),
        vec![over_time(drive, y, curves)],
    )
}

pub(super) fn position(drive: &Drive) -> Figure {
    let time = drive.column(|tick| tick.time);
    let nominal = drive.nominal();
    let panel = |letter, axis: usize| {
        let y = Axis::new("position", Some(Symbol::new(letter, "P")), "m");
        let should = drive.spread(nominal.iter().map(|point| point[axis]));
        let curves = vec![
            Curve::new("nominal", Look::Nominal, &time, should),
            curve(drive, "actual", Look::Actual, |tick| tick.point[axis]),
            truth(drive, |sample| sample.point[axis]),
        ];
        over_time(drive, y, curves)
    };
    Figure::page(
        "Position of P over time",
        format!(
            "{}, and where P was{}.",
            if drive.has_positions() {
                "Where the reference wants P"
            } else {
                "Where P would be if it integrated its commanded velocity"
            },
            only_if(
                !drive.lost_markers().is_empty(),
                "; while the markers are lost the last pose is held and the curves stay level \
                 though the car moves"
            )
        ),
        vec![panel("x", 0), panel("y", 1)],
    )
}

pub(super) fn sideslip_and_yaw_rate(drive: &Drive) -> Figure {
    let sideslip = vec![
        curve(drive, "estimated", Look::Actual, |tick| tick.sideslip),
        truth(drive, |sample| sample.sideslip),
    ];
    let gyro = measured(drive, "gyro", |sample| sample.yaw_rate);
    let has_gyro = !gyro.is_empty();
    let yaw_rate = vec![
        gyro,
        curve(drive, "estimated", Look::Actual, |tick| tick.yaw_rate),
        truth(drive, |sample| sample.yaw_rate),
    ];
    let [beta, r] = ["β", "r"].map(|letter| Some(Symbol::new(letter, "")));
    let panels = vec![
        over_time(drive, Axis::new("sideslip", beta, "rad"), sideslip),
        over_time(drive, Axis::new("yaw rate", r, "rad/s"), yaw_rate),
    ];
    Figure::page(
        "Sideslip angle and yaw rate",
        format!(
            "The estimated angle from the car's axis to the velocity of its centre of mass, and \
             its yaw rate{}; left is positive.",
            only_if(has_gyro, " over the gyro's samples")
        ),
        panels,
    )
}

pub(super) fn tracking_error(drive: &Drive) -> Figure {
    let errors = [drive.tracking_error(), drive.true_errors()].concat();
    let found = || errors.iter().filter(|error| error.is_finite());
    let [least, most] = [
        found().fold(f64::INFINITY, |a, b| a.min(*b)),
        found().fold(0.0, |a: f64, b| a.max(*b)),
    ];
    // The approach and the last millimetres on one axis; but errors of one size as they are.
    let is_wide = most > 10.0 * least;
    let y = Axis {
        scale: if is_wide { Scale::Log } else { Scale::Linear },
        include: (!is_wide).then_some(0.0),
        ..Axis::new("tracking error", Some(Symbol::new("e", "P")), "mm")
    };
    let is_below = |error: f64| error * 1000.0 < LEAST_ERROR;
    let is_cut = errors.iter().any(|error| is_below(*error));
    // A comparison keeps the gaps, which `max` fills.
    let mm = |error: f64| {
        if is_below(error) {
            LEAST_ERROR
        } else {
            error * 1000.0
        }
    };
    let time = drive.column(|tick| tick.time);
    let error = drive.spread(drive.tracking_error().into_iter().map(mm));
    let true_error = drive.spread_truth(drive.true_errors().into_iter().map(mm));
    let curves = vec![
        Curve::new("estimated", Look::Actual, &time, error),
        true_curve(drive, true_error),
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
    let what = match drive.is_estimated() {
        true => "P",
        false => "the rigid body",
    };
    let curves = vec![
        lost(drive),
        over(&time, "nominal", Look::Nominal, &nominal),
        over(&time, "actual", Look::Actual, &actual),
        over(&true_time, "true", Look::Truth, &truth),
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
    Figure::column(
        format!("Trajectory of {what}"),
        format!(
            "Where {what} should be and where it was on the floor, from the triangle to the circle, \
             where the {}.",
            if drive.ended.is_some() {
                "drive ended"
            } else {
                "record ends"
            }
        ),
        vec![Panel {
            height_mm: 90.0,
            curves,
            marks: ends
                .into_iter()
                .filter_map(|(name, kind, point)| point.map(|point| Mark { name, point, kind }))
                .collect(),
            ..Panel::floor("P")
        }],
    )
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
