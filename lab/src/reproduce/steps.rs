//! The law alone: piecewise constant velocities of P, without position control.

use indicatif::ProgressBar;
use singletrack_control::statistics::RootMeanSquare;
use singletrack_core::config::{LawKind, OuterLoopSection, ReferenceSection, StepSection};
use singletrack_figures::figure::{Curve, Figure, Look};
use singletrack_scenario::simulate::{MarkerLoss, PlantKind, Scenario, StartSection};

use super::{
    Setup, assumptions,
    drive::{Drives, PLANTS, Run, ideal},
    largest, least, pictures,
    section::{self, Above, Below, Near, Picture, Scope, Section, metres, mm, number, with_digits},
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

/// Losses of the markers that begin at these ticks.
pub(super) fn losses(ticks: impl IntoIterator<Item = u64>) -> Vec<MarkerLoss> {
    let loss = |first_tick| MarkerLoss {
        first_tick,
        ticks: LOSS_TICKS,
        repeat_ticks: 0,
    };
    ticks.into_iter().map(loss).collect()
}

/// The open-loop test with the law's centre of mass too far to the rear.
pub(super) fn experiment(setup: &Setup, law: LawKind, deviation_m: f64) -> Scenario {
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
    let mut scenario = setup.circle(law, deviation_m);
    scenario.outer_loop = OuterLoopSection::OpenLoop {};
    scenario.reference = ReferenceSection::VelocitySteps { steps };
    scenario.start = StartSection {
        point_p_m: [0.0, 0.0],
        yaw_deg: 0.0,
    };
    scenario.run.duration_s = STEP_S * VELOCITIES.len() as f64;
    scenario
}

/// The drives with right and with wrong parameters, by their names here and in a file.
const CASES: [(&str, &str); 2] = [("right", "dl-0"), ("rear", "dl-rear")];
/// The first drive of the car, without marker losses.
const SEEN: &str = "seen";

pub(super) fn section(setup: &Setup, progress: &ProgressBar) -> Section {
    let deviations = [0.0, setup.rear_deviation_m()];
    let names = [
        "dl = 0".to_owned(),
        format!("dl = {}", metres(setup.rear_deviation_m())),
    ];
    let intro = format!(
        "The law is fed with six constant velocities of P, {STEP_S} s each, without position \
         control: once with the right l<sub>f</sub>, once with one that puts the centre of mass at \
         the rear axle ({}; the 0.132 m of the paper's captions is a misprint). The paper's velocities are known from its picture only; ours turn P \
         through 225°. On the car the markers are lost four times for 200 ms.",
        names[1]
    );
    let mut section = Section::new(2, "The law alone: open-loop steps", intro);
    let mut drives = Drives::default();
    for (((case, _), name), deviation) in CASES.into_iter().zip(&names).zip(deviations) {
        let seen = experiment(setup, LawKind::FrontPoint, deviation);
        let experiment = Scenario {
            marker_loss: losses(LOSSES),
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
    for (_, plant, _) in PLANTS {
        for (case, file) in CASES {
            if let Some(run) = drives.get(case, plant) {
                section.table(format!("steps-{file}-{plant}"), run.table());
            }
        }
    }
    claims(setup, &drives, &mut section);
    plates(setup, &names, &drives, &mut section);
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

/// The largest difference of the measured deviation from the one of theory, in m.
fn residual(setup: &Setup, drives: &Drives) -> Option<f64> {
    let rear = drives.get("rear", "ideal")?;
    let theory = predicted(setup.rear_deviation_m(), rear);
    let both = rear.deviations().zip(theory);
    Some(largest(
        both.map(|(measured, theory)| (measured - theory).abs()),
    ))
}

/// How far the front wheel is from the path of P at most, with P at fractions of the paper's
/// distance, in m. The drive begins with P, and the wheel behind it.
fn wheel_from_path(setup: &Setup, fraction: f64) -> Option<f64> {
    let mut experiment = experiment(setup, LawKind::FrontPoint, 0.0);
    let p = fraction * setup.point_distance_m();
    experiment.law.point_distance_m = p;
    let rows = ideal(&experiment).ok()?.rows;
    let wheels = rows.iter().filter(|row| row.t >= 1.0).map(|row| {
        let (sin, cos) = (row.yaw + row.steering).sin_cos();
        [row.x_p - p * cos, row.y_p - p * sin]
    });
    let distance = |[x, y]: [f64; 2]| {
        let path = rows.iter().zip(rows.iter().skip(1));
        let path = path.map(|(one, next)| {
            let along = [next.x_ref - one.x_ref, next.y_ref - one.y_ref];
            let from = [x - one.x_ref, y - one.y_ref];
            let length = along[0].powi(2) + along[1].powi(2);
            let share = (from[0] * along[0] + from[1] * along[1]) / length;
            let share = share.clamp(0.0, 1.0);
            (from[0] - share * along[0]).hypot(from[1] - share * along[1])
        });
        least(path)
    };
    Some(largest(wheels.map(distance)))
}

/// The largest distance between the P of two drives of the car, in m. Both start from standstill:
/// their difference does not contain that error.
fn apart(drives: &Drives, one: &str, other: &str) -> Option<f64> {
    let one = drives.get(one, "car")?;
    Some(one.largest_difference(drives.get(other, "car")?))
}

fn claims(setup: &Setup, drives: &Drives, section: &mut Section) {
    let largest = |case, plant| drives.get(case, plant).map(Run::largest_deviation);
    let [right, rear] = ["right", "rear"].map(|case| largest(case, "ideal"));
    let wheelbase = setup.vehicle.wheelbase_m();
    let dl = setup.rear_deviation_m();
    let corner = "cos(β − δ) at 40°, −50°";
    let cosine = assumptions::cosine_refused(setup, 40.0, -50.0);
    section
        .claim(
            ("steps-integrators", Scope::AnyCar, "m"),
            "With the right l_f the law makes of P two independent integrators",
            "\"behaves as predicted by the theory, i.e., as two independent integrators\": \
             deviation 0",
            "equations 4 to 7; the deviation left is the integrator's",
        )
        .number("ideal", right, Near(0.0, 1e-6));
    section
        .claim(
            ("steps-close", Scope::PaperCar, "m"),
            "Without position control P stays very close to its nominal path",
            "\"very close to the nominal one\"; no number: taken as within a wheelbase, which is lenient",
            format!(
                "the wheelbase is {}; the largest deviation is 2 dl",
                metres(wheelbase)
            ),
        )
        .number("ideal, dl = 0", right, Below(wheelbase))
        .number("ideal, dl = l_r", rear, Below(wheelbase));
    section
        .claim(
            ("steps-close-car", Scope::RealCar, "m"),
            "On the car P stays close to its nominal path, in spite of non-idealities and marker losses",
            "\"very close to the nominal one\", \"robust to this disturbance as well\"; no \
             number: taken as within a wheelbase, which is lenient",
            "most of it arises in the first second: the nominal P moves at once, the simulated \
             car has to start; there are no data of the real one to compare with",
        )
        .number("dl = 0", largest("right", "car"), Below(wheelbase))
        .number("dl = l_r", largest("rear", "car"), Below(wheelbase));
    section
        .claim(
            ("steps-losses", Scope::RealCar, "m"),
            "Holding the last pose while the markers are lost does little harm",
            "\"robust to this disturbance as well\"; no number: taken as below 0.1 m",
            "four losses of 200 ms against the same drive without them",
        )
        .number("car", apart(drives, "right", SEEN), Below(0.1));
    section
        .claim(
            ("steps-uncertain-integrators", Scope::AnyCar, "m"),
            format!("P stays two integrators with dl = {}", metres(dl)),
            "\"as two independent integrators, even in the presence of uncertainty\": deviation 0",
            format!(
                "the law linearises the P it believes in; the true one deviates by 2 |dl \
                 sin(Δψ/2)|: {} over a turn of 180°",
                metres(2.0 * dl)
            ),
        )
        .slip("ideal", rear, Near(0.0, 1e-6), Near(2.0 * dl, 1e-3 * dl));
    section
        .claim(
            ("steps-deviation-law", Scope::AnyCar, "m"),
            "With a wrong l_f P's velocity is off by dl r, across the car",
            "equation 9, which integrates to a deviation of 2 |dl sin(Δψ/2)|",
            "the deviation measured, less the one of theory, at most",
        )
        .number("residual, ideal", residual(setup, drives), Near(0.0, 1e-6));
    section
        .claim(
            ("singularity", Scope::AnyCar, ""),
            "The singularity β − δ = 90° is out of reach",
            "\"never satisfied\" for sideslip up to ±40° and steering up to ±50°",
            "the corner of the stated ranges is 40° + 50° = 90°, where the law refuses to \
             answer; with steering up to 26°, as the car has, it is out of reach",
        )
        .slip(corner, cosine, Above(0.1), Near(0.0, 1e-15));
    let off = assumptions::error_of_any_p(setup);
    section
        .claim(
            ("point-anywhere", Scope::AnyCar, "m/s"),
            "P may be at any distance p but zero",
            "\"can be arbitrarily selected, excluding the case p = 0\": velocity of P as wanted",
            "equation 7 makes P an integrator for every p from 0.01 to 5 m; whether the motion \
             is stable is another question",
        )
        .number("off by", off, Near(0.0, 1e-9));
    let [whole, half, quarter] = [1.0, 0.5, 0.25].map(|part| wheel_from_path(setup, part));
    let nearer_than = |value: Option<f64>| Below(value.unwrap_or(f64::NAN));
    section
        .claim(
            ("point-near-wheel", Scope::PaperCar, "m"),
            "The closer P is to the front wheel, the better it describes the motion",
            "\"the closer point P is to the front wheel contact point, the more accurately it \
             describes the motion of the vehicle\": the wheel stays nearer to the path of P",
            "the steps without position control: how far the wheel is from the path at most, with \
             p = 0.35, 0.175 and 0.0875 m",
        )
        .number("p/4", quarter, nearer_than(half))
        .number("p/2", half, nearer_than(whole))
        .number("p", whole, Above(0.0));
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

fn plates(setup: &Setup, names: &[String; 2], drives: &Drives, section: &mut Section) {
    section.plate(
        "Uncertainty of the centre of mass",
        "A drawing of the true and the estimated centre of mass.",
        "The same, of this car, to scale, and the point that the law steers then.",
        vec![pictures::uncertainty(setup)],
    );
    let right = |plant| drives.get("right", plant);
    let told = |case, plant, value: fn(&Run) -> f64, unit| {
        section::told(drives.get(case, plant).map(value), unit)
    };
    if let Some(run) = right("ideal").or(right("car")) {
        let fastest = largest(run.rows.iter().map(|row| row.v_px.hypot(row.v_py)));
        section.plate(
            "Commanded velocity of P",
            "The two components of the velocity, steps that both tests share.",
            format!(
                "Six steps, of up to {} m/s, that both tests and both plants share.",
                with_digits(fastest, 2)
            ),
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
        format!(
            "Every turn of v<sub>P</sub> is a peak that decays as the car turns into the new \
             direction: up to {} on the ideal plant and {} on the car; with the wrong \
             l<sub>f</sub> {} and {}, and slower to decay.",
            told("right", "ideal", Run::steepest, "rad"),
            told("right", "car", Run::steepest, "rad"),
            told("rear", "ideal", Run::steepest, "rad"),
            told("rear", "car", Run::steepest, "rad")
        ),
        pictures_of("steering", names, drives, Run::steering),
    );
    section.plate(
        "Reference and actual speed",
        "The reference speed from the law (grey) and the car's (black), which follows it.",
        format!(
            "The ideal plant has the speed at once; the car follows {}. The dips are the turns, in \
             which P moves mostly by steering.",
            speed_lag(right("car"))
        ),
        pictures_of("speed", names, drives, Run::speed),
    );
    section.plate(
        "Trajectory of P",
        "Nominal (grey) and actual (black) path, from the triangle to the circle, very close to \
         each other even with the wrong l<sub>f</sub>.",
        format!(
            "Over a path of {} the true P of the ideal plant is at most {} from nominal with the \
             right l<sub>f</sub> and {} with the wrong one; that of the car {} and {} ({} and {} \
             RMS): it has to start, while the nominal P moves at once.",
            told("right", "ideal", Run::path, "m"),
            told("right", "ideal", Run::largest_deviation, "m"),
            told("rear", "ideal", Run::largest_deviation, "m"),
            told("right", "car", Run::largest_deviation, "m"),
            told("rear", "car", Run::largest_deviation, "m"),
            told("right", "car", Run::rms_deviation, "m"),
            told("rear", "car", Run::rms_deviation, "m")
        ),
        pictures_of("trajectory", names, drives, Run::trajectory),
    );
    section.plate(
        "Position of P over time",
        "Nominal and actual coordinates; where the cameras lose the markers the measured position \
         stays constant though the car moves.",
        format!(
            "The same, with four losses of 200 ms on the car (shaded); they move P by at most {} \
             from where it goes without them.",
            apart(drives, "right", SEEN).map_or_else(|| "(not driven)".to_owned(), mm)
        ),
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
    let (Some(rear), Some(residual)) = (drives.get("rear", "ideal"), residual(setup, drives))
    else {
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
        let name = "car, from dl = 0";
        curves.push(Curve::new(name, Look::Truth, &time, apart));
    }
    section.plate(
        "What a wrong centre of mass costs",
        "No figure: equation 9 says that P's velocity is off by dl r, and the text that the path \
         stays very close to the nominal one.",
        format!(
            "Equation 9 integrates to 2 |dl sin(Δψ/2)|, which the ideal plant meets to {} m: {} \
             when the car has turned by 180°, nothing after a full turn. On the car, {} at most \
             from where P goes with the right l<sub>f</sub>.",
            number(residual),
            section::told(Some(rear.largest_deviation()), "m"),
            section::told(apart(drives, "rear", "right"), "m")
        ),
        vec![Picture::new(
            "steps-deviation",
            "",
            pictures::over_time(
                "Deviation of P with the centre of mass believed at the rear axle",
                "How far the true P is from where two integrators would be.",
                pictures::DEVIATION,
                curves,
            ),
        )],
    );
}
