//! Both laws on the same experiment: the parameters that each needs, and the effect of
//! wrong ones.

use nalgebra::{Matrix3, Vector3};
use singletrack_control::{
    FrontPointLaw, Motion, SingleTrack, SingleTrackState, VehicleParameters, Velocity,
    VelocityPointLaw,
};
use singletrack_core::config::LawKind;
use singletrack_figures::figure::{Axis, Curve, Figure, Look, Panel, Symbol, Width};

use super::{
    Setup,
    drive::Run,
    extreme::largest,
    progress::Progress,
    section::{Picture, Plate, Section, Table, or_note},
    steps,
    text::{metres, mm, number, with_digits},
};

/// The deviation dl of the laws' centre of mass to the rear, for the paper's car, in m.
pub(super) const DEVIATION_M: f64 = 0.01;
/// Relative error of the wrong masses and stiffnesses.
pub(super) const WRONG: f64 = 0.2;

/// Mass and stiffnesses: the symbol in a figure, and the name.
const PARAMETERS: [(&str, &str); 3] = [("$m$", "mass"), ("$C_f$", "front"), ("$C_r$", "rear")];

fn scaled(vehicle: VehicleParameters, parameter: &str, factor: f64) -> VehicleParameters {
    let mut scaled = vehicle;
    match parameter {
        "mass" => scaled.mass_kg *= factor,
        "front" => scaled.front_cornering_stiffness_n_rad *= factor,
        _ => scaled.rear_cornering_stiffness_n_rad *= factor,
    }
    scaled
}

pub(super) fn section(setup: &Setup, progress: &Progress) -> Section {
    let mut section = Section {
        number: 7,
        title: "The two laws compared",
        ..Section::default()
    };
    let deviation = DEVIATION_M * setup.scale();
    section.intro.push(format!(
        "The open-loop steps of section 2 on the ideal plant under both laws: with everything \
         right, with the centre of mass believed {} behind its place, and with mass and \
         cornering stiffnesses believed {} % wrong. The simulated car is not driven under the \
         appendix's law: its pilot has only the proposed one.",
        mm(deviation),
        number(WRONG * 100.0)
    ));
    let drive = |section: &mut Section, law, deviation, believed| {
        let name = match law {
            LawKind::FrontPoint => "proposed law",
            LawKind::VelocityPoint => "appendix's law",
        };
        let name = format!("{name}, dl = {}", mm(deviation));
        progress.doing(&format!("comparison, {name}"));
        let experiment = super::drive::Experiment {
            believed,
            ..steps::experiment(setup, law, deviation)
        };
        section.keep(&name, experiment.ideal(setup))
    };
    let both = [LawKind::FrontPoint, LawKind::VelocityPoint];
    let right = both.map(|law| drive(&mut section, law, 0.0, None));
    let wrong = both.map(|law| drive(&mut section, law, deviation, None));
    for (which, runs) in [("right", &right), ("deviation", &wrong)] {
        for (law, run) in ["front-point", "velocity-point"].into_iter().zip(runs) {
            let Some(run) = run else { continue };
            let name = |what: &str| format!("compare.{what}.{which}.{law}");
            section
                .measurements
                .add(name("largest"), run.largest_deviation());
            section.measurements.add(name("lasts"), lasts(run));
            section
                .tables
                .push(Table::of_rows(format!("compare-{which}-{law}"), &run.rows));
        }
    }
    let mut believing = Vec::new();
    for (_, parameter) in PARAMETERS {
        for (is_low, factor) in [(true, 1.0 - WRONG), (false, 1.0 + WRONG)] {
            let believed = scaled(setup.vehicle, parameter, factor);
            let run = drive(&mut section, LawKind::VelocityPoint, 0.0, Some(believed));
            if let Some(run) = run {
                let sign = if is_low { "low" } else { "high" };
                section.measurements.add(
                    format!("compare.largest.{parameter}-{sign}.velocity-point"),
                    run.largest_deviation(),
                );
                let name = format!("compare-{parameter}-{sign}-velocity-point");
                section.tables.push(Table::of_rows(name, &run.rows));
                believing.push(Believing {
                    parameter,
                    is_low,
                    run,
                });
            }
        }
    }
    // A case without a result may have been the worst.
    if believing.len() == 2 * PARAMETERS.len() {
        let deviations = believing.iter().map(|one| one.run.largest_deviation());
        section.measurements.add(
            "compare.largest.parameters.velocity-point",
            largest(deviations),
        );
    }
    // The proposed law uses none of them: only the car can differ.
    let own = PARAMETERS.iter().flat_map(|(_, parameter)| {
        [1.0 - WRONG, 1.0 + WRONG].map(|factor| scaled(setup.vehicle, parameter, factor))
    });
    let mut front = 0.0_f64;
    for vehicle in own {
        let other = Setup {
            vehicle,
            ..setup.clone()
        };
        let experiment = steps::experiment(setup, LawKind::FrontPoint, 0.0);
        if let Some(run) = section.keep("proposed law, another car", experiment.ideal(&other)) {
            front = front.max(run.largest_deviation());
        }
    }
    section
        .measurements
        .add("compare.largest.parameters.front-point", front);
    standstill(setup, &mut section);
    stiffnesses(setup, &mut section);
    draw(setup, &right, &wrong, &believing, &mut section);
    section
}

/// A drive under the appendix's law with the parameters of another car.
struct Believing {
    parameter: &'static str,
    is_low: bool,
    run: Run,
}

/// How long a drive lasted, in s.
fn lasts(run: &Run) -> f64 {
    run.rows.last().map_or(0.0, |row| row.t)
}

/// Whether each law has a solution for a car at standstill that is to stay there: 1 or 0.
fn standstill(setup: &Setup, section: &mut Section) {
    let p = setup.point_distance_m();
    let velocity = Velocity::zeros();
    let motion = Motion {
        yaw: 0.0,
        yaw_rate: 0.0,
        sideslip: 0.0,
    };
    let vehicle = setup.vehicle;
    let front = FrontPointLaw::new(vehicle.front_axle_distance_m, p, vehicle.wheelbase_m())
        .is_ok_and(|law| law.command(&motion, 0.0, &velocity).is_ok());
    let velocity_point =
        VelocityPointLaw::new(vehicle, p).is_ok_and(|law| law.command(&motion, &velocity).is_ok());
    for (name, answers) in [("front-point", front), ("velocity-point", velocity_point)] {
        section.measurements.add(
            format!("compare.standstill.{name}"),
            f64::from(u8::from(answers)),
        );
    }
}

/// Speeds at which the stability under wrong stiffnesses is checked, for the paper's
/// car, in m/s.
const SPEEDS: [f64; 9] = [0.1, 0.2, 0.5, 1.0, 1.5, 2.0, 3.0, 5.0, 8.0];

/// At how many of the speeds, and of the combinations of wrong stiffnesses, the steady
/// motion under the appendix's law is unstable.
fn stiffnesses(setup: &Setup, section: &mut Section) {
    let factors = [1.0 - WRONG, 1.0, 1.0 + WRONG];
    let mut table = Table {
        name: "compare-stiffnesses".to_owned(),
        header: "speed_m_s,front_stiffness_factor,rear_stiffness_factor,is_stable".to_owned(),
        rows: Vec::new(),
    };
    let mut unstable = 0_u32;
    for speed in SPEEDS.map(|speed| speed * setup.scale()) {
        for front in factors {
            for rear in factors {
                let believed = scaled(setup.vehicle, "front", front);
                let believed = scaled(believed, "rear", rear);
                let stable = is_stable(setup, believed, speed);
                unstable += u32::from(!stable);
                table
                    .rows
                    .push(vec![speed, front, rear, f64::from(u8::from(stable))]);
            }
        }
    }
    let combinations = SPEEDS.len() * factors.len() * factors.len();
    let measurements = &mut section.measurements;
    measurements.add("compare.stiffnesses.unstable", f64::from(unstable));
    measurements.add("compare.stiffnesses.combinations", combinations as f64);
    section.tables.push(table);
}

/// Whether the steady motion at a speed is stable under the appendix's law with the
/// parameters of another car, by Hurwitz' criterion on a Jacobian by central differences.
fn is_stable(setup: &Setup, believed: VehicleParameters, speed: f64) -> bool {
    let model = SingleTrack::new(setup.vehicle);
    let Ok(law) = VelocityPointLaw::new(believed, setup.point_distance_m()) else {
        return false;
    };
    let slope = |state: Vector3<f64>| {
        let motion = Motion {
            yaw: state.x,
            yaw_rate: state.y,
            sideslip: state.z,
        };
        let command = law.command(&motion, &Velocity::new(speed, 0.0)).ok()?;
        let state = SingleTrackState {
            yaw: state.x,
            yaw_rate: state.y,
            sideslip: state.z,
            ..SingleTrackState::default()
        };
        let slope = model.derivative(&state, command.speed, command.steering);
        Some(Vector3::new(slope.yaw, slope.yaw_rate, slope.sideslip))
    };
    const STEP: f64 = 1e-6;
    let column = |axis: usize| {
        let mut offset = Vector3::zeros();
        if let Some(value) = offset.get_mut(axis) {
            *value = STEP;
        }
        Some((slope(offset)? - slope(-offset)?) / (2.0 * STEP))
    };
    let (Some(first), Some(second), Some(third)) = (column(0), column(1), column(2)) else {
        return false;
    };
    let jacobian = Matrix3::from_columns(&[first, second, third]);
    // s³ + a₂ s² + a₁ s + a₀.
    let a2 = -jacobian.trace();
    let a1 = 0.5 * (jacobian.trace().powi(2) - (jacobian * jacobian).trace());
    let a0 = -jacobian.determinant();
    a2 > 0.0 && a0 > 0.0 && a2 * a1 > a0
}

fn draw(
    setup: &Setup,
    right: &[Option<Run>; 2],
    wrong: &[Option<Run>; 2],
    believing: &[Believing],
    section: &mut Section,
) {
    let measured = section.measurements.clone();
    let get = |name: &str, unit: &str| or_note(measured.get(name), unit);
    let deviation = DEVIATION_M * setup.scale();
    let mut pictures = Vec::new();
    for (which, name, runs) in [
        ("right", "dl = 0".to_owned(), right),
        ("deviation", format!("dl = {}", metres(deviation)), wrong),
    ] {
        let laws = [
            ("front-point", "proposed law"),
            ("velocity-point", "appendix's law"),
        ];
        for ((law, title), run) in laws.into_iter().zip(runs) {
            if let Some(run) = run {
                pictures.push(Picture::new(
                    format!("compare-{which}-{law}"),
                    format!("{title}, {name}"),
                    run.trajectory(),
                ));
            }
        }
    }
    section.plates.push(Plate {
        title: "The steps under both laws".to_owned(),
        paper: "No experiment: the appendix compares the laws by their equations and by their \
                stability, and calls its own unsuitable in real cases."
            .to_owned(),
        ours: format!(
            "With everything right both follow their nominal paths ({} and {} off at most). With \
             the centre of mass {} wrong the proposed law is {} off at most; under the appendix's \
             law P is {} off at most{}.",
            get("compare.largest.right.front-point", "m"),
            get("compare.largest.right.velocity-point", "m"),
            mm(deviation),
            get("compare.largest.deviation.front-point", "m"),
            get("compare.largest.deviation.velocity-point", "m"),
            ended(wrong.get(1).and_then(Option::as_ref)),
        ),
        pictures,
    });
    let steering: Vec<Picture> = [
        ("front-point", "proposed law", wrong.first()),
        ("velocity-point", "appendix's law", wrong.get(1)),
    ]
    .into_iter()
    .filter_map(|(law, title, run)| {
        let run = run?.as_ref()?;
        let name = format!("compare-steering-{law}");
        let label = format!("{title}, dl = {}", metres(deviation));
        Some(Picture::new(name, label, run.steering()))
    })
    .collect();
    let steepest = |law: usize| {
        let run = wrong.get(law).and_then(Option::as_ref);
        run.map_or_else(
            || "(not driven)".to_owned(),
            |run| {
                let angles = run.rows.iter().map(|row| row.steering.abs());
                format!("{} rad", with_digits(largest(angles), 3))
            },
        )
    };
    section.plates.push(Plate {
        title: "Steering under both laws".to_owned(),
        paper: "No figure.".to_owned(),
        ours: format!(
            "At its largest it is {} under the proposed law and {} under the appendix's.",
            steepest(0),
            steepest(1),
        ),
        pictures: steering,
    });
    parameter_plate(believing, section);
}

/// Why a drive ended early, in words.
fn ended(run: Option<&Run>) -> String {
    match run {
        Some(Run {
            ended: Some(ended), ..
        }) => format!(", and {ended}"),
        _ => String::new(),
    }
}

/// The deviation of P with wrong parameters, over time.
fn parameter_plate(believing: &[Believing], section: &mut Section) {
    let measured = section.measurements.clone();
    let panels = PARAMETERS
        .iter()
        .filter_map(|(symbol, parameter)| {
            let curves: Vec<_> = believing
                .iter()
                .filter(|believing| believing.parameter == *parameter)
                .map(|believing| {
                    let (name, look) = if believing.is_low {
                        ("too low", Look::Actual)
                    } else {
                        ("too high", Look::Truth)
                    };
                    let run = &believing.run;
                    let time = run.column(|row| row.t);
                    Curve::new(name, look, &time, run.deviations().collect())
                })
                .collect();
            let y = Axis {
                include: Some(0.0),
                ..Axis::new("deviation of P", Some(Symbol::new("e", "P")), "m")
            };
            (!curves.is_empty()).then(|| Panel {
                title: (*symbol).to_owned(),
                curves,
                ..Panel::new(Axis::TIME, y)
            })
        })
        .collect();
    let figure = Figure {
        title: "Deviation of P under the appendix's law with a wrong parameter".to_owned(),
        caption: "How far P is from where two integrators would be.".to_owned(),
        width: Width::Page,
        panels,
    };
    let pictures = vec![Picture::new("compare-parameters", "", figure)];
    let get = |name: &str, unit: &str| or_note(measured.get(name), unit);
    let unstable = measured.get("compare.stiffnesses.unstable").unwrap_or(0.0);
    section.plates.push(Plate {
        title: "What a wrong parameter does under the appendix's law".to_owned(),
        paper: "No figure: the text says that the law needs mass and cornering stiffnesses, \
                and that its stability is robust to wrong stiffnesses."
            .to_owned(),
        ours: format!(
            "With one of them {} % wrong P is up to {} off; the proposed law, which is not told \
             them, stays within {} on cars whose m, C<sub>f</sub> or C<sub>r</sub> is as much \
             different. Of {} combinations of speed and wrong stiffnesses {} {} unstable.",
            number(WRONG * 100.0),
            get("compare.largest.parameters.velocity-point", "m"),
            get("compare.largest.parameters.front-point", "m"),
            get("compare.stiffnesses.combinations", "").trim(),
            match unstable {
                0.0 => "none".to_owned(),
                count => number(count),
            },
            if unstable == 0.0 { "is" } else { "are" },
        ),
        pictures,
    });
}
