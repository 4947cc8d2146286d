//! Both laws on the same experiment: the parameters that each needs, and the effect of
//! wrong ones.

use indicatif::ProgressBar;
use nalgebra::{Matrix3, Vector3};
use singletrack_control::{
    Motion, SingleTrack, SingleTrackState, VehicleParameters, Velocity, VelocityPointLaw,
};
use singletrack_core::config::LawKind;
use singletrack_figures::figure::{Axis, Curve, Figure, Look, Panel};
use singletrack_scenario::simulate::Scenario;

use super::{
    Setup, assumptions,
    drive::{Drives, Run, ideal},
    largest, pictures,
    section::{Above, Below, Near, Picture, Scope, Section, metres, mm, number, told, with_digits},
    steps,
};
use crate::Table;

/// The deviation dl of the laws' centre of mass to the rear, for the paper's car, in m.
const DEVIATION_M: f64 = 0.01;
/// Relative error of the wrong masses and stiffnesses.
const WRONG: f64 = 0.2;

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
    let intro = format!(
        "The open-loop steps of section 2 on the ideal plant under both laws: with everything \
         right, with the centre of mass believed {} behind its place, and with mass and \
         cornering stiffnesses believed {} % wrong. The simulated car is not driven under the \
         appendix's law: its pilot has only the proposed one.",
        mm(deviation),
        number(WRONG * 100.0)
    );
    let mut section = Section::new(7, "The two laws compared", intro);
    let mut drives = Drives::default();
    let mut drive = |case: &str, (law, kind, name): (_, _, &str), deviation, believed| {
        let name = format!("{name}, dl = {}", mm(deviation));
        progress.set_message(format!("comparison, {name}"));
        let experiment = Scenario {
            believed_vehicle: believed,
            ..steps::experiment(setup, law, deviation)
        };
        let run = section.keep(&name, ideal(&experiment));
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
            let case = format!("{parameter}-{sign}");
            drive(&case, appendix, 0.0, Some(believed));
        }
    }
    let mut worst = Vec::new();
    for (case, law, run) in drives.iter() {
        section.table(format!("compare-{case}-{law}"), run.table());
        if !["right", "deviation"].contains(&case) {
            worst.push(run.largest_deviation());
        }
    }
    // A case without a result may have been the worst.
    let is_complete = worst.len() == FACTORS.len() * PARAMETERS.len();
    let worst = is_complete.then(|| largest(worst.into_iter()));
    // The proposed law uses none of them: only the car can differ.
    let mut front = 0.0_f64;
    for (_, parameter) in PARAMETERS {
        for (_, factor) in FACTORS {
            let experiment = Scenario {
                vehicle: scaled(setup.vehicle, parameter, factor),
                ..steps::experiment(setup, LawKind::FrontPoint, 0.0)
            };
            if let Some(run) = section.keep("proposed law, another car", ideal(&experiment)) {
                front = front.max(run.largest_deviation());
            }
        }
    }
    let stiffnesses = stiffnesses(setup);
    let off = [Some(front), worst];
    claims(setup, &drives, off, &stiffnesses, &mut section);
    plates(setup, &drives, &mut section);
    parameter_plate(&drives, off, &stiffnesses, &mut section);
    section.table("compare-stiffnesses", stiffnesses);
    section
}

/// The largest deviation of a drive, in m.
fn off(drives: &Drives, case: &str, law: &str) -> Option<f64> {
    drives.get(case, law).map(Run::largest_deviation)
}

/// The claims; `parameters` are the largest deviations with wrong parameters under either law.
fn claims(
    setup: &Setup,
    drives: &Drives,
    parameters: [Option<f64>; 2],
    stiffnesses: &Table,
    section: &mut Section,
) {
    let dl = DEVIATION_M * setup.scale();
    let percent = number(WRONG * 100.0);
    let unstable = unstable(stiffnesses) as f64;
    let under = |case| LAWS.map(|(_, law, _)| off(drives, case, law));
    let [right, wrong] = ["right", "deviation"].map(under);
    let [proposed, appendix] = standstill(setup).map(|answers| f64::from(u8::from(answers)));
    section
        .claim(
            ("compare-standstill", Scope::AnyCar, ""),
            "The appendix's law is singular at standstill, the proposed one is not",
            "\"singular when the vehicle velocity is equal to zero\"; answers (1) or not (0): 1 \
             and 0",
            "v = 0 divides the yaw rate in equation 11; equation 8 has no v below a line",
        )
        .number("proposed", proposed, Near(1.0, 0.0))
        .number("appendix's", appendix, Near(0.0, 0.0));
    section
        .claim(
            ("compare-right", Scope::AnyCar, "m"),
            "With everything right both laws linearise their point exactly",
            "equations 7 and 11: deviation 0",
            "the open-loop steps on the ideal plant",
        )
        .number("proposed", right[0], Near(0.0, 1e-6))
        .number("appendix's", right[1], Near(0.0, 1e-6));
    section
        .claim(
            ("compare-wrong-proposed", Scope::AnyCar, "m"),
            format!("The proposed law takes dl = {}", mm(dl)),
            "robust: at most 2 dl",
            "2 |dl sin(Δψ/2)|",
        )
        .number("proposed", wrong[0], Below(2.000_002 * dl));
    section
        .claim(
            ("compare-wrong-appendix", Scope::PaperCar, "m"),
            format!("The appendix's law does not take dl = {}", mm(dl)),
            "\"unsuitable in real cases\"; taken as off by more than a wheelbase on the same \
             steps",
            "at these speeds the motion is unstable with 10 mm: the steering diverges at the \
             first turn, until the speed is zero and the law has no answer",
        )
        .number("appendix's", wrong[1], Above(setup.vehicle.wheelbase_m()));
    section
        .claim(
            ("compare-parameters", Scope::AnyCar, "m"),
            "The proposed law depends on no parameter but the position of the centre of mass",
            format!(
                "\"does not depend on any model parameter\": deviation 0 on cars with m, C_f \
                     or C_r {percent} % different"
            ),
            "it uses none of them",
        )
        .number("proposed", parameters[0], Near(0.0, 1e-6));
    section
        .claim(
            ("compare-parameters-appendix", Scope::PaperCar, "m"),
            "The appendix's law does depend on them",
            format!(
                "\"requires an estimate of vehicle parameters\": off with m, C_f or C_r \
                     {percent} % wrong; taken as by more than 10 mm"
            ),
            "the worst of the six; the motion stays stable, but P is not where it should be",
        )
        .number("appendix's", parameters[1], Above(0.01));
    section
        .claim(
            ("compare-stiffnesses", Scope::PaperCar, ""),
            "Its stability is robust to wrong cornering stiffnesses",
            format!(
                "\"robust with respect to uncertainties on C_f and C_r\": no unstable case \
                     with ±{percent} %"
            ),
            "nine speeds from 0.1 to 8 m/s, nine combinations, Hurwitz' criterion",
        )
        .number("unstable of 81", unstable, Near(0.0, 0.0));
    let apart = assumptions::measured_point(setup);
    section
        .claim(
            ("parameter-is-a-distance", Scope::AnyCar, "m/s, rad/s"),
            "The law's only parameter is the position of the centre of mass",
            "\"apart from the position of the center of mass\": another point gives other \
             commands",
            "it depends on less: on the distance of the front axle from the point to which pose \
             and sideslip refer. Any point of the axis gives the same commands; the centre of \
             mass need not be known",
        )
        .number("commands differ by", apart, Near(0.0, 1e-9));
}

/// Whether each law has a solution for a car at standstill that is to stay there.
fn standstill(setup: &Setup) -> [bool; 2] {
    let p = setup.point_distance_m();
    let velocity = Velocity::zeros();
    let motion = Motion {
        yaw: 0.0,
        yaw_rate: 0.0,
        sideslip: 0.0,
    };
    [
        assumptions::law(setup, 0.0, p)
            .is_some_and(|law| law.command(&motion, 0.0, &velocity).is_ok()),
        VelocityPointLaw::new(setup.vehicle, p)
            .is_ok_and(|law| law.command(&motion, &velocity).is_ok()),
    ]
}

/// Speeds at which the stability under wrong stiffnesses is checked, for the paper's
/// car, in m/s.
const SPEEDS: [f64; 9] = [0.1, 0.2, 0.5, 1.0, 1.5, 2.0, 3.0, 5.0, 8.0];

/// Whether the steady motion under the appendix's law is stable at each of the speeds, with each
/// combination of wrong stiffnesses.
fn stiffnesses(setup: &Setup) -> Table {
    let factors = [1.0 - WRONG, 1.0, 1.0 + WRONG];
    let mut rows = Vec::new();
    for speed in SPEEDS.map(|speed| speed * setup.scale()) {
        for front in factors {
            for rear in factors {
                let believed = scaled(setup.vehicle, "front", front);
                let believed = scaled(believed, "rear", rear);
                let stable = is_stable(setup, believed, speed) == Some(true);
                rows.push(vec![speed, front, rear, f64::from(u8::from(stable))]);
            }
        }
    }
    let header = "speed_m_s,front_stiffness_factor,rear_stiffness_factor,is_stable".to_owned();
    Table { header, rows }
}

/// How many of these motions are unstable.
fn unstable(stiffnesses: &Table) -> usize {
    let rows = stiffnesses.rows.iter();
    rows.filter(|row| row.last() == Some(&0.0)).count()
}

/// Whether the steady motion at a speed is stable under the appendix's law with the
/// parameters of another car, by Hurwitz' criterion on a Jacobian by central differences; none without
/// an answer of the law.
fn is_stable(setup: &Setup, believed: VehicleParameters, speed: f64) -> Option<bool> {
    let model = SingleTrack::new(setup.vehicle);
    let law = VelocityPointLaw::new(believed, setup.point_distance_m()).ok()?;
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
    let jacobian = Matrix3::from_columns(&[column(0)?, column(1)?, column(2)?]);
    // s³ + a₂ s² + a₁ s + a₀.
    let a2 = -jacobian.trace();
    let a1 = 0.5 * (jacobian.trace().powi(2) - (jacobian * jacobian).trace());
    let a0 = -jacobian.determinant();
    Some(a2 > 0.0 && a0 > 0.0 && a2 * a1 > a0)
}

fn plates(setup: &Setup, drives: &Drives, section: &mut Section) {
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
    section.plate(
        "Position of P for the alternative law",
        "A drawing of the point P of the appendix's law.",
        "The same, of this car, to scale, beside that of the proposed law.",
        vec![pictures::points(setup)],
    );
    let mut steps = pictures("right", "right", "dl = 0", Run::trajectory);
    steps.extend(pictures("deviation", "deviation", &wrong, Run::trajectory));
    let ended = drives.get("deviation", "velocity-point");
    let ended = ended.and_then(|run| run.ended.as_ref());
    section.plate(
        "The steps under both laws",
        "No experiment: the appendix compares the laws by their equations and by their stability, \
         and calls its own unsuitable in real cases.",
        format!(
            "With everything right both follow their nominal paths ({} and {} off at most). With \
             the centre of mass {} wrong the proposed law is {} off at most; under the appendix's \
             law P is {} off at most{}.",
            told(off(drives, "right", "front-point"), "m"),
            told(off(drives, "right", "velocity-point"), "m"),
            mm(deviation),
            told(off(drives, "deviation", "front-point"), "m"),
            told(off(drives, "deviation", "velocity-point"), "m"),
            ended.map_or_else(String::new, |ended| format!(", and {ended}"))
        ),
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
        format!(
            "At its largest it is {} under the proposed law and {} under the appendix's.",
            steepest("front-point"),
            steepest("velocity-point")
        ),
        pictures("steering", "deviation", &wrong, Run::steering),
    );
}

/// The deviation of P with wrong parameters, over time.
fn parameter_plate(
    drives: &Drives,
    [proposed, appendix]: [Option<f64>; 2],
    stiffnesses: &Table,
    section: &mut Section,
) {
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
    let figure = Figure::page(
        "Deviation of P under the appendix's law with a wrong parameter",
        "How far P is from where two integrators would be.",
        panels.collect(),
    );
    section.plate(
        "What a wrong parameter does under the appendix's law",
        "No figure: the text says that the law needs mass and cornering stiffnesses, and that its \
         stability is robust to wrong stiffnesses.",
        format!(
            "With one of them {} % wrong P is up to {} off; the proposed law, which is not told \
             them, stays within {} on cars whose m, C<sub>f</sub> or C<sub>r</sub> is as much \
             different. Of {} combinations of speed and wrong stiffnesses {} unstable.",
            number(WRONG * 100.0),
            told(appendix, "m"),
            told(proposed, "m"),
            stiffnesses.rows.len(),
            match unstable(stiffnesses) {
                0 => "none is".to_owned(),
                count => format!("{count} are"),
            }
        ),
        vec![Picture::new("compare-parameters", "", figure)],
    );
}
