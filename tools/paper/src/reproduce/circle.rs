//! Trajectory tracking: P along a circle, from several starts.

use std::f64::consts::TAU;

use singletrack_core::config::{LawKind, OuterLoopSection, ReferenceSection};
use singletrack_figures::figure::{Axis, Curve, Figure, Look, Symbol, Width};
use singletrack_scenario::tracking::{Sample, Tracking, last_turn};

use super::{
    Setup,
    drive::{Experiment, Run},
    extreme::{largest, least},
    pictures,
    progress::Progress,
    section::{Picture, Plate, Section, Table, or_note},
    setup::{GAIN, TURN_RATE},
    text::{number, with_digits},
};

/// Where P starts.
struct Start {
    name: &'static str,
    what: &'static str,
    /// For a circle of 1 m.
    point: [f64; 2],
    yaw_deg: f64,
}

/// Start of P on the path behind its reference, in rad. At distance zero the position loop
/// commands standstill, where the paper's model is singular.
const BEHIND: f64 = 0.1;

/// The paper's car starts outside.
fn starts() -> [Start; 4] {
    [
        Start {
            name: "outside",
            what: "outside the circle",
            point: [1.5, -0.5],
            yaw_deg: 135.0,
        },
        Start {
            name: "on-the-path",
            what: "on the path, along it",
            point: [BEHIND.cos(), -BEHIND.sin()],
            yaw_deg: 90.0 - BEHIND.to_degrees(),
        },
        Start {
            name: "inside",
            what: "inside",
            point: [0.2, 0.1],
            yaw_deg: 0.0,
        },
        Start {
            name: "far-outside",
            what: "far outside",
            point: [-1.6, -1.2],
            yaw_deg: 30.0,
        },
    ]
}

/// The tracking experiment from a point, in units of the circle's radius.
pub(super) fn experiment(
    setup: &Setup,
    point: [f64; 2],
    yaw_deg: f64,
    feed_forward: bool,
) -> Experiment {
    Experiment {
        law: LawKind::FrontPoint,
        deviation_m: 0.0,
        believed: None,
        outer_loop: OuterLoopSection::Proportional {
            gain_per_s: [GAIN; 2],
            feed_forward,
        },
        reference: ReferenceSection::Circle {
            radius_m: setup.radius_m(),
            angular_velocity_rad_s: TURN_RATE,
            centre_m: [0.0, 0.0],
        },
        start_m: point.map(|coordinate| coordinate * setup.radius_m()),
        yaw_deg,
        // The start must have no effect on the last turn.
        duration_s: if setup.quick { 30.0 } else { 40.0 },
        losses: Vec::new(),
    }
}

/// Amplitude, lag and error over the last turn.
fn tracking(run: &Run) -> Option<Tracking> {
    let samples: Vec<Sample> = run
        .rows
        .iter()
        .map(|row| Sample {
            time: row.t,
            point: [row.x_p, row.y_p],
            reference: [row.x_ref, row.y_ref],
        })
        .collect();
    last_turn(&samples, [0.0; 2], TURN_RATE)
}

/// The drives.
struct Drives {
    /// From each start, on the ideal plant and on the car.
    tracked: Vec<(Start, [Option<Run>; 2])>,
    /// The first start with the reference's velocity added.
    fed_forward: [Option<Run>; 2],
}

const PLANTS: [&str; 2] = ["ideal", "car"];

pub(super) fn section(setup: &Setup, progress: &Progress) -> Section {
    let mut section = Section {
        number: 3,
        title: "Tracking a circle",
        ..Section::default()
    };
    section.intro.push(format!(
        "Radius {} m, {TURN_RATE} rad/s, proportional control with unit gain around the law, from \
         several starts; and from the first again with the reference's velocity fed forward.",
        number(setup.radius_m())
    ));
    let drive = |section: &mut Section, what: &str, experiment: &Experiment| {
        progress.doing(&format!("circle, {what}"));
        [
            section.keep(&format!("ideal plant, {what}"), experiment.ideal(setup)),
            section.drive_car(setup, what, experiment),
        ]
    };
    let tracked = starts()
        .into_iter()
        .map(|start| {
            let experiment = experiment(setup, start.point, start.yaw_deg, false);
            let runs = drive(&mut section, &format!("start {}", start.what), &experiment);
            (start, runs)
        })
        .collect();
    let [first, ..] = starts();
    let experiment = experiment(setup, first.point, first.yaw_deg, true);
    let fed_forward = drive(&mut section, "with feed-forward", &experiment);
    let drives = Drives {
        tracked,
        fed_forward,
    };
    measure(&drives, &mut section);
    draw(setup, &drives, &mut section);
    section
}

fn measure(drives: &Drives, section: &mut Section) {
    let measurements = &mut section.measurements;
    for (index, plant) in PLANTS.into_iter().enumerate() {
        let mut all = Vec::new();
        for (start, runs) in &drives.tracked {
            let Some(run) = runs.get(index).and_then(Option::as_ref) else {
                continue;
            };
            section.tables.push(Table::of_rows(
                format!("circle-{}-{plant}", start.name),
                &run.rows,
            ));
            let Some(tracking) = tracking(run) else {
                continue;
            };
            let name = |what: &str| format!("circle.{what}.{}.{plant}", start.name);
            measurements.add(name("amplitude"), tracking.amplitude_m);
            measurements.add(name("lag"), tracking.lag_rad);
            measurements.add(name("error"), tracking.rms_error_m);
            if let Some(row) = run.rows.last() {
                measurements.add(name("speed"), row.speed);
                measurements.add(name("steering"), row.steering);
                measurements.add(name("sideslip"), row.sideslip);
                measurements.add(name("yaw-rate"), row.yaw_rate);
            }
            all.push(tracking);
        }
        if all.len() == drives.tracked.len() {
            let spread = |value: fn(&Tracking) -> f64| {
                largest(all.iter().map(value)) - least(all.iter().map(value))
            };
            let apart = spread(|tracking| tracking.amplitude_m).max(spread(|one| one.lag_rad));
            measurements.add(format!("circle.spread.{plant}"), apart);
        }
        let fed_forward = drives.fed_forward.get(index).and_then(Option::as_ref);
        if let Some(run) = fed_forward {
            section.tables.push(Table::of_rows(
                format!("circle-feed-forward-{plant}"),
                &run.rows,
            ));
            if let Some(tracking) = tracking(run) {
                measurements.add(
                    format!("circle.feed-forward.error.{plant}"),
                    tracking.rms_error_m,
                );
                measurements.add(
                    format!("circle.feed-forward.amplitude.{plant}"),
                    tracking.amplitude_m,
                );
            }
        }
    }
}

fn draw(setup: &Setup, drives: &Drives, section: &mut Section) {
    let measured = section.measurements.clone();
    let get = |name: &str, unit: &str| or_note(measured.get(name), unit);
    let amplitude = setup.radius_m() / (1.0 + (TURN_RATE / GAIN).powi(2)).sqrt();
    let lag = (TURN_RATE / GAIN).atan();
    let first = drives.tracked.first().map(|(_, runs)| runs);
    let each = |what: &str, draw: fn(&Run) -> Figure| -> Vec<Picture> {
        let runs = first.into_iter().flatten();
        PLANTS
            .into_iter()
            .zip(runs)
            .filter_map(|(plant, run)| {
                let label = if plant == "ideal" {
                    "ideal plant"
                } else {
                    "car"
                };
                let run = run.as_ref()?;
                Some(Picture::new(
                    format!("circle-{what}-{plant}"),
                    label,
                    draw(run),
                ))
            })
            .collect()
    };

    section.plates.push(Plate {
        title: "Trajectory of P".to_owned(),
        paper: "Reference and actual path; the car starts outside the circle and converges."
            .to_owned(),
        ours: format!(
            "From everywhere it converges, to a circle of {} on the ideal plant and {} on the car: \
             the reference's radius over √1.25 ({} m) is what unit-gain proportional control \
             without feed-forward gives. The car, whose speed, acceleration and steering have \
             limits, makes detours where the ideal plant turns at once.",
            get("circle.amplitude.outside.ideal", "m"),
            get("circle.amplitude.outside.car", "m"),
            with_digits(amplitude, 4),
        ),
        pictures: PLANTS
            .into_iter()
            .enumerate()
            .filter_map(|(index, plant)| {
                let runs = drives.tracked.iter();
                let runs: Vec<&Run> = runs
                    .filter_map(|(_, runs)| runs.get(index)?.as_ref())
                    .collect();
                let label = if plant == "ideal" {
                    "ideal plant"
                } else {
                    "car"
                };
                (!runs.is_empty()).then(|| {
                    let figure = pictures::trajectories(&runs);
                    Picture::new(format!("circle-trajectory-{plant}"), label, figure)
                })
            })
            .collect(),
    });
    section.plates.push(Plate {
        title: "Position of P over time".to_owned(),
        paper: "Sinusoids with a delay between reference and actual position and, as the text \
                says, with the same amplitude; the delay is put down to the start outside the path."
            .to_owned(),
        ours: format!(
            "The delay is {} on the ideal plant and {} on the car (theory: atan 0.5 = {} rad, or \
             {} s), and the amplitude is not the same.",
            get("circle.lag.outside.ideal", "rad"),
            get("circle.lag.outside.car", "rad"),
            with_digits(lag, 4),
            with_digits(lag / TURN_RATE, 3),
        ),
        pictures: each("position", Run::position),
    });
    lag_plate(drives, lag, section);
    section.plates.push(Plate {
        title: "Velocity commanded of P".to_owned(),
        paper: "The outputs of the two position regulators.".to_owned(),
        ours: format!(
            "After the approach sinusoids of {} m/s: the amplitude times {TURN_RATE} rad/s.",
            with_digits(amplitude * TURN_RATE, 4)
        ),
        pictures: each("commanded-velocity", Run::commanded_velocity),
    });
    let settled = |what: &str, unit: &str| {
        format!(
            "{} and {}",
            get(&format!("circle.{what}.outside.ideal"), unit),
            get(&format!("circle.{what}.outside.car"), unit)
        )
    };
    let mut outputs = each("steering", Run::steering);
    outputs.extend(each("speed", Run::speed));
    section.plates.push(Plate {
        title: "Outputs of the law".to_owned(),
        paper: "Steering and reference speed from the law, and the car's speed.".to_owned(),
        ours: format!(
            "On the ideal plant and on the car the steering settles on {}, the speed on {}.",
            settled("steering", "rad"),
            settled("speed", "m/s")
        ),
        pictures: outputs,
    });
    section.plates.push(Plate {
        title: "Sideslip angle and yaw rate".to_owned(),
        paper: "The measured sideslip angle and yaw rate.".to_owned(),
        ours: format!(
            "On the ideal plant and on the car the sideslip settles on {}, the yaw rate on {}: the \
             car turns as fast as the reference.",
            settled("sideslip", "rad"),
            settled("yaw-rate", "rad/s")
        ),
        pictures: each("sideslip-yaw-rate", Run::sideslip_and_yaw_rate),
    });
}

/// The lag of P over time, for the starts outside and on the path.
fn lag_plate(drives: &Drives, lag: f64, section: &mut Section) {
    let measured = section.measurements.clone();
    let wanted = [
        ("outside", "start outside", Look::Actual),
        ("on-the-path", "start on the path", Look::Truth),
    ];
    let pictures = PLANTS
        .into_iter()
        .enumerate()
        .filter_map(|(index, plant)| {
            let mut curves = Vec::new();
            for (name, legend, look) in wanted {
                let (_, runs) = drives
                    .tracked
                    .iter()
                    .find(|(start, _)| start.name == name)?;
                let run = runs.get(index)?.as_ref()?;
                let time = run.column(|row| row.t);
                if curves.is_empty() {
                    let theory = run.column(|_| lag);
                    curves.push(Curve::new("atan 0.5", Look::Nominal, &time, theory));
                }
                let behind = run.column(|row| {
                    let angle = row.y_ref.atan2(row.x_ref) - row.y_p.atan2(row.x_p);
                    (angle + TAU / 2.0).rem_euclid(TAU) - TAU / 2.0
                });
                curves.push(Curve::new(legend, look, &time, behind));
            }
            let figure = pictures::over_time(
                "How far P is behind its reference",
                "The angle from P to its reference, seen from the centre of the circle.",
                Axis::new("lag of P", Some(Symbol::new("φ", "")), "rad"),
                Width::Column,
                curves,
            );
            let label = if plant == "ideal" {
                "ideal plant"
            } else {
                "car"
            };
            Some(Picture::new(format!("circle-lag-{plant}"), label, figure))
        })
        .collect();
    let get = |name: &str, unit: &str| or_note(measured.get(name), unit);
    section.plates.push(Plate {
        title: "The delay is no effect of the start".to_owned(),
        paper: "No figure: the text says that the delay comes from starting outside the path."
            .to_owned(),
        ours: format!(
            "P that starts on the path and along it, {BEHIND} rad behind its reference, falls back \
             to {} as well ({} on the car); with feed-forward P from outside comes to within {} of \
             its reference ({} on the car).",
            get("circle.lag.on-the-path.ideal", "rad"),
            get("circle.lag.on-the-path.car", "rad"),
            get("circle.feed-forward.error.ideal", "m"),
            get("circle.feed-forward.error.car", "m"),
        ),
        pictures,
    });
}
