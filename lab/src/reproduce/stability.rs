//! The bifurcation studies of both laws and their eigenvalue maps.

use indicatif::ProgressBar;
use singletrack_analysis::stability::{
    Belief, ClosedLoop, HopfPoint, Law, critical_speed, infinite_speed_limit,
    smallest_point_distance,
};
use singletrack_control::VehicleParameters;
use singletrack_figures::figure::{Axis, Column, Curve, Figure, Look, Panel, Symbol};

use super::{
    Setup, assumptions,
    claims::{above, below, near},
    largest, least,
    section::{Picture, Section},
    text::{metres, mm, number, told, with_digits},
};
use crate::stability::{
    EigenvalueRow, Grid, Subject, eigenvalue_map, eigenvalue_table,
    figures::{self, Scene},
    hopf_curve, hopf_table, region,
};

/// The speeds of the study, for the paper's car, in m/s. The paper does not state its
/// own.
const SPEEDS: [f64; 2] = [0.1, 8.0];

/// A car, its P and a law, as in the paper's analyses.
pub(super) fn subject(setup: &Setup, law: Law) -> Subject {
    Subject {
        vehicle: setup.vehicle,
        law,
        belief: Belief::CentreOfMass,
        point_distance: setup.point_distance_m(),
    }
}

fn speeds(setup: &Setup, count: usize) -> Grid {
    Grid::spanning(SPEEDS.map(|speed| speed * setup.scale()), count)
}

/// Speeds and deviations of the maps, as those of the paper's figures.
fn map_grids(setup: &Setup, subject: &Subject) -> [Grid; 2] {
    let (columns, rows) = if setup.quick { (20, 31) } else { (80, 121) };
    let deviations = match subject.usual_deviations().values() {
        [from, .., to] => Grid::spanning([*from, *to], rows),
        other => Grid::spanning([other.first().copied().unwrap_or(0.0); 2], 1),
    };
    [speeds(setup, columns), deviations]
}

/// All Hopf points over the speeds.
fn curve(setup: &Setup, law: Law, section: &mut Section) -> Vec<HopfPoint> {
    let speeds = speeds(setup, if setup.quick { 40 } else { 159 });
    section
        .or_note("Hopf points", hopf_curve(&subject(setup, law), &speeds))
        .unwrap_or_default()
}

/// The curves in every map of a car under a law.
fn scene(subject: &Subject, setup: &Setup, section: &mut Section) -> Option<Scene> {
    let hopf = curve(setup, subject.law, section);
    section.or_note("Hopf points", Scene::new(subject, &hopf))
}

/// The picture of a figure.
fn picture<E: std::fmt::Display>(
    section: &mut Section,
    name: &str,
    figure: Result<Figure, E>,
) -> Vec<Picture> {
    section
        .or_note(name, figure)
        .map(|figure| Picture::new(name, "", figure))
        .into_iter()
        .collect()
}

/// The Hopf points at which stability ends, over the speeds.
fn ends(setup: &Setup, law: Law, section: &mut Section) -> Vec<HopfPoint> {
    let mut curve = curve(setup, law, section);
    curve.retain(HopfPoint::ends_stability);
    curve
}

/// The paper's figure of stable and unstable regions, and the coefficients along their boundary.
fn region_plate(setup: &Setup, law: Law, curve: &[HopfPoint], section: &mut Section) {
    section.fact("lyapunov", lyapunov(curve));
    section.table(format!("hopf-{law}"), hopf_table(curve));
    let subject = subject(setup, law);
    let [speeds, deviations] = map_grids(setup, &subject);
    let rows = section.or_note("region", region(&subject, &speeds, &deviations));
    let scene = scene(&subject, setup, section);
    let mut pictures = match (scene, rows) {
        (Some(scene), Some(rows)) => {
            let name = format!("region-{law}");
            picture(section, &name, figures::region(&scene, &rows))
        }
        _ => Vec::new(),
    };
    pictures.push(lyapunov_picture(&format!("lyapunov-{law}"), curve));
    section.plate("region", pictures);
}

/// The first Lyapunov coefficient, in Kuznetsov's normalisation.
const fn l1(point: &HopfPoint) -> f64 {
    point.lyapunov.kuznetsov
}

/// The first Lyapunov coefficient of every bifurcation point of a curve.
fn lyapunov_picture(name: &str, curve: &[HopfPoint]) -> Picture {
    let speed: Column = curve.iter().map(|point| point.speed).collect();
    let coefficient = curve.iter().map(|point| point.lyapunov.matcont).collect();
    let symbol = Some(Symbol::new("l", "1"));
    let y = Axis::new("first Lyapunov coefficient", symbol, "").logarithmic();
    let figure = Figure::column(
        "First Lyapunov coefficient of all bifurcation points",
        "Along the curve of Hopf points, as MatCont counts it; above zero they are \
         subcritical.",
        vec![Panel {
            curves: vec![Curve::new("Hopf points", Look::Actual, &speed, coefficient)],
            ..Panel::new(Axis::new("speed", Some(Symbol::new("v", "")), "m/s"), y)
        }],
    );
    Picture::new(name, "l₁ of all bifurcation points", figure)
}

/// The first Lyapunov coefficients along a curve, in a sentence.
fn lyapunov(curve: &[HopfPoint]) -> String {
    let range = |value: fn(&HopfPoint) -> f64| {
        let values = || curve.iter().map(value);
        format!(
            "between {} and {}",
            with_digits(least(values()), 3),
            with_digits(largest(values()), 3)
        )
    };
    let subcritical = curve.iter().all(|point| l1(point) > 0.0);
    format!(
        "The first Lyapunov coefficient is {} as MatCont counts it and as it is drawn ({} in \
         Kuznetsov's normalisation): {} of these bifurcations are subcritical.",
        range(|point| point.lyapunov.matcont),
        range(l1),
        if subcritical { "all" } else { "not all" }
    )
}

/// The bifurcation study of the proposed law.
pub(super) fn proposed(setup: &Setup, section: &mut Section, progress: &ProgressBar) {
    progress.set_message("bifurcations of the proposed law");
    let [ahead, behind] = ClosedLoop::meaningful_deviations(&setup.vehicle);
    let curve = ends(setup, Law::FrontPoint, section);
    let limit = infinite_speed_limit(setup.vehicle, setup.point_distance_m())
        .map_or(f64::NAN, |limits| largest(limits.into_iter()));
    let subject = subject(setup, Law::FrontPoint);
    // Dense in the range that matters, and far beyond the speeds of any car.
    let unstable = Grid::spanning([ahead, behind], 201)
        .values()
        .iter()
        .flat_map(|deviation| {
            [0.01, 0.1, 0.5, 1.0, 2.0, 5.0, 10.0, 50.0, 1000.0]
                .map(|speed| subject.at(speed * setup.scale(), *deviation))
        })
        .filter(|closed_loop| !closed_loop.as_ref().is_ok_and(ClosedLoop::is_stable))
        .count();
    let critical = critical_speed(setup.vehicle, setup.point_distance_m(), [ahead, behind]);
    let stable = match critical {
        Ok(None) => format!(
            "below −l<sub>f</sub> = {}, and tends to {} m as the speed grows without bounds, which \
             leaves a margin of {}",
            metres(ahead),
            with_digits(limit, 6),
            mm(ahead - limit)
        ),
        Ok(Some(speed)) => format!(
            "and enters the meaningful range (−l<sub>f</sub> = {}) at {} m/s: this car is not stable \
             all over it",
            metres(ahead),
            number(speed)
        ),
        Err(error) => error.to_string(),
    };
    let deviations = || curve.iter().map(|point| point.deviation);
    let highest = largest(deviations());
    section.facts([
        ("−l_f", metres(ahead)),
        ("l_r", metres(behind)),
        ("least dl", number(ahead)),
        ("margin", mm(ahead - limit)),
        ("slowest", number(SPEEDS[0] * setup.scale())),
        ("fastest", number(SPEEDS[1] * setup.scale())),
        ("lowest", metres(least(deviations()))),
        ("highest", metres(highest)),
        ("stable", stable),
    ]);
    let inside = assumptions::with_position_loop(setup, [ahead, behind]).map(|counts| counts[0]);
    let beyond = [5.0 * ahead, ahead];
    let outside = assumptions::with_position_loop(setup, beyond).map(|counts| counts[2]);
    let smallest = smallest_point_distance(setup.vehicle, [ahead, behind]);
    let smallest = smallest.ok().flatten();
    section
        .claim("hopf-negative")
        .number("largest", highest, below(0.0));
    section
        .claim("hopf-outside")
        .number("largest", highest, below(ahead))
        .number("v → ∞", limit, below(ahead));
    section
        .claim("hopf-subcritical")
        .number("least l₁", least(curve.iter().map(l1)), above(0.0));
    section
        .claim("structurally-stable")
        .number("unstable points", unstable as f64, near(0.0, 0.0));
    section
        .claim("necessary-and-sufficient")
        .number("unstable of 147", inside, near(0.0, 0.0))
        .number("stable of 47", outside, near(0.0, 0.0));
    let turned = assumptions::direction_matters(setup);
    section
        .claim("direction")
        .number("differ by", turned, near(0.0, 1e-9));
    section
        .claim("point-stability")
        .number("p for every speed", smallest, near(0.35, 0.01));
    region_plate(setup, Law::FrontPoint, &curve, section);
}

/// The largest real part of an eigenvalue at the deviations within a range.
fn largest_within(map: &[EigenvalueRow], index: usize, [from, to]: [f64; 2]) -> f64 {
    largest(
        map.iter()
            .filter(|row| (from..=to).contains(&row.deviation))
            .filter_map(|row| row.eigenvalues.get(index).map(|value| value.re)),
    )
}

/// The map of the eigenvalues under a law; the largest real part of each within the meaningful range.
fn eigenvalues_under(setup: &Setup, law: Law, section: &mut Section) -> Option<Vec<f64>> {
    let range = ClosedLoop::meaningful_deviations(&setup.vehicle);
    let subject = subject(setup, law);
    let [speeds, deviations] = map_grids(setup, &subject);
    let map = eigenvalue_map(&subject, &speeds, &deviations);
    let map = section.or_note("eigenvalues", map)?;
    let count = map.first().map_or(0, |row| row.eigenvalues.len());
    let file = format!("eigenvalues-{law}");
    section.table(file.clone(), eigenvalue_table(&map));
    let parts: Vec<f64> = (0..count)
        .map(|index| largest_within(&map, index, range))
        .collect();
    let pictures = match scene(&subject, setup, section) {
        Some(scene) => picture(section, &file, figures::eigenvalues(&scene, &map)),
        None => Vec::new(),
    };
    let crossing = match unstable(&parts) {
        0 => String::new(),
        count => format!(": {count} become positive, having crossed the axis as a pair"),
    };
    let shown: Vec<String> = parts.iter().map(|part| told(Some(*part), "1/s")).collect();
    section.fact(format!("parts {law}"), shown.join(", ") + &crossing);
    section.plate(law.name(), pictures);
    Some(parts)
}

/// The eigenvalue maps of both laws.
pub(super) fn eigenvalues(setup: &Setup, section: &mut Section, progress: &ProgressBar) {
    let [front, velocity] = [Law::FrontPoint, Law::VelocityPoint].map(|law| {
        progress.set_message(format!("eigenvalues under the {law} law"));
        eigenvalues_under(setup, law, section)
    });
    let count = velocity.as_ref().map(|parts| parts.len() as f64);
    let critical = velocity.as_ref().map(|parts| unstable(parts) as f64);
    let claim = section.claim("eigenvalues-negative");
    for (index, label) in ["λ₁ at most", "λ₂ at most", "λ₃ at most", "λ₄ at most"]
        .into_iter()
        .enumerate()
    {
        let part = front.as_ref().and_then(|parts| parts.get(index).copied());
        claim.number(label, part, below(0.0));
    }
    section.claim("eigenvalues-appendix-count").slip(
        "eigenvalues",
        count,
        near(4.0, 0.0),
        near(3.0, 0.0),
    );
    let (one, two) = (near(1.0, 0.0), near(2.0, 0.0));
    section.claim("eigenvalues-appendix-critical").slip(
        "with R ≥ 0 in the range",
        critical,
        one,
        two,
    );
}

/// How many of the largest real parts are not negative.
fn unstable(parts: &[f64]) -> usize {
    parts.iter().filter(|part| **part >= 0.0).count()
}

/// The speed of the appendix's threshold, for the paper's car, in m/s.
const SLOW: f64 = 0.1;

/// The bifurcation study of the appendix's law.
pub(super) fn appendix(setup: &Setup, section: &mut Section, progress: &ProgressBar) {
    progress.set_message("bifurcations of the appendix's law");
    let curve = ends(setup, Law::VelocityPoint, section);
    let [_, behind] = ClosedLoop::meaningful_deviations(&setup.vehicle);
    let threshold = |belief| {
        let subject = Subject {
            belief,
            ..subject(setup, Law::VelocityPoint)
        };
        let points = subject.hopf_points(SLOW * setup.scale());
        points.map_or(f64::NAN, |points| {
            let ends = points.iter().filter(|point| point.ends_stability());
            let deviations = ends.map(|point| point.deviation);
            least(deviations.filter(|deviation| *deviation > 0.0))
        })
    };
    let both = threshold(Belief::CentreOfMass);
    let front = threshold(Belief::FrontAxle);
    // From this speed on the curve is beyond the rear axle.
    let leaves = curve
        .iter()
        .find(|point| point.deviation > behind)
        .map_or(f64::NAN, |point| point.speed);
    let VehicleParameters {
        front_cornering_stiffness_n_rad: c_f,
        rear_cornering_stiffness_n_rad: c_r,
        ..
    } = setup.vehicle;
    // The law uses the distances only in C_r l_r − C_f l_f.
    let stiffness_ratio = (c_f + c_r) / c_f;
    let lowest = least(curve.iter().map(|point| point.deviation));
    section.facts([
        ("ratio", with_digits(stiffness_ratio, 4)),
        ("largest dl", number(behind)),
        ("l_r", metres(behind)),
        ("slow", number(SLOW * setup.scale())),
        ("both", mm(both)),
        ("front", mm(front)),
        ("leaves", with_digits(leaves, 2)),
    ]);
    let papers = near(0.136, 0.0005);
    section
        .claim("appendix-threshold")
        .number("l_f + dl and l_r − dl", both * 1000.0, papers);
    let right = near(0.135_977_266 * stiffness_ratio, 1e-6);
    section.claim("appendix-threshold-front-only").slip(
        "l_f + dl, l_r as it is",
        front * 1000.0,
        papers,
        right,
    );
    section
        .claim("appendix-inside")
        .number("least dl, m", lowest, above(0.0))
        .number("inside up to, m/s", leaves, above(0.1));
    section.claim("appendix-subcritical").number(
        "least l₁",
        least(curve.iter().map(l1)),
        above(0.0),
    );
    region_plate(setup, Law::VelocityPoint, &curve, section);
}
