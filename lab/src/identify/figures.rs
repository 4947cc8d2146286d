//! Drive and identified model, as in the paper's figures of the validation, and the
//! prediction errors.

use std::sync::Arc;

use singletrack_analysis::identification::{Channel, Residuals, SimulationPoint};
use singletrack_figures::figure::{Axis, Bar, Column, Curve, Figure, Level, Look, Panel, Symbol};

use super::{Identified, Report};

/// The longest span of the figures over time, in s, from the middle of a long drive: a
/// longer one is not legible on paper.
const SHOWN: f64 = 10.0;
const MEASURED: &str = "measured";
const MODEL: &str = "model";

/// Every figure of an identification, with its name.
pub fn figures(report: &Report) -> Vec<(String, Figure)> {
    let mut figures = of_drive("", "the drive it was identified from", &report.identified);
    for (number, validated) in (1..).zip(&report.validated) {
        let prefix = match number {
            1 => "validation-".to_owned(),
            _ => format!("validation-{number}-"),
        };
        figures.extend(of_drive(
            &prefix,
            "another drive, for validation",
            validated,
        ));
    }
    let residuals = &report.identified.identification.residuals;
    figures.push(("residuals".to_owned(), errors(residuals)));
    figures
}

fn of_drive(prefix: &str, which: &str, identified: &Identified) -> Vec<(String, Figure)> {
    let points = excerpt(&identified.identification.simulation);
    vec![
        (format!("{prefix}inputs"), inputs(points, which)),
        (format!("{prefix}states"), states(points, which)),
    ]
}

/// A part from the middle that begins where the model's position does.
fn excerpt(points: &[SimulationPoint]) -> &[SimulationPoint] {
    let middle = points.len() / 2;
    let restart = |index: &usize| points.get(*index).is_some_and(|point| point.restarted);
    let from = (middle..points.len())
        .find(restart)
        .or_else(|| (0..middle).rev().find(restart))
        .unwrap_or(0);
    let rest = points.get(from..).unwrap_or_default();
    let begin = rest.first().map_or(0.0, |point| point.time_s);
    let until = rest
        .iter()
        .enumerate()
        .position(|(index, point)| point.time_s > begin + SHOWN || (index > 0 && point.restarted))
        .unwrap_or(rest.len());
    rest.get(..until).unwrap_or_default()
}

fn column(points: &[SimulationPoint], value: impl Fn(&SimulationPoint) -> f64) -> Column {
    points.iter().map(value).collect()
}

/// The paper's figure of part of the inputs and the trajectory.
fn inputs(points: &[SimulationPoint], which: &str) -> Figure {
    let time = column(points, |point| point.time_s);
    let over_time = |quantity, letter, unit, value: fn(&SimulationPoint) -> f64| {
        let input = Curve::new("input", Look::Actual, &time, column(points, value));
        let y = Axis::new(quantity, Some(Symbol::new(letter, "")), unit);
        Panel {
            height_mm: 34.0,
            curves: vec![input],
            ..Panel::new(Axis::TIME, y)
        }
    };
    let path = |name, look, position: fn(&SimulationPoint) -> [f64; 2]| {
        let [x, y] = [0, 1].map(|axis: usize| column(points, |point| position(point)[axis]));
        Curve {
            time: Some(time.clone()),
            ..Curve::new(name, look, &x, y)
        }
    };
    let trajectory = Panel {
        height_mm: 70.0,
        curves: vec![
            path(MEASURED, Look::Nominal, |point| point.measured_m),
            path(MODEL, Look::Actual, |point| point.position_m),
        ],
        begins_row: true,
        ..Panel::floor("G")
    };
    Figure::page(
        "Inputs and trajectory",
        format!(
            "Part of {which}: speed by the cameras and the accelerometer, steering angle of the \
             servo's model, and the path of G as measured and as the model drives it from the \
             first pose on without correction."
        ),
        vec![
            over_time("speed", "v", "m/s", |point| point.speed_m_s),
            over_time("steering", "δ", "rad", |point| point.steering_rad),
            trajectory,
        ],
    )
}

/// The paper's figure of the states.
fn states(points: &[SimulationPoint], which: &str) -> Figure {
    let time = column(points, |point| point.time_s);
    let panel = |quantity, symbol, unit, values: fn(&SimulationPoint) -> [f64; 2]| {
        let [measured, model] =
            [0, 1].map(|which: usize| column(points, |point| values(point)[which]));
        Panel {
            curves: vec![
                Curve::new(MEASURED, Look::Nominal, &time, measured),
                Curve::new(MODEL, Look::Actual, &time, model),
            ],
            ..Panel::new(Axis::TIME, Axis::new(quantity, Some(symbol), unit))
        }
    };
    let panels = vec![
        panel("yaw", Symbol::new("ψ", ""), "rad", |point| {
            [point.measured_yaw_rad, point.yaw_rad]
        }),
        panel("yaw rate", Symbol::new("r", ""), "rad/s", |point| {
            [point.measured_yaw_rate_rad_s, point.yaw_rate_rad_s]
        }),
        Panel {
            // Two in a row.
            begins_row: true,
            ..panel("sideslip", Symbol::new("β", ""), "rad", |point| {
                [point.measured_sideslip_rad, point.sideslip_rad]
            })
        },
        panel(
            "lateral acceleration",
            Symbol::new("a", "y"),
            "m/s²",
            |point| [point.measured_left_m_s2, point.left_m_s2],
        ),
    ];
    Figure::page(
        "Measured and simulated states",
        format!(
            "Part of {which}: yaw by the cameras, yaw rate by the gyro, sideslip by the cameras \
             alone and acceleration to the left by the IMU, beside the model that is given the \
             speed and the servo's pulses and nothing else."
        ),
        panels,
    )
}

const fn named(channel: Channel) -> &'static str {
    match channel {
        Channel::X => "x",
        Channel::Y => "y",
        Channel::Yaw => "yaw",
        Channel::YawRate => "yaw rate",
        Channel::Left => "lateral acceleration",
    }
}

/// The prediction errors over time, and their autocorrelation.
fn errors(residuals: &[Residuals]) -> Figure {
    let panels = residuals.iter().enumerate().flat_map(|(index, residuals)| {
        let x: Column = Arc::from(&residuals.times_s[..]);
        let y: Column = Arc::from(&residuals.values[..]);
        let over_time = Panel {
            title: named(residuals.channel).to_owned(),
            begins_row: index > 0,
            height_mm: 24.0,
            curves: vec![Curve::new("prediction error", Look::Measured, &x, y)],
            ..Panel::new(Axis::TIME, Axis::new("error", None, "σ").including(4.0))
        };
        let bars = residuals.autocorrelation.iter().zip(1..);
        let bars = bars.map(|(height, lag)| {
            let lag = f64::from(lag);
            Bar {
                span: [lag - 0.35, lag + 0.35],
                height: height.abs(),
            }
        });
        let count = residuals.values.len().max(1) as f64;
        let memory = Panel {
            height_mm: 24.0,
            bars: bars.collect(),
            levels: vec![Level::new(
                "by chance, 95 %",
                1.96 / count.sqrt(),
                Look::RangeEnd,
            )],
            ..Panel::new(
                Axis::new("lag", None, "samples"),
                Axis::new("|autocorrelation|", None, "").including(0.1),
            )
        };
        [over_time, memory]
    });
    Figure::page(
        "Prediction errors",
        "What was measured less what was predicted from everything before, over the \
         standard deviation that it should have, and how much of it can be told from \
         the errors before. If the model is right, nineteen of twenty are within two, \
         and nothing can be told.",
        panels.collect(),
    )
}
