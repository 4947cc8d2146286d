//! The law alone: piecewise constant velocities of P, without position control.

use indicatif::ProgressBar;
use singletrack_core::config::{LawKind, OuterLoopSection, ReferenceSection, StepSection};
use singletrack_figures::figure::{Curve, Figure, Look, Width};
use singletrack_scenario::simulate::{MarkerLoss, PlantKind};
use singletrack_statistics::RootMeanSquare;

use super::{
    Setup,
    drive::{Drives, Experiment, PLANTS, Run},
    pictures,
    section::{Picture, Section},
    setup::largest,
    text::{metres, mm, number, with_digits},
};

/// Velocities of P, in m/s, for the paper's car: a sequence that turns P through 225
/// degrees. The paper shows its own in a picture only.
const VELOCITIES: [[f64; 2]; 6] = [
    [0.6, 0.0],
    [0.6, 0.5],
    [0.0, 0.7],
    [-0.5, 0.5],
    [-0.7, 0.0],
    [-0.5, -0.5],
];
/// The duration of each, in s.
const STEP_S: f64 = 3.0;
/// Ticks at which the markers are lost, for 200 ms each.
const LOSSES: [u64; 4] = [200, 650, 1100, 1550];
const LOSS_TICKS: u64 = 20;

/// The open-loop test with the law's centre of mass too far to the rear.
pub(super) fn experiment(setup: &Setup, law: LawKind, deviation_m: f64) -> Experiment {
    let mut steps: Vec<StepSection> = VELOCITIES
        .iter()
        .map(|[x, y]| StepSection {
            duration_s: STEP_S,
            v_x_m_s: x * setup.scale(),
            v_y_m_s: y * setup.scale(),
        })
        .collect();
    if let Some(last) = steps.last_mut() {
        // The car stops when its reference ends, after the part that is evaluated.
        last.duration_s += 1.0;
    }
    Experiment {
        law,
        deviation_m,
        believed: None,
        outer_loop: OuterLoopSection::OpenLoop {},
        reference: ReferenceSection::VelocitySteps { steps },
        start_m: [0.0, 0.0],
        yaw_deg: 0.0,
        duration_s: STEP_S * VELOCITIES.len() as f64,
        losses: Vec::new(),
    }
}

/// The drives with right and with wrong parameters, by their names in a measurement and a file.
const CASES: [(&str, &str); 2] = [("right", "dl-0"), ("rear", "dl-rear")];
/// The first drive of the car, without marker losses.
const SEEN: &str = "seen";

pub(super) fn section(setup: &Setup, progress: &ProgressBar) -> Section {
    let deviations = [0.0, setup.rear_deviation_m()];
    let names = [
        "dl = 0".to_owned(),
        format!("dl = {}", metres(setup.rear_deviation_m())),
    ];
    let mut section = Section::new(2, "The law alone: open-loop steps");
    section.intro = format!(
        "The law is fed with six constant velocities of P, {STEP_S} s each, without position \
         control: once with the right l<sub>f</sub>, once with one that puts the centre of mass at \
         the rear axle ({}). The paper's velocities are known from its picture only; ours turn P \
         through 225°. On the car the markers are lost four times for 200 ms.",
        names[1]
    );
    let mut drives = Drives::default();
    for (((case, _), name), deviation) in CASES.into_iter().zip(&names).zip(deviations) {
        let seen = experiment(setup, LawKind::FrontPoint, deviation);
        let experiment = Experiment {
            losses: LOSSES
                .map(|first_tick| MarkerLoss {
                    first_tick,
                    ticks: LOSS_TICKS,
                })
                .to_vec(),
            ..seen.clone()
        };
        progress.set_message(format!("open-loop steps, {name}"));
        for (plant, kind, label) in PLANTS {
            if plant == PlantKind::Car && case == "right" {
                let run = section.drive(setup, plant, "car, markers always seen", &seen);
                drives.add(SEEN, kind, run);
            }
            let run = section.drive(setup, plant, &format!("{label}, {name}"), &experiment);
            drives.add(case, kind, run);
        }
    }
    measure(setup, &drives, &mut section);
    draw(setup, &names, &drives, &mut section);
    section
}

/// The distance from the true P to nominal by theory (equation 9 integrated): a wrong `l_f`
/// turns with the car.
fn predicted(deviation_m: f64, run: &Run) -> impl Iterator<Item = f64> + '_ {
    let yaw = run.rows.first().map_or(0.0, |row| row.yaw);
    run.rows
        .iter()
        .map(move |row| 2.0 * (deviation_m * ((row.yaw - yaw) / 2.0).sin()).abs())
}

fn measure(setup: &Setup, drives: &Drives, section: &mut Section) {
    let measurements = &mut section.measurements;
    for (_, plant, _) in PLANTS {
        for (case, file) in CASES {
            let Some(run) = drives.get(case, plant) else {
                continue;
            };
            let mut add =
                |what, value| measurements.add(format!("steps.{what}.{case}.{plant}"), value);
            add("largest", run.largest_deviation());
            add("rms", run.rms_deviation());
            add("path", run.path());
            // The peaks of the steering angle, in rad.
            add("steepest", run.steepest());
            let name = format!("steps-{file}-{plant}");
            section.tables.push((name, run.table()));
        }
    }
    if let Some(rear) = drives.get("rear", "ideal") {
        let both = rear
            .deviations()
            .zip(predicted(setup.rear_deviation_m(), rear));
        let residual = largest(both.map(|(measured, predicted)| (measured - predicted).abs()));
        measurements.add("steps.residual.rear.ideal", residual);
    }
    if let Some(right) = drives.get("right", "car") {
        // Both start from standstill; their difference does not contain that error.
        if let Some(rear) = drives.get("rear", "car") {
            measurements.add("steps.due_to_dl.car", rear.largest_difference(right));
        }
        if let Some(seen) = drives.get(SEEN, "car") {
            measurements.add("steps.due_to_losses.car", right.largest_difference(seen));
        }
    }
}

/// A picture of each drive, with right and wrong parameters, on either plant.
fn pictures_of(
    what: &str,
    names: &[String; 2],
    drives: &Drives,
    draw: impl Fn(&Run) -> Figure,
) -> Vec<Picture> {
    let mut pictures = Vec::new();
    for (_, plant, label) in PLANTS {
        for ((case, file), name) in CASES.into_iter().zip(names) {
            pictures.extend(drives.get(case, plant).map(|run| {
                let label = format!("{label}, {name}");
                Picture::new(format!("steps-{what}-{file}-{plant}"), label, draw(run))
            }));
        }
    }
    pictures
}

fn draw(setup: &Setup, names: &[String; 2], drives: &Drives, section: &mut Section) {
    let right = |plant| drives.get("right", plant);
    if let Some(run) = right("ideal").or(right("car")) {
        let fastest = largest(run.rows.iter().map(|row| row.v_px.hypot(row.v_py)));
        section.plate(
            "Commanded velocity of P",
            "The two components of the velocity, steps that both tests share.",
            "Six steps, of up to {fastest} m/s, that both tests and both plants share.",
            &[("fastest", with_digits(fastest, 2))],
            vec![Picture::new(
                "steps-commanded-velocity",
                "",
                run.commanded_velocity(),
            )],
        );
    }
    section.plate(
        "Steering angle generated by the law",
        "The reference steering angle for both l<sub>f</sub>.",
        "Every turn of v<sub>P</sub> is a peak that decays as the car turns into the new \
         direction: up to {steps.steepest.right.ideal rad} on the ideal plant and \
         {steps.steepest.right.car rad} on the car; with the wrong l<sub>f</sub> \
         {steps.steepest.rear.ideal rad} and {steps.steepest.rear.car rad}, and slower to decay.",
        &[],
        pictures_of("steering", names, drives, Run::steering),
    );
    section.plate(
        "Reference and actual speed",
        "The reference speed from the law (grey) and the car's (black), which follows it.",
        "The ideal plant has the speed at once; the car follows {lag}. The dips are the turns, in \
         which P moves mostly by steering.",
        &[("lag", speed_lag(right("car")))],
        pictures_of("speed", names, drives, Run::speed),
    );
    section.plate(
        "Trajectory of P",
        "Nominal (grey) and actual (black) path, from the triangle to the circle, very close to \
         each other even with the wrong l<sub>f</sub>.",
        "Over a path of {steps.path.right.ideal m} the true P of the ideal plant is at most \
         {steps.largest.right.ideal m} from nominal with the right l<sub>f</sub> and \
         {steps.largest.rear.ideal m} with the wrong one; that of the car \
         {steps.largest.right.car m} and {steps.largest.rear.car m} ({steps.rms.right.car m} and \
         {steps.rms.rear.car m} RMS): it has to start, while the nominal P moves at once.",
        &[],
        pictures_of("trajectory", names, drives, Run::trajectory),
    );
    let losses = section.measurements.get("steps.due_to_losses.car");
    section.plate(
        "Position of P over time",
        "Nominal and actual coordinates; where the cameras lose the markers the measured position \
         stays constant though the car moves.",
        "The same, with four losses of 200 ms on the car (shaded); they move P by at most {moved} \
         from where it goes without them.",
        &[(
            "moved",
            losses.map_or_else(|| "(not driven)".to_owned(), mm),
        )],
        pictures_of("position", names, drives, Run::position),
    );
    deviation_plate(setup, drives, section);
}

/// How far the car's speed lags behind its reference, in words.
fn speed_lag(run: Option<&Run>) -> String {
    let Some(run) = run else {
        return "(not driven)".to_owned();
    };
    let mut lag = RootMeanSquare::default();
    for row in run.rows.iter().filter(|row| row.t > 1.0) {
        let at = run.seen.partition_point(|seen| seen.time < row.t);
        if let Some(seen) = run.seen.get(at) {
            lag.add(seen.estimate.speed - row.speed);
        }
    }
    format!(
        "within its motor's lag, {} m/s RMS after the first second",
        with_digits(lag.value().unwrap_or(0.0), 2)
    )
}

/// The deviation of the true P over time, and that of a wrong `l_f` by theory.
fn deviation_plate(setup: &Setup, drives: &Drives, section: &mut Section) {
    let Some(rear) = drives.get("rear", "ideal") else {
        return;
    };
    let time = rear.column(|row| row.t);
    let theory = predicted(setup.rear_deviation_m(), rear).collect();
    let deviations = rear.deviations().collect();
    let mut curves = vec![
        Curve::new("2 |dl sin(Δψ/2)|", Look::Nominal, &time, theory),
        Curve::new("ideal plant", Look::Actual, &time, deviations),
    ];
    if let (Some(right), Some(rear)) = (drives.get("right", "car"), drives.get("rear", "car")) {
        let time = rear.column(|row| row.t);
        let apart = rear.differences(right).collect();
        let name = "car, from that with dl = 0";
        curves.push(Curve::new(name, Look::Truth, &time, apart));
    }
    let residual = section.measurements.get("steps.residual.rear.ideal");
    section.plate(
        "What a wrong centre of mass costs",
        "No figure: equation 9 says that P's velocity is off by dl r, and the text that the path \
         stays very close to the nominal one.",
        "Equation 9 integrates to 2 |dl sin(Δψ/2)|, which the ideal plant meets to {residual}: \
         {steps.largest.rear.ideal m} when the car has turned by 180°, nothing after a full turn. \
         On the car, {steps.due_to_dl.car m} at most from where P goes with the right \
         l<sub>f</sub>.",
        &[(
            "residual",
            residual.map_or_else(
                || "nothing".to_owned(),
                |value| format!("{} m", number(value)),
            ),
        )],
        vec![Picture::new(
            "steps-deviation",
            "",
            pictures::over_time(
                "Deviation of P with the centre of mass believed at the rear axle",
                "How far the true P is from where two integrators would be.",
                pictures::DEVIATION,
                Width::Column,
                curves,
            ),
        )],
    );
}
