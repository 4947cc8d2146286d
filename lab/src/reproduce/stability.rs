//! The bifurcation studies of both laws and their eigenvalue maps.

use indicatif::ProgressBar;
use singletrack_analysis::stability::{
    Belief, ClosedLoop, HopfPoint, Law, critical_speed, infinite_speed_limit,
    smallest_point_distance,
};
use singletrack_control::VehicleParameters;
use singletrack_figures::figure::{Axis, Column, Curve, Figure, Look, Panel, Symbol};

use super::{
    Setup, assumptions, largest, least,
    section::{Above, Below, Near, Picture, Scope, Section, metres, mm, number, told, with_digits},
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
pub(super) fn proposed(setup: &Setup, progress: &ProgressBar) -> Section {
    progress.set_message("bifurcations of the proposed law");
    let [ahead, behind] = ClosedLoop::meaningful_deviations(&setup.vehicle);
    let intro = format!(
        "The steady motion under the law with a wrong l<sub>f</sub>, over the speed and the \
         deviation dl of the centre of mass, which is physically meaningful from −l<sub>f</sub> = \
         {} to l<sub>r</sub> = {}. Hopf points are found in closed form, their first Lyapunov \
         coefficients by exact derivatives for states in rad and rad/s.",
        metres(ahead),
        metres(behind)
    );
    let mut section = Section::new(4, "Bifurcations under the proposed law", intro);
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
    let highest = largest(deviations());
    let inside = assumptions::with_position_loop(setup, [ahead, behind]).map(|counts| counts[0]);
    let beyond = [5.0 * ahead, ahead];
    let outside = assumptions::with_position_loop(setup, beyond).map(|counts| counts[2]);
    let smallest = smallest_point_distance(setup.vehicle, [ahead, behind]);
    let smallest = smallest.ok().flatten();
    section
        .claim(
            ("hopf-negative", Scope::PaperCar, "m"),
            "Hopf bifurcations are at negative dl",
            "\"detected at negative values of dl\": below 0",
            "closed form: Hurwitz' determinant is quadratic in dl",
        )
        .number("largest", highest, Below(0.0));
    section
        .claim(
            ("hopf-outside", Scope::PaperCar, "m"),
            "They are outside the physically meaningful range at all speeds considered",
            format!(
                "\"outside the range [−l_f, l_r] for all considered velocity values\": below \
                     {}",
                number(ahead)
            ),
            format!(
                "and so they are at any speed: the paper does not say which it considers, and not \
                 that the limit is so near ({})",
                mm(ahead - limit)
            ),
        )
        .number("largest", highest, Below(ahead))
        .number("v → ∞", limit, Below(ahead));
    section
        .claim(
            ("hopf-subcritical", Scope::PaperCar, ""),
            "They are subcritical",
            "\"subcritical Hopf bifurcations\": l₁ above 0",
            "exact derivatives; Kuznetsov's normalisation, on which the sign does not depend",
        )
        .number("least l₁", least(curve.iter().map(l1)), Above(0.0));
    section
        .claim(
            ("structurally-stable", Scope::PaperCar, ""),
            "The steady motion is stable over the whole meaningful range",
            "\"structurally asymptotically stable\": no unstable point",
            "Hurwitz' criterion at 201 values of dl and 9 speeds from 0.01 to 1000 m/s",
        )
        .number("unstable points", unstable as f64, Near(0.0, 0.0));
    section
        .claim(
            ("necessary-and-sufficient", Scope::PaperCar, ""),
            "The stability of ξ decides that of the whole system",
            "\"necessary, but also sufficient\": with the position loop around the law no \
             unstable point where ξ is stable, and no stable one where it is not",
            "without a position loop the positions do not act on ξ; with one and a wrong l_f \
             they do, and the paper's gain of 1 takes no stability over the meaningful range and \
             gives none at the unstable ones of 147 motions beyond it, down to dl = −5 l_f",
        )
        .number("unstable of 147", inside, Near(0.0, 0.0))
        .number("stable of 47", outside, Near(0.0, 0.0));
    let turned = assumptions::direction_matters(setup);
    section
        .claim(
            ("direction", Scope::AnyCar, ""),
            "The direction of the motion may be 45° without loss of generality",
            "\"without loss of generality\": the same motion in every direction",
            "law and model turn with the world; four directions and four states",
        )
        .number("differ by", turned, Near(0.0, 1e-9));
    section
        .claim(
            ("point-stability", Scope::Nobody, "m"),
            "Stable with P at another distance",
            "analysed with p = 0.35 m only",
            "our extension, in closed form: stable over the whole meaningful range at every \
             speed from this p on. With the servo of the simulated car the least p grows with \
             the speed",
        )
        .number("p for every speed", smallest, Near(0.35, 0.01));
    section.table("hopf-front-point", hopf_table(&curve));
    let mut pictures = region_picture(setup, Law::FrontPoint, "region-front-point", &mut section);
    pictures.push(lyapunov_picture("lyapunov-front-point", &curve));
    section.plate(
        "Stability over speed and deviation",
        "Light and dark regions over speed and dl; the Hopf curve lies at negative dl, outside the \
         physically meaningful range, with values of the first Lyapunov coefficient along it.",
        format!(
            "Between {} and {} m/s the Hopf curve rises from dl = {} to {}, {stable}. {}",
            number(SPEEDS[0] * setup.scale()),
            number(SPEEDS[1] * setup.scale()),
            metres(least(deviations())),
            metres(largest(deviations())),
            lyapunov(&curve)
        ),
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
    let mut section = Section::new(
        5,
        "Eigenvalues under both laws",
        "The real parts of the eigenvalues of the same steady motions, numbered by ascending real \
         part at every point.",
    );
    // The largest real part of each, under either law.
    let mut found = [Vec::new(), Vec::new()];
    let laws = [
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
    ];
    for ((law, name, title, paper), parts) in laws.into_iter().zip(&mut found) {
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
        parts.extend((0..count).map(|index| largest_within(&map, index, range)));
        let pictures = match scene(&subject, setup, &mut section) {
            Some(scene) => picture(&mut section, &file, figures::eigenvalues(&scene, &map)),
            None => Vec::new(),
        };
        let crossing = match unstable(parts) {
            0 => String::new(),
            count => format!(": {count} become positive, having crossed the axis as a pair"),
        };
        let parts: Vec<String> = parts.iter().map(|part| told(Some(*part), "1/s")).collect();
        section.plate(
            format!("Real parts under {title}"),
            paper,
            format!(
                "{} eigenvalues, for as many states; within the meaningful range their real parts \
                 are at most {}{crossing}.",
                match count {
                    3 => "Three".to_owned(),
                    4 => "Four".to_owned(),
                    other => other.to_string(),
                },
                parts.join(", ")
            ),
            pictures,
        );
    }
    let [front, velocity] = &found;
    let measured = (!velocity.is_empty()).then_some(velocity);
    let count = measured.map(|parts| parts.len() as f64);
    let critical = measured.map(|parts| unstable(parts) as f64);
    section
        .claim(
            ("eigenvalues-negative", Scope::PaperCar, "1/s"),
            "All four real parts are negative within the meaningful range",
            "\"R(λ_i) < 0 for all i = 1, …, 4\": below 0",
            "over the map of speed and dl, sorted by real part",
        )
        .number("λ₁ at most", front.first().copied(), Below(0.0))
        .number("λ₂ at most", front.get(1).copied(), Below(0.0))
        .number("λ₃ at most", front.get(2).copied(), Below(0.0))
        .number("λ₄ at most", front.get(3).copied(), Below(0.0));
    section
        .claim(
            ("eigenvalues-appendix-count", Scope::AnyCar, ""),
            "The appendix's law has four eigenvalues",
            "\"the four eigenvalues of the dynamics of ξ̃\": 4",
            "ξ̃ is yaw, yaw rate and sideslip: three states, as the law commands the steering \
             angle itself; and the paper shows three maps",
        )
        .slip("eigenvalues", count, Near(4.0, 0.0), Near(3.0, 0.0));
    section
        .claim(
            ("eigenvalues-appendix-critical", Scope::PaperCar, ""),
            "Only λ₃ of the appendix's law becomes positive",
            "the caption of its map has a region with R ≥ 0, those of λ₁ and λ₂ have none: 1",
            "at a Hopf bifurcation a complex pair crosses the axis: λ₂ goes with λ₃",
        )
        .slip(
            "with R ≥ 0 in the range",
            critical,
            Near(1.0, 0.0),
            Near(2.0, 0.0),
        );
    section
}

/// How many of the largest real parts are not negative.
fn unstable(parts: &[f64]) -> usize {
    parts.iter().filter(|part| **part >= 0.0).count()
}

/// The speed of the appendix's threshold, for the paper's car, in m/s.
const SLOW: f64 = 0.1;

/// The bifurcation study of the appendix's law.
pub(super) fn appendix(setup: &Setup, progress: &ProgressBar) -> Section {
    progress.set_message("bifurcations of the appendix's law");
    let mut section = Section::new(
        6,
        "Bifurcations under the appendix's law",
        "The same study of the law of the appendix, which needs l<sub>r</sub>, the mass and the \
         cornering stiffnesses besides: with its centre of mass dl behind its place on a \
         wheelbase that is known, l<sub>f</sub> + dl and l<sub>r</sub> − dl, unless told \
         otherwise.",
    );
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
    let VehicleParameters {
        front_cornering_stiffness_n_rad: c_f,
        rear_cornering_stiffness_n_rad: c_r,
        ..
    } = setup.vehicle;
    // The law uses the distances only in C_r l_r − C_f l_f.
    let stiffness_ratio = (c_f + c_r) / c_f;
    let lowest = least(curve.iter().map(|point| point.deviation));
    section
        .claim(
            ("appendix-threshold", Scope::PaperCar, "mm"),
            "At 0.1 m/s the appendix's law is unstable from dl = 0.136 mm on",
            "\"for v = 0.1, the threshold value for dl is equal to 0.136 mm\"",
            "exact: with both distances wrong, on a wheelbase that is known",
        )
        .number("l_f + dl and l_r − dl", both * 1000.0, Near(0.136, 0.0005));
    section
        .claim(
            ("appendix-threshold-front-only", Scope::PaperCar, "mm"),
            "The threshold of dl is with l_f alone estimated",
            "of the two only an estimate of l_f is spoken of: 0.136 mm",
            format!(
                "the law needs C_r l_r − C_f l_f: with l_f alone wrong dl counts (C_f + \
                     C_r)/C_f = {} times less",
                with_digits(stiffness_ratio, 4)
            ),
        )
        .slip(
            "l_f + dl, l_r as it is",
            front * 1000.0,
            Near(0.136, 0.0005),
            Near(0.135_977_266 * stiffness_ratio, 1e-6),
        );
    section
        .claim(
            ("appendix-inside", Scope::PaperCar, ""),
            "Its bifurcations are at positive dl, at small speeds inside the meaningful range",
            "\"at positive values of dl\", \"especially for small velocities\" inside: above 0 \
             and inside up to some speed",
            format!("the curve crosses l_r = {} m there", number(behind)),
        )
        .number("least dl, m", lowest, Above(0.0))
        .number("inside up to, m/s", leaves, Above(0.1));
    section
        .claim(
            ("appendix-subcritical", Scope::PaperCar, ""),
            "They are subcritical",
            "\"subcritical Hopf bifurcations\": l₁ above 0",
            "exact derivatives; it falls by five decades from 0.1 to 8 m/s",
        )
        .number("least l₁", least(curve.iter().map(l1)), Above(0.0));
    section.table("hopf-velocity-point", hopf_table(&curve));
    let mut pictures = region_picture(
        setup,
        Law::VelocityPoint,
        "region-velocity-point",
        &mut section,
    );
    pictures.push(lyapunov_picture("lyapunov-velocity-point", &curve));
    section.plate(
        "Stability over speed and deviation",
        "Light and dark regions over speed and dl; the Hopf curve lies at positive dl, at small \
         speeds inside the meaningful range and close to zero: 0.136 mm at 0.1 m/s.",
        format!(
            "At {} m/s stability ends at dl = {} with l<sub>f</sub> and l<sub>r</sub> both wrong \
             (with only l<sub>f</sub> wrong it would be {}), and the curve leaves the meaningful \
             range (l<sub>r</sub> = {}) at {} m/s. {}",
            number(SLOW * setup.scale()),
            mm(both),
            mm(front),
            metres(behind),
            with_digits(leaves, 2),
            lyapunov(&curve)
        ),
        pictures,
    );
    section
}
