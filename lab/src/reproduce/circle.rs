//! Trajectory tracking: P along a circle, from several starts.

use std::f64::consts::TAU;

use indicatif::ProgressBar;
use singletrack_core::config::{LawKind, OuterLoopSection, ReferenceSection, Start};
use singletrack_figures::figure::{Axis, Curve, Figure, Look, Symbol, Width};
use singletrack_scenario::tracking::{Sample, Tracking, last_turn};

use super::{
    Setup,
    drive::{Drives, Experiment, PLANTS, Run},
    pictures,
    section::{Picture, Section},
    setup::{GAIN, TURN_RATE},
    setup::{largest, least},
    text::{number, with_digits},
};

/// Start of P on the path behind its reference, in rad. At distance zero the position loop
/// commands standstill, where the paper's model is singular.
const BEHIND: f64 = 0.1;

/// Where P starts: a name, in words, for a circle of 1 m, and the yaw in degrees. The paper's car
/// starts outside.
fn starts() -> [(&'static str, &'static str, [f64; 2], f64); 4] {
    let on_the_path = [libm::cos(BEHIND), -libm::sin(BEHIND)];
    let along = 90.0 - BEHIND.to_degrees();
    [
        ("outside", "outside the circle", [1.5, -0.5], 135.0),
        ("on-the-path", "on the path, along it", on_the_path, along),
        ("inside", "inside", [0.2, 0.1], 0.0),
        ("far-outside", "far outside", [-1.6, -1.2], 30.0),
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
            start: Start::Beginning,
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

/// The first start with the reference's velocity added.
const FEED_FORWARD: &str = "feed-forward";

pub(super) fn section(setup: &Setup, progress: &ProgressBar) -> Section {
    let mut section = Section::new(3, "Tracking a circle");
    section.intro = format!(
        "Radius {} m, {TURN_RATE} rad/s, proportional control with unit gain around the law, from \
         several starts; and from the first again with the reference's velocity fed forward.",
        number(setup.radius_m())
    );
    let mut drives = Drives::default();
    let mut drive = |case, what: &str, experiment: &Experiment| {
        progress.set_message(format!("circle, {what}"));
        for (plant, kind, label) in PLANTS {
            let run = section.drive(setup, plant, &format!("{label}, {what}"), experiment);
            drives.add(case, kind, run);
        }
    };
    for (name, what, point, yaw_deg) in starts() {
        let experiment = experiment(setup, point, yaw_deg, false);
        drive(name, &format!("start {what}"), &experiment);
    }
    let [(_, _, point, yaw_deg), ..] = starts();
    let experiment = experiment(setup, point, yaw_deg, true);
    drive(FEED_FORWARD, "with feed-forward", &experiment);
    measure(&drives, &mut section);
    draw(setup, &drives, &mut section);
    section
}

fn measure(drives: &Drives, section: &mut Section) {
    let measurements = &mut section.measurements;
    for (_, plant, _) in PLANTS {
        let mut all = Vec::new();
        for (case, run) in drives.of(plant) {
            let name = format!("circle-{case}-{plant}");
            section.tables.push((name, run.table()));
            let Some(tracking) = tracking(run) else {
                continue;
            };
            if case == FEED_FORWARD {
                let name = format!("circle.feed-forward.error.{plant}");
                measurements.add(name, tracking.rms_error_m);
                continue;
            }
            let mut add =
                |what, value| measurements.add(format!("circle.{what}.{case}.{plant}"), value);
            add("amplitude", tracking.amplitude_m);
            add("lag", tracking.lag_rad);
            add("error", tracking.rms_error_m);
            if let Some(row) = run.rows.last() {
                add("speed", row.speed);
                add("steering", row.steering);
                add("sideslip", row.sideslip);
                add("yaw-rate", row.yaw_rate);
            }
            all.push(tracking);
        }
        if all.len() == starts().len() {
            let spread = |value: fn(&Tracking) -> f64| {
                largest(all.iter().map(value)) - least(all.iter().map(value))
            };
            let apart = spread(|tracking| tracking.amplitude_m).max(spread(|one| one.lag_rad));
            measurements.add(format!("circle.spread.{plant}"), apart);
        }
    }
}

fn draw(setup: &Setup, drives: &Drives, section: &mut Section) {
    let amplitude = setup.radius_m() / (1.0 + (TURN_RATE / GAIN).powi(2)).sqrt();
    let lag = (TURN_RATE / GAIN).atan();
    // A picture for each plant.
    let pictures = |what: &str, draw: &dyn Fn(&str) -> Option<Figure>| -> Vec<Picture> {
        let drawn = PLANTS.into_iter().filter_map(|(_, plant, label)| {
            Some(Picture::new(
                format!("circle-{what}-{plant}"),
                label,
                draw(plant)?,
            ))
        });
        drawn.collect()
    };
    // Of the first start.
    let each = |what: &str, draw: fn(&Run) -> Figure| {
        pictures(what, &|plant| drives.get("outside", plant).map(draw))
    };
    section.plate(
        "Trajectory of P",
        "Reference and actual path; the car starts outside the circle and converges.",
        "From everywhere it converges, to a circle of {circle.amplitude.outside.ideal m} on the \
         ideal plant and {circle.amplitude.outside.car m} on the car: the reference's radius over \
         √1.25 ({amplitude} m) is what unit-gain proportional control without feed-forward gives. \
         The car, whose speed, acceleration and steering have limits, makes detours where the \
         ideal plant turns at once.",
        &[("amplitude", with_digits(amplitude, 4))],
        pictures("trajectory", &|plant| {
            let runs = drives.of(plant).filter(|(case, _)| *case != FEED_FORWARD);
            let runs: Vec<&Run> = runs.map(|(_, run)| run).collect();
            (!runs.is_empty()).then(|| pictures::trajectories(&runs))
        }),
    );
    section.plate(
        "Position of P over time",
        "Sinusoids with a delay between reference and actual position and, as the text says, with \
         the same amplitude; the delay is put down to the start outside the path.",
        "The delay is {circle.lag.outside.ideal rad} on the ideal plant and \
         {circle.lag.outside.car rad} on the car (theory: atan 0.5 = {lag} rad, or {lag_s} s), and \
         the amplitude is not the same.",
        &[
            ("lag", with_digits(lag, 4)),
            ("lag_s", with_digits(lag / TURN_RATE, 3)),
        ],
        each("position", Run::position),
    );
    section.plate(
        "The delay is no effect of the start",
        "No figure: the text says that the delay comes from starting outside the path.",
        "P that starts on the path and along it, {behind} rad behind its reference, falls back to \
         {circle.lag.on-the-path.ideal rad} as well ({circle.lag.on-the-path.car rad} on the car); \
         with feed-forward P from outside comes to within {circle.feed-forward.error.ideal m} of \
         its reference ({circle.feed-forward.error.car m} on the car).",
        &[("behind", BEHIND.to_string())],
        pictures("lag", &|plant| lag_figure(drives, plant, lag)),
    );
    section.plate(
        "Velocity commanded of P",
        "The outputs of the two position regulators.",
        "After the approach sinusoids of {speed} m/s: the amplitude times {rate} rad/s.",
        &[
            ("speed", with_digits(amplitude * TURN_RATE, 4)),
            ("rate", TURN_RATE.to_string()),
        ],
        each("commanded-velocity", Run::commanded_velocity),
    );
    let mut outputs = each("steering", Run::steering);
    outputs.extend(each("speed", Run::speed));
    section.plate(
        "Outputs of the law",
        "Steering and reference speed from the law, and the car's speed.",
        "On the ideal plant and on the car the steering settles on \
         {circle.steering.outside.ideal rad} and {circle.steering.outside.car rad}, the speed on \
         {circle.speed.outside.ideal m/s} and {circle.speed.outside.car m/s}.",
        &[],
        outputs,
    );
    section.plate(
        "Sideslip angle and yaw rate",
        "The measured sideslip angle and yaw rate.",
        "On the ideal plant and on the car the sideslip settles on \
         {circle.sideslip.outside.ideal rad} and {circle.sideslip.outside.car rad}, the yaw rate \
         on {circle.yaw-rate.outside.ideal rad/s} and {circle.yaw-rate.outside.car rad/s}: the car \
         turns as fast as the reference.",
        &[],
        each("sideslip-yaw-rate", Run::sideslip_and_yaw_rate),
    );
}

/// The lag of P over time, for the starts outside and on the path.
fn lag_figure(drives: &Drives, plant: &str, lag: f64) -> Option<Figure> {
    let mut curves = Vec::new();
    for (case, legend, look) in [
        ("outside", "start outside", Look::Actual),
        ("on-the-path", "start on the path", Look::Truth),
    ] {
        let run = drives.get(case, plant)?;
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
    Some(pictures::over_time(
        "How far P is behind its reference",
        "The angle from P to its reference, seen from the centre of the circle.",
        Axis::new("lag of P", Some(Symbol::new("φ", "")), "rad"),
        Width::Column,
        curves,
    ))
}
