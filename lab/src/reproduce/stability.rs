//! The bifurcation studies of both laws and their eigenvalue maps.

use indicatif::ProgressBar;
use singletrack_analysis::stability::{
    Belief, ClosedLoop, HopfPoint, Law, critical_speed, infinite_speed_limit,
    smallest_point_distance,
};
use singletrack_figures::figure::Figure;

use super::{
    Setup,
    section::{Picture, Section, or_note},
    setup::{largest, least},
    text::{metres, mm, number, with_digits},
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
pub(super) fn scene(subject: &Subject, setup: &Setup, section: &mut Section) -> Option<Scene> {
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

/// The paper's figure of stable and unstable regions.
fn region_picture(setup: &Setup, law: Law, name: &str, section: &mut Section) -> Vec<Picture> {
    let subject = subject(setup, law);
    let [speeds, deviations] = map_grids(setup, &subject);
    let rows = region(&subject, &speeds, &deviations);
    let (Some(scene), Some(rows)) = (
        scene(&subject, setup, section),
        section.or_note("region", rows),
    ) else {
        return Vec::new();
    };
    picture(section, name, figures::region(&scene, &rows))
}

/// The first Lyapunov coefficient, in Kuznetsov's normalisation.
const fn l1(point: &HopfPoint) -> f64 {
    point.lyapunov.kuznetsov
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
pub(super) fn proposed(setup: &Setup, progress: &ProgressBar) -> Section {
    progress.set_message("bifurcations of the proposed law");
    let [ahead, behind] = ClosedLoop::meaningful_deviations(&setup.vehicle);
    let mut section = Section::new(4, "Bifurcations under the proposed law");
    section.intro = format!(
        "The steady motion under the law with a wrong l<sub>f</sub>, over the speed and the \
         deviation dl of the centre of mass, which is physically meaningful from −l<sub>f</sub> = \
         {} to l<sub>r</sub> = {}. Hopf points are found in closed form, their first Lyapunov \
         coefficients by exact derivatives for states in rad and rad/s.",
        metres(ahead),
        metres(behind)
    );
    let mut curve = curve(setup, Law::FrontPoint, &mut section);
    curve.retain(HopfPoint::ends_stability);
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
    let measurements = &mut section.measurements;
    measurements.add("hopf.front.largest_dl", largest(deviations()));
    measurements.add("hopf.front.least_l1", least(curve.iter().map(l1)));
    measurements.add("hopf.front.limit", limit);
    if let Ok(Some(smallest)) = smallest_point_distance(setup.vehicle, [ahead, behind]) {
        measurements.add("point.smallest", smallest);
    }
    measurements.add("hopf.front.unstable_in_range", unstable as f64);
    section.table("hopf-front-point", hopf_table(&curve));
    let pictures = region_picture(setup, Law::FrontPoint, "region-front-point", &mut section);
    section.plate(
        "Stability over speed and deviation",
        "Light and dark regions over speed and dl; the Hopf curve lies at negative dl, outside the \
         physically meaningful range, with values of the first Lyapunov coefficient along it.",
        "Between {slowest} and {fastest} m/s the Hopf curve rises from dl = {least} to {largest}, \
         {stable}. {lyapunov}",
        &[
            ("slowest", number(SPEEDS[0] * setup.scale())),
            ("fastest", number(SPEEDS[1] * setup.scale())),
            ("least", metres(least(deviations()))),
            ("largest", metres(largest(deviations()))),
            ("stable", stable),
            ("lyapunov", lyapunov(&curve)),
        ],
        pictures,
    );
    section
}

/// The largest real part of an eigenvalue at the deviations within a range.
fn largest_within(map: &[EigenvalueRow], index: usize, [from, to]: [f64; 2]) -> f64 {
    largest(
        map.iter()
            .filter(|row| (from..=to).contains(&row.deviation))
            .filter_map(|row| row.eigenvalues.get(index).map(|value| value.re)),
    )
}

/// The eigenvalue maps of both laws.
pub(super) fn eigenvalues(setup: &Setup, progress: &ProgressBar) -> Section {
    let range = ClosedLoop::meaningful_deviations(&setup.vehicle);
    let mut section = Section::new(5, "Eigenvalues under both laws");
    section.intro =
        "The real parts of the eigenvalues of the same steady motions, numbered by ascending real \
         part at every point."
            .to_owned();
    for (law, name, title, paper) in [
        (
            Law::FrontPoint,
            "front",
            "the proposed law",
            "A map for each of four eigenvalues; within the meaningful range all real parts are \
             negative.",
        ),
        (
            Law::VelocityPoint,
            "velocity",
            "the appendix's law",
            "Three maps, of \"the four eigenvalues\"; that of the most critical, λ<sub>3</sub>, has \
             a region where it is not negative.",
        ),
    ] {
        progress.set_message(format!("eigenvalues under {title}"));
        let subject = subject(setup, law);
        let [speeds, deviations] = map_grids(setup, &subject);
        let map = eigenvalue_map(&subject, &speeds, &deviations);
        let Some(map) = section.or_note("eigenvalues", map) else {
            continue;
        };
        let count = map.first().map_or(0, |row| row.eigenvalues.len());
        let file = format!("eigenvalues-{name}-point");
        section.table(file.clone(), eigenvalue_table(&map));
        let measurements = &mut section.measurements;
        measurements.add(format!("eigenvalues.{name}.count"), count as f64);
        let mut unstable = 0;
        let mut told = Vec::new();
        for index in 0..count {
            let largest = largest_within(&map, index, range);
            let name = format!("eigenvalues.{name}.{}", index + 1);
            measurements.add(&name, largest);
            told.push(or_note(measurements.get(&name), "1/s"));
            if largest >= 0.0 {
                unstable += 1;
            }
        }
        measurements.add(format!("eigenvalues.{name}.unstable"), f64::from(unstable));
        let pictures = match scene(&subject, setup, &mut section) {
            Some(scene) => picture(&mut section, &file, figures::eigenvalues(&scene, &map)),
            None => Vec::new(),
        };
        let crossing = if unstable > 0 {
            format!(": {unstable} become positive, having crossed the axis as a pair")
        } else {
            String::new()
        };
        section.plate(
            format!("Real parts under {title}"),
            paper,
            "{count} eigenvalues, for as many states; within the meaningful range their real parts \
             are at most {largest}{crossing}.",
            &[
                (
                    "count",
                    match count {
                        3 => "Three".to_owned(),
                        4 => "Four".to_owned(),
                        other => other.to_string(),
                    },
                ),
                ("largest", told.join(", ")),
                ("crossing", crossing),
            ],
            pictures,
        );
    }
    section
}

/// The speed of the appendix's threshold, for the paper's car, in m/s.
const SLOW: f64 = 0.1;

/// The bifurcation study of the appendix's law.
pub(super) fn appendix(setup: &Setup, progress: &ProgressBar) -> Section {
    progress.set_message("bifurcations of the appendix's law");
    let mut section = Section::new(6, "Bifurcations under the appendix's law");
    section.intro =
        "The same study of the law of the appendix, which needs l<sub>r</sub>, the mass and the \
         cornering stiffnesses besides: with its centre of mass dl behind its place on a \
         wheelbase that is known, l<sub>f</sub> + dl and l<sub>r</sub> − dl, unless told \
         otherwise."
            .to_owned();
    let mut curve = curve(setup, Law::VelocityPoint, &mut section);
    curve.retain(HopfPoint::ends_stability);
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
    let measurements = &mut section.measurements;
    measurements.add("hopf.velocity.threshold_mm", both * 1000.0);
    measurements.add("hopf.velocity.threshold_front_only_mm", front * 1000.0);
    let least_dl = least(curve.iter().map(|point| point.deviation));
    measurements.add("hopf.velocity.least_dl", least_dl);
    measurements.add("hopf.velocity.least_l1", least(curve.iter().map(l1)));
    measurements.add("hopf.velocity.leaves_range", leaves);
    section.table("hopf-velocity-point", hopf_table(&curve));
    let pictures = region_picture(
        setup,
        Law::VelocityPoint,
        "region-velocity-point",
        &mut section,
    );
    section.plate(
        "Stability over speed and deviation",
        "Light and dark regions over speed and dl; the Hopf curve lies at positive dl, at small \
         speeds inside the meaningful range and close to zero: 0.136 mm at 0.1 m/s.",
        "At {slow} m/s stability ends at dl = {both} with l<sub>f</sub> and l<sub>r</sub> both \
         wrong (with only l<sub>f</sub> wrong it would be {front}), and the curve leaves the \
         meaningful range (l<sub>r</sub> = {behind}) at {leaves} m/s. {lyapunov}",
        &[
            ("slow", number(SLOW * setup.scale())),
            ("both", mm(both)),
            ("front", mm(front)),
            ("behind", metres(behind)),
            ("leaves", with_digits(leaves, 2)),
            ("lyapunov", lyapunov(&curve)),
        ],
        pictures,
    );
    section
}
