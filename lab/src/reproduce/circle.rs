//! Trajectory tracking: P along a circle, from several starts.

use std::f64::consts::TAU;

use indicatif::ProgressBar;
use singletrack_core::config::{LawKind, OuterLoopSection, ReferenceSection, Start};
use singletrack_figures::figure::{Axis, Curve, Figure, Look, Symbol};
use singletrack_scenario::{
    simulate::PlantKind,
    tracking::{Sample, Tracking, last_turn},
};

use super::{
    GAIN, Setup, TURN_RATE,
    claims::{below, near},
    drive::{Drives, Experiment, PLANTS, Run},
    largest, least, pictures,
    section::{Measure, Picture, Section},
    steps,
    text::{metres, with_digits},
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
fn experiment(setup: &Setup, point: [f64; 2], yaw_deg: f64, feed_forward: bool) -> Experiment {
    Experiment {
        law: LawKind::FrontPoint,
        deviation_m: 0.0,
        believed: None,
        point_distance_m: setup.point_distance_m(),
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
/// The first start with marker losses, on the car.
const LOST: &str = "lost";
/// How often the markers are lost, in ticks: for 200 ms each, as in the open-loop steps.
const LOSS_EVERY_TICKS: u64 = 500;

pub(super) fn section(setup: &Setup, section: &mut Section, progress: &ProgressBar) {
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
    drive(
        FEED_FORWARD,
        "with feed-forward",
        &experiment(setup, point, yaw_deg, true),
    );
    progress.set_message("circle, with marker losses");
    let losses = Experiment {
        losses: steps::losses((1..8).map(|index| index * LOSS_EVERY_TICKS)),
        ..experiment(setup, point, yaw_deg, false)
    };
    let run = section.drive(setup, PlantKind::Car, "car, markers lost", &losses);
    drives.add(LOST, "car", run);
    for (_, plant, _) in PLANTS {
        for (case, run) in drives.of(plant) {
            section.table(format!("circle-{case}-{plant}"), run.table());
        }
    }
    facts(setup, &drives, section);
    claims(setup, &drives, section);
    plates(&drives, section);
}

/// The gain, and the lag in rad, of two integrators under proportional control.
fn exact(setup: &Setup) -> [f64; 2] {
    let gain = setup.amplitude_m() / setup.radius_m();
    [gain, (TURN_RATE / GAIN).atan()]
}

/// What the words of this section name.
fn facts(setup: &Setup, drives: &Drives, section: &mut Section) {
    let [gain, lag] = exact(setup);
    let reach = setup.amplitude_m();
    section.facts([
        ("radius", metres(setup.radius_m())),
        ("turn rate", TURN_RATE.to_string()),
        ("behind", BEHIND.to_string()),
        ("gain", with_digits(gain, 6)),
        ("exact lag", with_digits(lag, 6)),
        ("lag", with_digits(lag, 4)),
        ("lag in s", with_digits(lag / TURN_RATE, 3)),
        ("amplitude", with_digits(reach, 4)),
        ("velocity", with_digits(reach * TURN_RATE, 4)),
    ]);
    let plants = PLANTS.map(|(_, plant, _)| plant);
    let cases = ["outside", "on-the-path", FEED_FORWARD];
    let measures: [Measure; 3] = [
        (
            "amplitude",
            |run| tracking(run).map(|it| it.amplitude_m),
            "m",
        ),
        ("lag", |run| tracking(run).map(|it| it.lag_rad), "rad"),
        ("error", |run| tracking(run).map(|it| it.rms_error_m), "m"),
    ];
    section.measured(drives, (&cases, &plants), &measures);
    let settled: [Measure; 4] = [
        ("steering", |run| Some(run.rows.last()?.steering), "rad"),
        ("speed", |run| Some(run.rows.last()?.speed), "m/s"),
        ("sideslip", |run| Some(run.rows.last()?.sideslip), "rad"),
        ("yaw rate", |run| Some(run.rows.last()?.yaw_rate), "rad/s"),
    ];
    section.measured(drives, (&["outside"], &plants), &settled);
}

fn amplitude(one: &Tracking) -> f64 {
    one.amplitude_m
}

fn lag(one: &Tracking) -> f64 {
    one.lag_rad
}

fn error(one: &Tracking) -> f64 {
    one.rms_error_m
}

/// A result of the last turn of a drive.
fn of(drives: &Drives, case: &str, plant: &str, value: fn(&Tracking) -> f64) -> Option<f64> {
    drives
        .get(case, plant)
        .and_then(tracking)
        .as_ref()
        .map(value)
}

/// The largest difference between the starts in amplitude (m) and lag (rad).
fn spread(drives: &Drives, plant: &str) -> Option<f64> {
    let spread = |value| {
        let each = starts().map(|(case, ..)| of(drives, case, plant, value));
        let each = || each.iter().map(|value| value.unwrap_or(f64::NAN));
        largest(each()) - least(each())
    };
    let (amplitude, lag) = (spread(amplitude), spread(lag));
    (!amplitude.is_nan() && !lag.is_nan()).then(|| amplitude.max(lag))
}

fn claims(setup: &Setup, drives: &Drives, section: &mut Section) {
    let (radius, reach) = (setup.radius_m(), setup.amplitude_m());
    let [_, behind] = exact(setup);
    let distance = radius / (1.0 + (GAIN / TURN_RATE).powi(2)).sqrt();
    // The criteria of the simulated car are for one of the paper's size.
    let count = if setup.is_paper() { 2 } else { 1 };
    let plants = |labels: [&'static str; 2], tolerances: [f64; 2]| {
        let plants = labels.into_iter().zip(["ideal", "car"]).zip(tolerances);
        plants
            .take(count)
            .map(|((label, plant), tolerance)| (label, plant, tolerance))
    };
    let claim = section.claim("circle-converges");
    for (label, plant, tolerance) in plants(["apart, ideal", "apart, car"], [1e-4, 0.01]) {
        claim.number(label, spread(drives, plant), near(0.0, tolerance));
    }
    let claim = section.claim("circle-amplitude");
    for (label, plant, tolerance) in plants(["ideal", "car"], [1e-5, 0.02]) {
        let value = of(drives, "outside", plant, amplitude);
        let same = near(radius, 0.01 * radius);
        claim.slip(label, value, same, near(reach, tolerance * radius));
    }
    let claim = section.claim("circle-lag");
    for (label, plant, tolerance) in
        plants(["on the path, ideal", "on the path, car"], [1e-5, 0.02])
    {
        let value = of(drives, "on-the-path", plant, lag);
        claim.slip(label, value, near(0.0, 0.01), near(behind, tolerance));
    }
    let claim = section.claim("circle-linear-tools");
    for (label, plant, tolerance) in plants(["error, ideal", "error, car"], [1e-4 * radius, 0.02]) {
        let value = of(drives, FEED_FORWARD, plant, error);
        claim.number(label, value, near(0.0, tolerance));
    }
    let apart = drives.get(LOST, "car").zip(drives.get("outside", "car"));
    let apart = apart.map(|(lost, seen)| lost.largest_difference(seen));
    section
        .claim("circle-losses")
        .number("car", apart, below(0.1));
    section
        .claim("circle-carpet")
        .number("reference", 2.0 * radius, near(2.0, 1e-9))
        .number("P", 2.0 * reach, below(2.0));
    let claim = section.claim("circle-satisfactory");
    for (label, plant, tolerance) in plants(["ideal", "car"], [1e-3, 0.02]) {
        let value = of(drives, "outside", plant, error);
        claim.number(label, value, near(distance, tolerance));
    }
}

fn plates(drives: &Drives, section: &mut Section) {
    // A picture for each plant.
    let pictures = |what: &str, draw: &dyn Fn(&str) -> Option<Figure>| -> Vec<Picture> {
        let drawn = PLANTS.into_iter().filter_map(|(_, plant, label)| {
            let name = format!("circle-{what}-{plant}");
            Some(Picture::new(name, label, draw(plant)?))
        });
        drawn.collect()
    };
    // Of the first start.
    let each = |what: &str, draw: fn(&Run) -> Figure| {
        pictures(what, &|plant| drives.get("outside", plant).map(draw))
    };
    let trajectories = pictures("trajectory", &|plant| {
        let runs = drives.of(plant);
        let runs = runs.filter(|(case, _)| ![FEED_FORWARD, LOST].contains(case));
        let runs: Vec<&Run> = runs.map(|(_, run)| run).collect();
        (!runs.is_empty()).then(|| pictures::trajectories(&runs))
    });
    section.plate("trajectory", trajectories);
    let mut positions = each("position", Run::position);
    positions.extend(drives.get(LOST, "car").map(|run| {
        let label = "car, with marker losses";
        Picture::new("circle-position-lost", label, run.position())
    }));
    section.plate("position", positions);
    let lags = pictures("lag", &|plant| lag_figure(drives, plant));
    section.plate("lag", lags);
    let velocities = each("commanded-velocity", Run::commanded_velocity);
    section.plate("commanded-velocity", velocities);
    let mut outputs = each("steering", Run::steering);
    outputs.extend(each("speed", Run::speed));
    section.plate("outputs", outputs);
    let sideslip = each("sideslip-yaw-rate", Run::sideslip_and_yaw_rate);
    section.plate("sideslip", sideslip);
}

/// The lag of P over time, for the starts outside and on the path.
fn lag_figure(drives: &Drives, plant: &str) -> Option<Figure> {
    let mut curves = Vec::new();
    for (case, legend, look) in [
        ("outside", "start outside", Look::Actual),
        ("on-the-path", "start on the path", Look::Truth),
    ] {
        let run = drives.get(case, plant)?;
        let time = run.column(|row| row.t);
        if curves.is_empty() {
            let theory = run.column(|_| (TURN_RATE / GAIN).atan());
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
        curves,
    ))
}
