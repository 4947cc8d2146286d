//! Both laws on the same experiment: the parameters that each needs, and the effect of
//! wrong ones.

use indicatif::ProgressBar;
use nalgebra::{Matrix3, Vector3};
use singletrack_control::{
    Motion, SingleTrack, SingleTrackState, VehicleParameters, Velocity, VelocityPointLaw,
};
use singletrack_core::config::LawKind;
use singletrack_figures::figure::{Axis, Curve, Figure, Look, Panel, Width};

use super::{
    Setup, assumptions,
    drive::{Drives, Experiment, Run},
    pictures,
    section::{Picture, Section},
    setup::largest,
    steps,
    text::{metres, mm, number, with_digits},
};
use crate::table::Table;

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

/// The laws with their names.
const LAWS: [(LawKind, &str, &str); 2] = [
    (LawKind::FrontPoint, "front-point", "proposed law"),
    (LawKind::VelocityPoint, "velocity-point", "appendix's law"),
];

/// A parameter is believed too low or too high.
const FACTORS: [(&str, f64); 2] = [("low", 1.0 - WRONG), ("high", 1.0 + WRONG)];

pub(super) fn section(setup: &Setup, progress: &ProgressBar) -> Section {
    let deviation = DEVIATION_M * setup.scale();
    let mut section = Section::new(7, "The two laws compared");
    section.intro = format!(
        "The open-loop steps of section 2 on the ideal plant under both laws: with everything \
         right, with the centre of mass believed {} behind its place, and with mass and \
         cornering stiffnesses believed {} % wrong. The simulated car is not driven under the \
         appendix's law: its pilot has only the proposed one.",
        mm(deviation),
        number(WRONG * 100.0)
    );
    let mut drives = Drives::default();
    let mut drive = |case: &str, (law, kind, name): (_, _, &str), deviation, believed| {
        let name = format!("{name}, dl = {}", mm(deviation));
        progress.set_message(format!("comparison, {name}"));
        let experiment = Experiment {
            believed,
            ..steps::experiment(setup, law, deviation)
        };
        let run = section.keep(&name, experiment.ideal(setup));
        drives.add(case, kind, run);
    };
    for (case, deviation) in [("right", 0.0), ("deviation", deviation)] {
        for law in LAWS {
            drive(case, law, deviation, None);
        }
    }
    let [_, appendix] = LAWS;
    for (_, parameter) in PARAMETERS {
        for (sign, factor) in FACTORS {
            let believed = scaled(setup.vehicle, parameter, factor);
            drive(
                &format!("{parameter}-{sign}"),
                appendix,
                0.0,
                Some(believed),
            );
        }
    }
    let mut worst = Vec::new();
    for (case, law, run) in drives.iter() {
        let largest = run.largest_deviation();
        let name = format!("compare.largest.{case}.{law}");
        section.measurements.add(name, largest);
        let name = format!("compare-{case}-{law}");
        section.table(name, run.table());
        if !["right", "deviation"].contains(&case) {
            worst.push(largest);
        }
    }
    // A case without a result may have been the worst.
    if worst.len() == FACTORS.len() * PARAMETERS.len() {
        let name = "compare.largest.parameters.velocity-point";
        section.measurements.add(name, largest(worst.into_iter()));
    }
    // The proposed law uses none of them: only the car can differ.
    let mut front = 0.0_f64;
    for (_, parameter) in PARAMETERS {
        for (_, factor) in FACTORS {
            let other = Setup {
                vehicle: scaled(setup.vehicle, parameter, factor),
                ..setup.clone()
            };
            let experiment = steps::experiment(setup, LawKind::FrontPoint, 0.0);
            if let Some(run) = section.keep("proposed law, another car", experiment.ideal(&other)) {
                front = front.max(run.largest_deviation());
            }
        }
    }
    let name = "compare.largest.parameters.front-point";
    section.measurements.add(name, front);
    standstill(setup, &mut section);
    stiffnesses(setup, &mut section);
    draw(setup, &drives, &mut section);
    section
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
    let front = assumptions::law(setup, 0.0, p)
        .is_some_and(|law| law.command(&motion, 0.0, &velocity).is_ok());
    let velocity_point = VelocityPointLaw::new(setup.vehicle, p)
        .is_ok_and(|law| law.command(&motion, &velocity).is_ok());
    for (name, answers) in [("front-point", front), ("velocity-point", velocity_point)] {
        let name = format!("compare.standstill.{name}");
        let answers = f64::from(u8::from(answers));
        section.measurements.add(name, answers);
    }
}

/// Speeds at which the stability under wrong stiffnesses is checked, for the paper's
/// car, in m/s.
const SPEEDS: [f64; 9] = [0.1, 0.2, 0.5, 1.0, 1.5, 2.0, 3.0, 5.0, 8.0];

/// At how many of the speeds, and of the combinations of wrong stiffnesses, the steady
/// motion under the appendix's law is unstable.
fn stiffnesses(setup: &Setup, section: &mut Section) {
    let factors = [1.0 - WRONG, 1.0, 1.0 + WRONG];
    let mut rows = Vec::new();
    let mut unstable = 0_u32;
    for speed in SPEEDS.map(|speed| speed * setup.scale()) {
        for front in factors {
            for rear in factors {
                let believed = scaled(setup.vehicle, "front", front);
                let believed = scaled(believed, "rear", rear);
                let stable = is_stable(setup, believed, speed);
                unstable += u32::from(!stable);
                rows.push(vec![speed, front, rear, f64::from(u8::from(stable))]);
            }
        }
    }
    let combinations = SPEEDS.len() * factors.len() * factors.len();
    let measurements = &mut section.measurements;
    measurements.add("compare.stiffnesses.unstable", f64::from(unstable));
    measurements.add("compare.stiffnesses.combinations", combinations as f64);
    let header = "speed_m_s,front_stiffness_factor,rear_stiffness_factor,is_stable".to_owned();
    let table = Table { header, rows };
    section.table("compare-stiffnesses", table);
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
        let offset = Vector3::ith(axis, STEP);
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

fn draw(setup: &Setup, drives: &Drives, section: &mut Section) {
    let deviation = DEVIATION_M * setup.scale();
    let wrong = format!("dl = {}", metres(deviation));
    // A picture for each law.
    let pictures = |file: &str, case: &str, name: &str, draw: fn(&Run) -> Figure| {
        let mut pictures = Vec::new();
        for (_, law, title) in LAWS {
            pictures.extend(drives.get(case, law).map(|run| {
                let label = format!("{title}, {name}");
                Picture::new(format!("compare-{file}-{law}"), label, draw(run))
            }));
        }
        pictures
    };
    let mut steps = pictures("right", "right", "dl = 0", Run::trajectory);
    steps.extend(pictures("deviation", "deviation", &wrong, Run::trajectory));
    let ended = drives.get("deviation", "velocity-point");
    let ended = ended.and_then(|run| run.ended.as_ref());
    section.plate(
        "The steps under both laws",
        "No experiment: the appendix compares the laws by their equations and by their stability, \
         and calls its own unsuitable in real cases.",
        "With everything right both follow their nominal paths \
         ({compare.largest.right.front-point m} and {compare.largest.right.velocity-point m} off \
         at most). With the centre of mass {dl} wrong the proposed law is \
         {compare.largest.deviation.front-point m} off at most; under the appendix's law P is \
         {compare.largest.deviation.velocity-point m} off at most{ended}.",
        &[
            ("dl", mm(deviation)),
            (
                "ended",
                ended.map_or_else(String::new, |ended| format!(", and {ended}")),
            ),
        ],
        steps,
    );
    let steepest = |law: &str| {
        drives.get("deviation", law).map_or_else(
            || "(not driven)".to_owned(),
            |run| format!("{} rad", with_digits(run.steepest(), 3)),
        )
    };
    section.plate(
        "Steering under both laws",
        "No figure.",
        "At its largest it is {proposed} under the proposed law and {appendix} under the \
         appendix's.",
        &[
            ("proposed", steepest("front-point")),
            ("appendix", steepest("velocity-point")),
        ],
        pictures("steering", "deviation", &wrong, Run::steering),
    );
    parameter_plate(drives, section);
}

/// The deviation of P with wrong parameters, over time.
fn parameter_plate(drives: &Drives, section: &mut Section) {
    let looks = [("too low", Look::Actual), ("too high", Look::Truth)];
    let panels = PARAMETERS.into_iter().filter_map(|(symbol, parameter)| {
        let curves = FACTORS.into_iter().zip(looks);
        let curves: Vec<Curve> = curves
            .filter_map(|((sign, _), (name, look))| {
                let run = drives.get(&format!("{parameter}-{sign}"), "velocity-point")?;
                let time = run.column(|row| row.t);
                Some(Curve::new(name, look, &time, run.deviations().collect()))
            })
            .collect();
        (!curves.is_empty()).then(|| Panel {
            title: symbol.to_owned(),
            curves,
            ..Panel::new(Axis::TIME, pictures::DEVIATION)
        })
    });
    let figure = Figure {
        title: "Deviation of P under the appendix's law with a wrong parameter".to_owned(),
        caption: "How far P is from where two integrators would be.".to_owned(),
        width: Width::Page,
        panels: panels.collect(),
    };
    let unstable = section.measurements.get("compare.stiffnesses.unstable");
    let unstable = match unstable.unwrap_or(0.0) {
        0.0 => "none is".to_owned(),
        count => format!("{} are", number(count)),
    };
    let combinations = section.measurements.get("compare.stiffnesses.combinations");
    section.plate(
        "What a wrong parameter does under the appendix's law",
        "No figure: the text says that the law needs mass and cornering stiffnesses, and that its \
         stability is robust to wrong stiffnesses.",
        "With one of them {percent} % wrong P is up to \
         {compare.largest.parameters.velocity-point m} off; the proposed law, which is not told \
         them, stays within {compare.largest.parameters.front-point m} on cars whose m, \
         C<sub>f</sub> or C<sub>r</sub> is as much different. Of {combinations} combinations of \
         speed and wrong stiffnesses {unstable} unstable.",
        &[
            ("percent", number(WRONG * 100.0)),
            ("combinations", number(combinations.unwrap_or(0.0))),
            ("unstable", unstable),
        ],
        vec![Picture::new("compare-parameters", "", figure)],
    );
}
