//! The law alone: piecewise constant velocities of P, without position control.

use singletrack_core::config::{LawKind, OuterLoopSection, ReferenceSection, StepSection};
use singletrack_figures::figure::{Axis, Curve, Look, Symbol, Width};
use singletrack_scenario::simulate::MarkerLoss;
use singletrack_statistics::RootMeanSquare;

use super::{
    Setup,
    drive::{Experiment, Run},
    extreme::largest,
    pictures,
    progress::Progress,
    section::{Picture, Plate, Section, Table, or_note},
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

/// The drives with right and with wrong parameters, on both plants.
struct Drives {
    ideal: [Option<Run>; 2],
    car: [Option<Run>; 2],
    /// The first drive of the car, without marker losses.
    seen: Option<Run>,
}

pub(super) fn section(setup: &Setup, progress: &Progress) -> Section {
    let mut section = Section {
        number: 2,
        title: "The law alone: open-loop steps",
        ..Section::default()
    };
    let deviations = [0.0, setup.rear_deviation_m()];
    let names = [
        "dl = 0".to_owned(),
        format!("dl = {}", metres(setup.rear_deviation_m())),
    ];
    section.intro.push(format!(
        "The law is fed with six constant velocities of P, {STEP_S} s each, without position \
         control: once with the right l<sub>f</sub>, once with one that puts the centre of mass at \
         the rear axle ({}). The paper's velocities are known from its picture only; ours turn P \
         through 225°. On the car the markers are lost four times for 200 ms.",
        names[1]
    ));
    let mut drives = Drives {
        ideal: [None, None],
        car: [None, None],
        seen: None,
    };
    for (index, deviation) in deviations.into_iter().enumerate() {
        let (Some(name), Some(ideal), Some(car)) = (
            names.get(index),
            drives.ideal.get_mut(index),
            drives.car.get_mut(index),
        ) else {
            continue;
        };
        let mut experiment = experiment(setup, LawKind::FrontPoint, deviation);
        progress.doing(&format!("open-loop steps, {name}"));
        *ideal = section.keep(&format!("ideal plant, {name}"), experiment.ideal(setup));
        if index == 0 {
            drives.seen = section.drive_car(setup, "markers always seen", &experiment);
        }
        experiment.losses = LOSSES
            .map(|first_tick| MarkerLoss {
                first_tick,
                ticks: LOSS_TICKS,
            })
            .to_vec();
        *car = section.drive_car(setup, name, &experiment);
    }
    measure(setup, &drives, &mut section);
    tabulate(&drives, &mut section);
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
    for (plant, runs) in [("ideal", &drives.ideal), ("car", &drives.car)] {
        for (which, run) in ["right", "rear"].into_iter().zip(runs) {
            let Some(run) = run else { continue };
            measurements.add(
                format!("steps.largest.{which}.{plant}"),
                run.largest_deviation(),
            );
            measurements.add(format!("steps.rms.{which}.{plant}"), run.rms_deviation());
            measurements.add(format!("steps.path.{which}.{plant}"), run.path());
        }
    }
    if let [_, Some(rear)] = &drives.ideal {
        let both = rear
            .deviations()
            .zip(predicted(setup.rear_deviation_m(), rear));
        let residual = largest(both.map(|(measured, predicted)| (measured - predicted).abs()));
        measurements.add("steps.residual.rear.ideal", residual);
    }
    if let [Some(right), Some(rear)] = &drives.car {
        // Both start from standstill; their difference does not contain that error.
        measurements.add("steps.due_to_dl.car", rear.largest_difference(right));
    }
    if let ([Some(right), _], Some(seen)) = (&drives.car, &drives.seen) {
        measurements.add("steps.due_to_losses.car", right.largest_difference(seen));
    }
}

fn tabulate(drives: &Drives, section: &mut Section) {
    for (plant, runs) in [("ideal", &drives.ideal), ("car", &drives.car)] {
        for (which, run) in ["dl-0", "dl-rear"].into_iter().zip(runs) {
            if let Some(run) = run {
                let name = format!("steps-{which}-{plant}");
                section.tables.push(Table::of_rows(name, &run.rows));
            }
        }
    }
}

/// A picture of each drive, with right and wrong parameters, on either plant.
fn pictures_of(
    what: &str,
    names: &[String; 2],
    drives: &Drives,
    draw: impl Fn(&Run) -> singletrack_figures::figure::Figure,
) -> Vec<Picture> {
    let mut pictures = Vec::new();
    for (plant, runs) in [("ideal", &drives.ideal), ("car", &drives.car)] {
        let short = ["dl-0", "dl-rear"];
        for ((name, short), run) in names.iter().zip(short).zip(runs) {
            if let Some(run) = run {
                let label = match plant {
                    "ideal" => format!("ideal plant, {name}"),
                    _ => format!("car, {name}"),
                };
                let file = format!("steps-{what}-{short}-{plant}");
                pictures.push(Picture::new(file, label, draw(run)));
            }
        }
    }
    pictures
}

/// The peaks of the steering angle of a drive, largest first, in rad.
fn steepest(run: Option<&Run>) -> Option<f64> {
    run.map(|run| largest(run.rows.iter().map(|row| row.steering.abs())))
}

fn draw(setup: &Setup, names: &[String; 2], drives: &Drives, section: &mut Section) {
    let measured = section.measurements.clone();
    let get = |name: &str| measured.get(name);
    let length = |name: &str| or_note(get(name), "m");
    let [ideal_right, ideal_rear] = &drives.ideal;
    let [car_right, car_rear] = &drives.car;

    if let Some(run) = ideal_right.as_ref().or(car_right.as_ref()) {
        let fastest = largest(run.rows.iter().map(|row| row.v_px.hypot(row.v_py)));
        section.plates.push(Plate {
            title: "Commanded velocity of P".to_owned(),
            paper: "The two components of the velocity, steps that both tests share.".to_owned(),
            ours: format!(
                "Six steps, of up to {} m/s, that both tests and both plants share.",
                with_digits(fastest, 2)
            ),
            pictures: vec![Picture::new(
                "steps-commanded-velocity",
                "",
                run.commanded_velocity(),
            )],
        });
    }
    let angle = |run: &Option<Run>| or_note(steepest(run.as_ref()), "rad");
    section.plates.push(Plate {
        title: "Steering angle generated by the law".to_owned(),
        paper: "The reference steering angle for both l<sub>f</sub>.".to_owned(),
        ours: format!(
            "Every turn of v<sub>P</sub> is a peak that decays as the car turns into the new \
             direction: up to {} on the ideal plant and {} on the car; with the wrong \
             l<sub>f</sub> {} and {}, and slower to decay.",
            angle(ideal_right),
            angle(car_right),
            angle(ideal_rear),
            angle(car_rear)
        ),
        pictures: pictures_of("steering", names, drives, Run::steering),
    });
    section.plates.push(Plate {
        title: "Reference and actual speed".to_owned(),
        paper: "The reference speed from the law (grey) and the car's (black), which follows it."
            .to_owned(),
        ours: format!(
            "The ideal plant has the speed at once; the car follows {}. The dips are the turns, in \
             which P moves mostly by steering.",
            speed_lag(car_right.as_ref())
        ),
        pictures: pictures_of("speed", names, drives, Run::speed),
    });
    section.plates.push(Plate {
        title: "Trajectory of P".to_owned(),
        paper: "Nominal (grey) and actual (black) path, from the triangle to the circle, very \
                close to each other even with the wrong l<sub>f</sub>."
            .to_owned(),
        ours: format!(
            "Over a path of {} the true P of the ideal plant is at most {} from nominal with the \
             right l<sub>f</sub> and {} with the wrong one; that of the car {} and {} ({} and {} \
             RMS): it has to start, while the nominal P moves at once.",
            length("steps.path.right.ideal"),
            length("steps.largest.right.ideal"),
            length("steps.largest.rear.ideal"),
            length("steps.largest.right.car"),
            length("steps.largest.rear.car"),
            length("steps.rms.right.car"),
            length("steps.rms.rear.car"),
        ),
        pictures: pictures_of("trajectory", names, drives, Run::trajectory),
    });
    section.plates.push(Plate {
        title: "Position of P over time".to_owned(),
        paper: "Nominal and actual coordinates; where the cameras lose the markers the measured \
                position stays constant though the car moves."
            .to_owned(),
        ours: format!(
            "The same, with four losses of 200 ms on the car (shaded); they move P by at most {} \
             from where it goes without them.",
            get("steps.due_to_losses.car").map_or_else(|| "(not driven)".to_owned(), mm)
        ),
        pictures: pictures_of("position", names, drives, Run::position),
    });
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
            lag.add(seen.speed - row.speed);
        }
    }
    format!(
        "within its motor's lag, {} m/s RMS after the first second",
        with_digits(lag.value().unwrap_or(0.0), 2)
    )
}

/// The deviation of the true P over time, and that of a wrong `l_f` by theory.
fn deviation_plate(setup: &Setup, drives: &Drives, section: &mut Section) {
    let [_, Some(rear)] = &drives.ideal else {
        return;
    };
    let time = rear.column(|row| row.t);
    let mut curves = vec![
        Curve::new(
            "2 |dl sin(Δψ/2)|",
            Look::Nominal,
            &time,
            predicted(setup.rear_deviation_m(), rear).collect(),
        ),
        Curve::new(
            "ideal plant",
            Look::Actual,
            &time,
            rear.deviations().collect(),
        ),
    ];
    if let [Some(right), Some(rear)] = &drives.car {
        let apart = rear
            .rows
            .iter()
            .zip(&right.rows)
            .map(|(one, other)| (one.x_p - other.x_p).hypot(one.y_p - other.y_p));
        curves.push(Curve::new(
            "car, from that with dl = 0",
            Look::Truth,
            &rear.column(|row| row.t),
            apart.collect(),
        ));
    }
    let measured = section.measurements.clone();
    let y = Axis {
        include: Some(0.0),
        ..Axis::new("deviation of P", Some(Symbol::new("e", "P")), "m")
    };
    section.plates.push(Plate {
        title: "What a wrong centre of mass costs".to_owned(),
        paper: "No figure: equation 9 says that P's velocity is off by dl r, and the text that \
                the path stays very close to the nominal one."
            .to_owned(),
        ours: format!(
            "Equation 9 integrates to 2 |dl sin(Δψ/2)|, which the ideal plant meets to {}: {} when \
             the car has turned by 180°, nothing after a full turn. On the car, {} at most from \
             where P goes with the right l<sub>f</sub>.",
            measured.get("steps.residual.rear.ideal").map_or_else(
                || "nothing".to_owned(),
                |value| format!("{} m", number(value))
            ),
            or_note(measured.get("steps.largest.rear.ideal"), "m"),
            or_note(measured.get("steps.due_to_dl.car"), "m"),
        ),
        pictures: vec![Picture::new(
            "steps-deviation",
            "",
            pictures::over_time(
                "Deviation of P with the centre of mass believed at the rear axle",
                "How far the true P is from where two integrators would be.",
                y,
                Width::Column,
                curves,
            ),
        )],
    });
}
