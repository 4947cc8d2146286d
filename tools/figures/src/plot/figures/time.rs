//! Figures over time.

use super::common::LOST;
use crate::{
    figure::{Axis, Curve, Figure, Look, Panel, Symbol, Width},
    plot::drive::Drive,
    plot::truth::TruthSample,
};

/// A panel over the time of the drive, with the spans without markers.
fn over_time(drive: &Drive, y: Axis, curves: Vec<Curve>) -> Panel {
    Panel {
        spans: drive.lost_markers(),
        span_name: LOST,
        curves,
        ..Panel::new(Axis::TIME, y)
    }
}

/// Ground truth, if the car is simulated.
fn truth(drive: &Drive, value: impl Fn(&TruthSample) -> f64) -> Curve {
    Curve::new(
        "true (simulation)",
        Look::Truth,
        &drive.truth_column(|sample| sample.time),
        drive.truth_column(value),
    )
}

pub(super) fn commanded_velocity(drive: &Drive) -> Figure {
    let time = drive.column(|tick| tick.time);
    let panel = |quantity, below, axis: usize| {
        let y = Axis::new(quantity, Some(Symbol::new("v", below)), "m/s");
        let velocity = drive.column(|tick| tick.point_velocity[axis]);
        over_time(
            drive,
            y,
            vec![Curve::new("commanded", Look::Actual, &time, velocity)],
        )
    };
    Figure {
        title: "Commanded velocity of P".to_owned(),
        caption: "The velocity that the position loop, or the reference alone, asks of the \
                  point P along x and y: the input of the linearising law."
            .to_owned(),
        width: Width::Page,
        panels: vec![panel("velocity", "Px", 0), panel("velocity", "Py", 1)],
    }
}

pub(super) fn steering(drive: &Drive) -> Figure {
    let time = drive.column(|tick| tick.time);
    let y = Axis::new("steering", Some(Symbol::new("δ", "")), "rad");
    let steering = drive.column(|tick| tick.steering);
    Figure {
        title: "Steering angle commanded by the law".to_owned(),
        caption: "The steering angle that the linearising law asks for, after the limits of \
                  angle and rate; left is positive."
            .to_owned(),
        width: Width::Column,
        panels: vec![over_time(
            drive,
            y,
            vec![
                Curve::new("commanded", Look::Actual, &time, steering),
                truth(drive, |sample| sample.steering),
            ],
        )],
    }
}

pub(super) fn speed(drive: &Drive) -> Figure {
    let time = drive.column(|tick| tick.time);
    let board = drive.board_column(|sample| sample.time);
    let y = Axis::new("speed", Some(Symbol::new("v", "")), "m/s");
    Figure {
        title: "Reference and actual speed".to_owned(),
        caption: "The speed of the centre of mass that the law asks for, after limits, and the \
                  car's: as estimated, and as the motor's pulses tell it of the rear axle."
            .to_owned(),
        width: Width::Column,
        panels: vec![over_time(
            drive,
            y,
            vec![
                Curve::new(
                    "motor pulses",
                    Look::Measured,
                    &board,
                    drive.board_column(|sample| sample.motor_speed),
                ),
                Curve::new(
                    "reference",
                    Look::Nominal,
                    &time,
                    drive.column(|tick| tick.commanded_speed),
                ),
                Curve::new(
                    "actual",
                    Look::Actual,
                    &time,
                    drive.column(|tick| tick.speed),
                ),
                truth(drive, |sample| sample.speed),
            ],
        )],
    }
}

pub(super) fn position(drive: &Drive) -> Figure {
    let time = drive.column(|tick| tick.time);
    let nominal = drive.nominal();
    let panel = |letter, axis: usize| {
        let y = Axis::new("position", Some(Symbol::new(letter, "P")), "m");
        let should = drive.spread(nominal.iter().map(|point| point[axis]));
        let is = drive.column(|tick| tick.point[axis]);
        over_time(
            drive,
            y,
            vec![
                Curve::new("nominal", Look::Nominal, &time, should),
                Curve::new("actual", Look::Actual, &time, is),
                truth(drive, |sample| sample.point[axis]),
            ],
        )
    };
    Figure {
        title: "Position of P over time".to_owned(),
        caption: format!(
            "{}, and where P was; while the markers are lost the last pose is held and the \
             curves stay level though the car moves.",
            if drive.has_positions() {
                "Where the reference wants P"
            } else {
                "Where P would be if it integrated its commanded velocity"
            }
        ),
        width: Width::Page,
        panels: vec![panel("x", 0), panel("y", 1)],
    }
}

pub(super) fn sideslip_and_yaw_rate(drive: &Drive) -> Figure {
    let time = drive.column(|tick| tick.time);
    let board = drive.board_column(|sample| sample.time);
    let sideslip = Axis::new("sideslip", Some(Symbol::new("β", "")), "rad");
    let yaw_rate = Axis::new("yaw rate", Some(Symbol::new("r", "")), "rad/s");
    Figure {
        title: "Sideslip angle and yaw rate".to_owned(),
        caption: "The estimated angle from the car's axis to the velocity of its centre of mass, \
                  and its yaw rate beside the gyro's samples; left is positive."
            .to_owned(),
        width: Width::Page,
        panels: vec![
            over_time(
                drive,
                sideslip,
                vec![
                    Curve::new(
                        "estimated",
                        Look::Actual,
                        &time,
                        drive.column(|tick| tick.sideslip),
                    ),
                    truth(drive, |sample| sample.sideslip),
                ],
            ),
            over_time(
                drive,
                yaw_rate,
                vec![
                    Curve::new(
                        "gyro",
                        Look::Measured,
                        &board,
                        drive.board_column(|sample| sample.yaw_rate),
                    ),
                    Curve::new(
                        "estimated",
                        Look::Actual,
                        &time,
                        drive.column(|tick| tick.yaw_rate),
                    ),
                    truth(drive, |sample| sample.yaw_rate),
                ],
            ),
        ],
    }
}

pub(super) fn tracking_error(drive: &Drive) -> Figure {
    let time = drive.column(|tick| tick.time);
    let y = Axis {
        include: Some(0.0),
        ..Axis::new("tracking error", Some(Symbol::new("e", "P")), "mm")
    };
    let error = drive
        .tracking_error()
        .into_iter()
        .map(|error| error * 1000.0);
    Figure {
        title: "Tracking error of P".to_owned(),
        caption: "Distance from P to where it should be at that moment; with proportional \
                  control alone P lags behind a moving reference and the error stays."
            .to_owned(),
        width: Width::Column,
        panels: vec![over_time(
            drive,
            y,
            vec![
                Curve::new("estimated", Look::Actual, &time, drive.spread(error)),
                Curve::new(
                    "true (simulation)",
                    Look::Truth,
                    &drive.truth_column(|sample| sample.time),
                    drive.spread_truth(drive.true_errors().into_iter().map(|error| error * 1000.0)),
                ),
            ],
        )],
    }
}
