//! Trajectory tracking: P along a circle, from several starts.

use std::f64::consts::TAU;

use indicatif::ProgressBar;
use singletrack_core::config::{LawKind, OuterLoopSection, ReferenceSection, Start};
use singletrack_figures::figure::{Axis, Curve, Figure, Look, Symbol};
use singletrack_scenario::{
    simulate::{PlantKind, Row, Scenario, StartSection},
    tracking::{Sample, Tracking, last_turn},
};

use super::{
    GAIN, Setup, TURN_RATE,
    drive::{Drives, PLANTS, Run},
    largest, least, pictures,
    section::{Below, Near, Picture, Scope, Section, metres, number, told, with_digits},
    steps,
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
fn experiment(setup: &Setup, point: [f64; 2], yaw_deg: f64, feed_forward: bool) -> Scenario {
    let mut scenario = setup.circle(LawKind::FrontPoint, 0.0);
    scenario.outer_loop = OuterLoopSection::Proportional {
        gain_per_s: [GAIN; 2],
        feed_forward,
    };
    scenario.reference = ReferenceSection::Circle {
        radius_m: setup.radius_m(),
        angular_velocity_rad_s: TURN_RATE,
        centre_m: [0.0, 0.0],
        start: Start::Beginning,
    };
    scenario.start = StartSection {
        point_p_m: point.map(|coordinate| coordinate * setup.radius_m()),
        yaw_deg,
    };
    // The start must have no effect on the last turn.
    scenario.run.duration_s = if setup.quick { 30.0 } else { 40.0 };
    scenario
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

pub(super) fn section(setup: &Setup, progress: &ProgressBar) -> Section {
    let intro = format!(
        "Radius {} m, {TURN_RATE} rad/s, proportional control with unit gain around the law, from \
         several starts; and from the first again with the reference's velocity fed forward.",
        number(setup.radius_m())
    );
    let mut section = Section::new(3, "Tracking a circle", intro);
    let mut drives = Drives::default();
    let mut drive = |case, what: &str, experiment: &Scenario| {
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
    let losses = Scenario {
        marker_loss: steps::losses((1..8).map(|index| index * LOSS_EVERY_TICKS)),
        ..experiment(setup, point, yaw_deg, false)
    };
    let run = section.drive(setup, PlantKind::Car, "car, markers lost", &losses);
    drives.add(LOST, "car", run);
    for (_, plant, _) in PLANTS {
        for (case, run) in drives.of(plant) {
            section.table(format!("circle-{case}-{plant}"), run.table());
        }
    }
    claims(setup, &drives, &mut section);
    plates(setup, &drives, &mut section);
    section
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
    // Gain, lag and distance of two integrators under proportional control.
    let gain = reach / radius;
    let behind = (TURN_RATE / GAIN).atan();
    let distance = radius / (1.0 + (GAIN / TURN_RATE).powi(2)).sqrt();
    // The criteria of the simulated car are for one of the paper's size.
    let count = if setup.is_paper() { 2 } else { 1 };
    let plants = |labels: [&'static str; 2], tolerances: [f64; 2]| {
        let plants = labels.into_iter().zip(["ideal", "car"]).zip(tolerances);
        plants
            .take(count)
            .map(|((label, plant), tolerance)| (label, plant, tolerance))
    };
    let claim = section.claim(
        ("circle-converges", Scope::AnyCar, "m, rad"),
        "P converges to the path, wherever it starts",
        "\"guarantees the convergence to the desired trajectory even in this situation\": all \
         starts end alike",
        "amplitude and lag of the last turn, from four starts; to a path of its own: see below",
    );
    for (label, plant, tolerance) in plants(["apart, ideal", "apart, car"], [1e-4, 0.01]) {
        claim.number(label, spread(drives, plant), Near(0.0, tolerance));
    }
    let claim = section.claim(
        ("circle-amplitude", Scope::AnyCar, "m"),
        "Reference and actual position have the same amplitude",
        format!("\"sinusoids with the same amplitude\": {}", metres(radius)),
        format!(
            "two integrators under unit gain are a low-pass: 1/√(1 + 0.5²) = {} of the \
             reference's amplitude",
            with_digits(gain, 6)
        ),
    );
    for (label, plant, tolerance) in plants(["ideal", "car"], [1e-5, 0.02]) {
        let value = of(drives, "outside", plant, amplitude);
        let same = Near(radius, 0.01 * radius);
        claim.slip(label, value, same, Near(reach, tolerance * radius));
    }
    let claim = section.claim(
        ("circle-lag", Scope::AnyCar, "rad"),
        "The delay comes from the start outside the path",
        "\"as the vehicle starts outside the desired path\": a start on the path would have none",
        format!(
            "it is the steady state of proportional control, atan(0.5) = {} rad, from every \
             start, also from one on the path",
            with_digits(behind, 6)
        ),
    );
    for (label, plant, tolerance) in
        plants(["on the path, ideal", "on the path, car"], [1e-5, 0.02])
    {
        let value = of(drives, "on-the-path", plant, lag);
        claim.slip(label, value, Near(0.0, 0.01), Near(behind, tolerance));
    }
    let claim = section.claim(
        ("circle-linear-tools", Scope::AnyCar, "m"),
        "Any tool of linear control can be put around the law",
        "\"any linear system tool can be applied\": with the reference's velocity fed forward two \
         integrators follow without error",
        "amplitude and delay are then those of the reference; on the car noise, lags and delays \
         are left",
    );
    for (label, plant, tolerance) in plants(["error, ideal", "error, car"], [1e-4 * radius, 0.02]) {
        let value = of(drives, FEED_FORWARD, plant, error);
        claim.number(label, value, Near(0.0, tolerance));
    }
    let apart = drives.get(LOST, "car").zip(drives.get("outside", "car"));
    let apart = apart.map(|(lost, seen)| lost.largest_difference(seen));
    section
        .claim(
            ("circle-losses", Scope::RealCar, "m"),
            "Holding the last pose does little harm on the circle, too",
            "\"robust to this disturbance as well\", said of the steps; the position traces of the \
             circle stand still now and then, too: taken as below 0.1 m",
            "a loss of 200 ms every 5 s, against the same drive without them",
        )
        .number("car", apart, Below(0.1));
    section
        .claim(
            ("circle-carpet", Scope::RealCar, "m"),
            "A circle of 1 m is driven on a carpet of 4 m²",
            "\"a four square meter carpet\", \"a radius of 1 m\": taken as a square, P within 2 m",
            "P goes round on 0.894 m and leaves 0.1 m; a car that followed the reference itself \
             would touch the edges, and a start outside of the circle is in a corner or off the \
             carpet",
        )
        .number("reference", 2.0 * radius, Near(2.0, 1e-9))
        .number("P", 2.0 * reach, Below(2.0));
    let claim = section.claim(
        ("circle-satisfactory", Scope::Nobody, "m"),
        "The tracking of the circle is satisfactory",
        "\"satisfactory tracking performance even with a proportional position control law\"; no \
         number",
        "P stays 0.447 m from its reference, nearly half of the radius: r/√(1 + (K/ω)²). With the \
         reference's velocity fed forward it is zero",
    );
    for (label, plant, tolerance) in plants(["ideal", "car"], [1e-3, 0.02]) {
        let value = of(drives, "outside", plant, error);
        claim.number(label, value, Near(distance, tolerance));
    }
}

fn plates(setup: &Setup, drives: &Drives, section: &mut Section) {
    let amplitude_m = setup.amplitude_m();
    let behind = (TURN_RATE / GAIN).atan();
    let at = |case, plant, value, unit| told(of(drives, case, plant, value), unit);
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
    section.plate(
        "Trajectory of P",
        "Reference and actual path; the car starts outside the circle and converges.",
        format!(
            "From everywhere it converges, to a circle of {} on the ideal plant and {} on the car: \
             the reference's radius over √1.25 ({} m) is what unit-gain proportional control \
             without feed-forward gives. The car, whose speed, acceleration and steering have \
             limits, makes detours where the ideal plant turns at once.",
            at("outside", "ideal", amplitude, "m"),
            at("outside", "car", amplitude, "m"),
            with_digits(amplitude_m, 4)
        ),
        pictures("trajectory", &|plant| {
            let runs = drives.of(plant);
            let runs = runs.filter(|(case, _)| ![FEED_FORWARD, LOST].contains(case));
            let runs: Vec<&Run> = runs.map(|(_, run)| run).collect();
            (!runs.is_empty()).then(|| pictures::trajectories(&runs))
        }),
    );
    let mut positions = each("position", Run::position);
    positions.extend(drives.get(LOST, "car").map(|run| {
        let label = "car, with marker losses";
        Picture::new("circle-position-lost", label, run.position())
    }));
    section.plate(
        "Position of P over time",
        "Sinusoids with a delay between reference and actual position and, as the text says, with \
         the same amplitude; the delay is put down to the start outside the path.",
        format!(
            "The delay is {} on the ideal plant and {} on the car (theory: atan 0.5 = {} rad, or \
             {} s), and the amplitude is not the same.",
            at("outside", "ideal", lag, "rad"),
            at("outside", "car", lag, "rad"),
            with_digits(behind, 4),
            with_digits(behind / TURN_RATE, 3)
        ),
        positions,
    );
    section.plate(
        "The delay is no effect of the start",
        "No figure: the text says that the delay comes from starting outside the path.",
        format!(
            "P that starts on the path and along it, {BEHIND} rad behind its reference, falls back \
             to {} as well ({} on the car); with feed-forward P from outside comes to within {} of \
             its reference ({} on the car).",
            at("on-the-path", "ideal", lag, "rad"),
            at("on-the-path", "car", lag, "rad"),
            at(FEED_FORWARD, "ideal", error, "m"),
            at(FEED_FORWARD, "car", error, "m")
        ),
        pictures("lag", &|plant| lag_figure(drives, plant, behind)),
    );
    section.plate(
        "Velocity commanded of P",
        "The outputs of the two position regulators.",
        format!(
            "After the approach sinusoids of {} m/s: the amplitude times {TURN_RATE} rad/s.",
            with_digits(amplitude_m * TURN_RATE, 4)
        ),
        each("commanded-velocity", Run::commanded_velocity),
    );
    // On either plant, at the end.
    let settled = |value: fn(&Row) -> f64, unit: &str| {
        ["ideal", "car"].map(|plant| {
            let run = drives.get("outside", plant);
            told(run.and_then(|run| run.rows.last()).map(value), unit)
        })
    };
    let [steering, car_steering] = settled(|row| row.steering, "rad");
    let [speed, car_speed] = settled(|row| row.speed, "m/s");
    let mut outputs = each("steering", Run::steering);
    outputs.extend(each("speed", Run::speed));
    section.plate(
        "Outputs of the law",
        "Steering and reference speed from the law, and the car's speed.",
        format!(
            "On the ideal plant and on the car the steering settles on {steering} and \
             {car_steering}, the speed on {speed} and {car_speed}."
        ),
        outputs,
    );
    let [sideslip, car_sideslip] = settled(|row| row.sideslip, "rad");
    let [yaw_rate, car_yaw_rate] = settled(|row| row.yaw_rate, "rad/s");
    section.plate(
        "Sideslip angle and yaw rate",
        "The measured sideslip angle and yaw rate.",
        format!(
            "On the ideal plant and on the car the sideslip settles on {sideslip} and \
             {car_sideslip}, the yaw rate on {yaw_rate} and {car_yaw_rate}: the car turns as fast \
             as the reference."
        ),
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
        curves,
    ))
}
