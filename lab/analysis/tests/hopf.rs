//! The bifurcation analyses of the paper, against an independent computation with `scipy`
//! (`data/hopf_points.csv`) and against the numbers in the paper.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test may fail")]

use proptest::prelude::*;
use singletrack_analysis::stability::{
    Belief, ClosedLoop, Criticality, HopfPoint, Law, critical_speed, hopf_points,
    infinite_speed_limit, smallest_point_distance,
};
use singletrack_control::VehicleParameters;

const P: f64 = 0.35;

fn closed_loop(law: Law, speed: f64, deviation: f64) -> ClosedLoop {
    ClosedLoop::new(VehicleParameters::paper(), law, P, speed, deviation).unwrap()
}

/// The only Hopf point of the paper's car at a speed.
fn only(law: Law, belief: Belief, speed: f64) -> HopfPoint {
    let points = hopf_points(VehicleParameters::paper(), law, belief, P, speed).unwrap();
    let [point] = points[..] else {
        panic!("{law:?} at {speed} m/s: {points:?}");
    };
    point
}

fn speeds() -> impl Iterator<Item = f64> {
    (1..=160).map(|step| f64::from(step) * 0.05)
}

fn relative(ours: f64, theirs: f64) -> f64 {
    (ours / theirs - 1.0).abs()
}

#[test]
fn hopf_points_equal_the_reference() {
    let mut reader = csv::Reader::from_reader(&include_bytes!("data/hopf_points.csv")[..]);
    let mut compared = 0;
    for row in reader.deserialize() {
        let (law, speed, deviation, frequency, kuznetsov, matcont, crossing, others): (
            String,
            f64,
            f64,
            f64,
            f64,
            f64,
            f64,
            f64,
        ) = row.unwrap();
        let law = match law.as_str() {
            "proposed" => Law::FrontPoint,
            "appendix" => Law::VelocityPoint,
            other => panic!("{other}"),
        };
        let point = only(law, Belief::CentreOfMass, speed);
        assert!((point.deviation - deviation).abs() < 1e-12, "{point:?}");
        assert!(
            relative(point.angular_frequency, frequency) < 1e-8,
            "{point:?}"
        );
        assert!(
            relative(point.lyapunov.kuznetsov, kuznetsov) < 1e-8,
            "{point:?}"
        );
        assert!(
            relative(point.lyapunov.matcont, matcont) < 1e-8,
            "{point:?}"
        );
        assert!(relative(point.crossing, crossing) < 1e-8, "{point:?}");
        assert!(
            relative(point.largest_other_real_part, others) < 1e-8,
            "{point:?}"
        );
        compared += 1;
    }
    assert_eq!(compared, 14);
}

#[test]
fn every_hopf_bifurcation_of_both_laws_is_subcritical_and_ends_stability() {
    for law in [Law::FrontPoint, Law::VelocityPoint] {
        for speed in speeds() {
            let point = only(law, Belief::CentreOfMass, speed);
            assert_eq!(point.criticality(), Criticality::Subcritical, "{point:?}");
            assert!(point.ends_stability(), "{point:?}");
        }
    }
}

#[test]
fn at_a_hopf_point_a_pair_of_eigenvalues_is_imaginary_with_the_stated_crossing() {
    for law in [Law::FrontPoint, Law::VelocityPoint] {
        for speed in [0.1, 0.7, 2.0, 6.3] {
            let point = only(law, Belief::CentreOfMass, speed);
            let pair = |deviation: f64| {
                let eigenvalues = closed_loop(law, speed, deviation).eigenvalues();
                let mut pair: Vec<_> = eigenvalues.into_iter().filter(|l| l.im > 0.0).collect();
                pair.sort_by(|a, b| a.re.abs().total_cmp(&b.re.abs()));
                pair[0]
            };
            let at = pair(point.deviation);
            let scale = point.largest_other_real_part.abs().max(at.im);
            assert!(at.re.abs() < 1e-9 * scale, "{at}");
            assert!(
                (at.im - point.angular_frequency).abs() < 1e-9 * scale,
                "{at}"
            );
            let step = 1e-7;
            let crossing =
                (pair(point.deviation + step).re - pair(point.deviation - step).re) / (2.0 * step);
            assert!(
                relative(crossing, point.crossing) < 1e-3,
                "{crossing} {point:?}"
            );
        }
    }
}

#[test]
fn the_proposed_law_is_stable_over_the_whole_meaningful_range_at_every_speed() {
    let vehicle = VehicleParameters::paper();
    let [limit] = infinite_speed_limit(vehicle, P).unwrap()[..] else {
        panic!("one limit");
    };
    assert!((limit - -0.142_728).abs() < 5e-7, "{limit}");
    let [from, to] = ClosedLoop::meaningful_deviations(&vehicle);
    assert!(
        limit < from,
        "the limit of all speeds lies outside the range"
    );
    // The Hopf points of finite speeds approach it from below.
    let mut last = f64::NEG_INFINITY;
    for exponent in -20..=40 {
        let point = only(
            Law::FrontPoint,
            Belief::CentreOfMass,
            libm::exp2(f64::from(exponent) / 2.0),
        );
        assert!(
            last <= point.deviation && point.deviation <= limit,
            "{point:?}"
        );
        last = point.deviation;
        for step in 0..=50 {
            let deviation = from + (to - from) * f64::from(step) / 50.0;
            assert!(closed_loop(Law::FrontPoint, point.speed, deviation).is_stable());
        }
    }
    assert!(limit - last < 1e-9, "{last}");
}

#[test]
fn the_appendix_law_loses_stability_at_a_tenth_of_a_millimetre_if_both_distances_are_wrong() {
    let both = only(Law::VelocityPoint, Belief::CentreOfMass, 0.1);
    assert!((both.deviation * 1e3 - 0.136).abs() < 5e-5, "{both:?}");
    let front = only(Law::VelocityPoint, Belief::FrontAxle, 0.1);
    assert!(front.deviation > 3.0 * both.deviation, "{front:?}");
}

#[test]
fn the_proposed_law_does_not_depend_on_the_rear_axle() {
    assert_eq!(
        only(Law::FrontPoint, Belief::FrontAxle, 1.0).deviation,
        only(Law::FrontPoint, Belief::CentreOfMass, 1.0).deviation
    );
}

#[test]
fn eigenvalues_are_in_order_of_their_real_part_and_as_many_as_the_states() {
    for (law, count) in [(Law::FrontPoint, 4), (Law::VelocityPoint, 3)] {
        for speed in speeds() {
            let eigenvalues = closed_loop(law, speed, 0.05).eigenvalues();
            assert_eq!(eigenvalues.len(), count);
            assert!(eigenvalues.is_sorted_by(|a, b| a.re <= b.re));
        }
    }
}

fn vehicle() -> impl Strategy<Value = VehicleParameters> {
    (
        0.5..2000.0,
        0.2..2.0,
        0.05..2.0,
        0.05..2.0,
        5.0..100.0,
        5.0..100.0,
    )
        .prop_map(|(mass, inertia, l_f, l_r, front, rear)| VehicleParameters {
            mass_kg: mass,
            // Realistic radii of gyration and stiffnesses.
            yaw_inertia_kg_m2: inertia * mass * l_f * l_r,
            front_axle_distance_m: l_f,
            rear_axle_distance_m: l_r,
            friction: 1.0,
            front_cornering_stiffness_n_rad: front * mass,
            rear_cornering_stiffness_n_rad: rear * mass,
        })
}

proptest! {
    #[test]
    fn the_polynomial_in_closed_form_has_the_eigenvalues_of_the_jacobian(
        vehicle in vehicle(),
        velocity_point: bool,
        front_axle: bool,
        p in 0.05..3.0,
        speed in 0.2..30.0,
        part in -2.0..2.0,
    ) {
        let law = if velocity_point { Law::VelocityPoint } else { Law::FrontPoint };
        let belief = if front_axle { Belief::FrontAxle } else { Belief::CentreOfMass };
        let closed_loop = ClosedLoop::new(vehicle, law, p, speed, part * vehicle.wheelbase_m())
            .unwrap()
            .believing(belief);
        let polynomial = closed_loop.characteristic_polynomial();
        // Polynomials are compared, because roots that are close to each other are sensitive.
        let coefficients = polynomial.coefficients().to_vec();
        let eigenvalues = closed_loop.eigenvalues();
        let mut product = vec![nalgebra::Complex::new(1.0, 0.0)];
        let mut scale = vec![1.0];
        for eigenvalue in &eigenvalues {
            product.insert(0, nalgebra::Complex::new(0.0, 0.0));
            scale.insert(0, 0.0);
            for power in 0..product.len() - 1 {
                let next = product[power + 1];
                product[power] -= eigenvalue * next;
                scale[power] += eigenvalue.norm() * scale[power + 1];
            }
        }
        for (power, coefficient) in coefficients.iter().enumerate() {
            prop_assert!(
                (product[power] - coefficient).norm() <= 1e-8 * scale[power],
                "power {}: {} {}", power, product[power], coefficient
            );
        }
        let greatest = eigenvalues.last().unwrap().re;
        if greatest.abs() > 1e-6 * eigenvalues[0].norm() {
            prop_assert_eq!(closed_loop.is_stable(), greatest < 0.0);
        }
    }

    #[test]
    fn a_car_that_is_stable_at_a_speed_is_stable_at_every_lower_speed(
        vehicle in vehicle(),
        p in 0.05..3.0,
        speed in 0.2..30.0,
        slower in 0.01..1.0,
        part in 0.0..=1.0,
    ) {
        let [from, to] = ClosedLoop::meaningful_deviations(&vehicle);
        let deviation = from + part * (to - from);
        let at = |speed| {
            ClosedLoop::new(vehicle, Law::FrontPoint, p, speed, deviation).unwrap().is_stable()
        };
        prop_assert!(!at(speed) || at(slower * speed));
    }
}

#[test]
fn beyond_its_critical_speed_a_car_is_unstable_somewhere_in_the_range() {
    let paper = VehicleParameters::paper();
    let range = ClosedLoop::meaningful_deviations(&paper);
    assert_eq!(critical_speed(paper, P, range).unwrap(), None);
    // With P near the front axle some deviations make the car unstable.
    let near = 0.2;
    let critical = critical_speed(paper, near, range).unwrap().unwrap();
    let at = |speed, deviation| {
        ClosedLoop::new(paper, Law::FrontPoint, near, speed, deviation)
            .unwrap()
            .is_stable()
    };
    for step in 0..=200 {
        let deviation = range[0] + (range[1] - range[0]) * f64::from(step) / 200.0;
        assert!(at(critical * 0.999_999, deviation), "{deviation}");
    }
    assert!(range.iter().any(|end| !at(critical * 1.000_001, *end)));
    assert_eq!(critical_speed(paper, P, [-1.0, 0.0]).unwrap(), Some(0.0));
}

#[test]
fn the_papers_claim_needs_almost_the_papers_distance_p() {
    let paper = VehicleParameters::paper();
    let range = ClosedLoop::meaningful_deviations(&paper);
    let smallest = smallest_point_distance(paper, range).unwrap().unwrap();
    assert!((smallest - 0.341_386).abs() < 1e-6, "{smallest}");
    assert_eq!(critical_speed(paper, smallest + 1e-9, range).unwrap(), None);
    assert!(
        critical_speed(paper, smallest - 1e-9, range)
            .unwrap()
            .is_some()
    );
}

#[test]
fn parameters_without_a_steady_motion_are_rejected_by_name() {
    let vehicle = VehicleParameters::paper();
    let rejected = |p, speed, deviation| {
        ClosedLoop::new(vehicle, Law::FrontPoint, p, speed, deviation)
            .unwrap_err()
            .to_string()
    };
    assert!(rejected(0.0, 1.0, 0.0).contains("point distance p is 0 m"));
    assert!(rejected(P, 0.0, 0.0).contains("speed is 0 m/s"));
    assert!(rejected(P, f64::NAN, 0.0).contains("NaN"));
    assert!(rejected(P, 1.0, f64::INFINITY).contains("inf"));
    assert!(rejected(P, 1e-200, 0.0).contains("range of numbers"));
    assert!(rejected(1e-300, 1e100, 0.0).contains("range of numbers"));
    let massless = VehicleParameters {
        mass_kg: 0.0,
        ..vehicle
    };
    let error = ClosedLoop::new(massless, Law::FrontPoint, P, 1.0, 0.0).unwrap_err();
    assert!(error.to_string().contains("mass_kg"), "{error}");
}
