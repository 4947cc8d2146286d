//! The paper's assumptions and side remarks, as numbers: similitude, small angles, the
//! direction of the motion, the point that is measured, and positions as states.

use libm::{atan, atan2, cos, hypot, sin, tan};
use nalgebra::Rotation2;
use singletrack_analysis::stability::{Belief, ClosedLoop, Law, SampledLoop, Timing};
use singletrack_control::{
    FrontPointLaw, Motion, SingleTrack, SingleTrackState, Singularity, SlipAngles,
    VehicleParameters, Velocity, direction,
};

use super::{GAIN, Setup, TURN_RATE};

/// The speeds of the studies, for the paper's car, in m/s.
const SPEEDS: [f64; 7] = [0.1, 0.3, 0.5, 1.0, 2.0, 4.0, 8.0];

/// The largest relative difference between the eigenvalues of the car and those of a car ten
/// times as long, 850 times as heavy, on a time scale √10 times as long.
pub(super) fn similitude(setup: &Setup) -> Option<f64> {
    let (length, mass, time) = (10.0, 850.0, 10.0_f64.sqrt());
    let car = setup.vehicle;
    let stiffness = mass * length / (time * time);
    let large = VehicleParameters {
        mass_kg: car.mass_kg * mass,
        yaw_inertia_kg_m2: car.yaw_inertia_kg_m2 * mass * length * length,
        front_axle_distance_m: car.front_axle_distance_m * length,
        rear_axle_distance_m: car.rear_axle_distance_m * length,
        friction: car.friction,
        front_cornering_stiffness_n_rad: car.front_cornering_stiffness_n_rad * stiffness,
        rear_cornering_stiffness_n_rad: car.rear_cornering_stiffness_n_rad * stiffness,
    };
    let p = setup.point_distance_m();
    let mut largest: f64 = 0.0;
    for law in [Law::FrontPoint, Law::VelocityPoint] {
        for speed in SPEEDS.map(|speed| speed * setup.scale()) {
            for part in [-0.9, -0.3, 0.3, 0.9] {
                let deviation = part * car.rear_axle_distance_m;
                let one = ClosedLoop::new(car, law, p, speed, deviation).ok()?;
                let other = ClosedLoop::new(
                    large,
                    law,
                    p * length,
                    speed * length / time,
                    deviation * length,
                )
                .ok()?;
                for (one, other) in one.eigenvalues().iter().zip(&other.eigenvalues()) {
                    largest = largest.max((other * time - one).norm() / one.norm());
                }
            }
        }
    }
    Some(largest)
}

/// The steering angle with which P goes round on its path, with linear tyres, in rad.
pub(super) fn steering_on_circle(setup: &Setup, angles: SlipAngles) -> f64 {
    let amplitude = setup.amplitude_m();
    let VehicleParameters {
        mass_kg: m,
        front_axle_distance_m: l_f,
        rear_axle_distance_m: l_r,
        front_cornering_stiffness_n_rad: c_f,
        rear_cornering_stiffness_n_rad: c_r,
        ..
    } = setup.vehicle;
    let wheelbase = l_f + l_r;
    let p = setup.point_distance_m();
    let r = TURN_RATE;
    // Sideslip and steering at a speed of G.
    let steady = |v: f64| match angles {
        SlipAngles::Small => {
            let rear = m * v * r * l_f / (wheelbase * c_r);
            let front = m * v * r * l_r / (wheelbase * c_f);
            let sideslip = l_r * r / v - rear;
            (sideslip, front + sideslip + l_f * r / v)
        }
        SlipAngles::Exact => {
            let (mut sideslip, mut steering) = (0.0_f64, 0.0_f64);
            for _ in 0..200 {
                let across = m * v * r * cos(sideslip);
                let rear = across * l_f / (wheelbase * c_r);
                let front = across * l_r / (wheelbase * c_f * cos(steering));
                sideslip = atan((l_r * r / v) / cos(sideslip) - tan(rear));
                steering = front + atan2(v * sin(sideslip) + l_f * r, v * cos(sideslip));
            }
            (sideslip, steering)
        }
    };
    // P from the centre of the circle: farther out at a higher speed.
    let reach = |v: f64| {
        let (sideslip, steering) = steady(v);
        hypot(
            l_f + p * cos(steering) + v / r * sin(sideslip),
            p * sin(steering) - v / r * cos(sideslip),
        )
    };
    let (mut low, mut high) = (0.5 * amplitude * r, 1.5 * amplitude * r);
    for _ in 0..100 {
        let middle = 0.5 * (low + high);
        if reach(middle) < amplitude {
            low = middle;
        } else {
            high = middle;
        }
    }
    steady(0.5 * (low + high)).1
}

/// States off the steady motion, with the yaw against the velocity of P, and the steering.
const DISTURBED: [(Motion, f64); 4] = [
    disturbed([0.0, 0.0, 0.0, 0.0]),
    disturbed([0.3, 0.5, -0.1, 0.2]),
    disturbed([-0.4, 1.0, 0.15, -0.3]),
    disturbed([0.1, -2.0, 0.05, 0.35]),
];

const fn disturbed([yaw, yaw_rate, sideslip, steering]: [f64; 4]) -> (Motion, f64) {
    let motion = Motion {
        yaw,
        yaw_rate,
        sideslip,
    };
    (motion, steering)
}

/// The largest difference of the motion between directions of the velocity of P.
pub(super) fn direction_matters(setup: &Setup) -> Option<f64> {
    let law = law(setup, 0.0, setup.point_distance_m())?;
    let model = SingleTrack::new(setup.vehicle);
    let mut largest: f64 = 0.0;
    for (disturbed, steering) in DISTURBED {
        let slope = |heading: f64| -> Option<[f64; 5]> {
            let motion = Motion {
                yaw: disturbed.yaw + heading,
                ..disturbed
            };
            let command = law.command(&motion, steering, &direction(heading)).ok()?;
            let state = SingleTrackState {
                yaw: motion.yaw,
                yaw_rate: motion.yaw_rate,
                sideslip: motion.sideslip,
                ..SingleTrackState::default()
            };
            let rate = model.derivative(&state, command.speed, steering);
            let velocity = Rotation2::new(-heading) * Velocity::new(rate.x, rate.y);
            Some([
                velocity.x,
                velocity.y,
                rate.yaw_rate,
                rate.sideslip,
                command.steering_rate,
            ])
        };
        let at_45 = slope(core::f64::consts::FRAC_PI_4)?;
        for heading in [0.0, 1.0, 2.5, -2.0] {
            for (one, other) in at_45.iter().zip(slope(heading)?) {
                largest = largest.max((one - other).abs() / one.abs().max(1.0));
            }
        }
    }
    Some(largest)
}

/// The law for a measured point `ahead` m ahead of the centre of mass.
pub(super) fn law(setup: &Setup, ahead: f64, point_distance: f64) -> Option<FrontPointLaw> {
    FrontPointLaw::new(
        setup.vehicle.front_axle_distance_m - ahead,
        point_distance,
        setup.vehicle.wheelbase_m(),
    )
    .ok()
}

/// The velocity of P by equation 4.
fn velocity_of_point(
    setup: &Setup,
    motion: &Motion,
    [steering, speed, steering_rate, p]: [f64; 4],
) -> Velocity {
    let (yaw, r) = (motion.yaw, motion.yaw_rate);
    let l_f = setup.vehicle.front_axle_distance_m;
    let across = |angle: f64| Velocity::new(-sin(angle), cos(angle));
    direction(yaw + motion.sideslip) * speed
        + across(yaw) * (l_f * r)
        + across(yaw + steering) * (p * (r + steering_rate))
}

/// The largest error of the velocity of P under the law, over distances p, in m/s.
pub(super) fn error_of_any_p(setup: &Setup) -> Option<f64> {
    let mut largest: f64 = 0.0;
    for p in [0.01, 0.05, 0.2, 1.0, 5.0].map(|p| p * setup.scale()) {
        let law = law(setup, 0.0, p)?;
        for (motion, steering) in DISTURBED {
            let wanted = direction(0.0);
            let command = law.command(&motion, steering, &wanted).ok()?;
            let input = [steering, command.speed, command.steering_rate, p];
            let reached = velocity_of_point(setup, &motion, input);
            largest = largest.max((reached - wanted).norm());
        }
    }
    Some(largest)
}

/// The largest difference between the commands of a controller that measures the centre of
/// mass and one that measures another point of the axis, in m/s and rad/s: the speed of the
/// rear wheels, and the steering rate.
pub(super) fn measured_point(setup: &Setup) -> Option<f64> {
    let p = setup.point_distance_m();
    let [to_front, to_rear] = ClosedLoop::meaningful_deviations(&setup.vehicle).map(|dl| -dl);
    let mut largest: f64 = 0.0;
    for (motion, steering) in DISTURBED {
        let wanted = direction(0.0);
        let own = law(setup, 0.0, p)?
            .command(&motion, steering, &wanted)
            .ok()?;
        for ahead in [0.9 * to_front, 0.3 * to_rear, to_rear] {
            // The velocity of that point at the commanded speed of the centre of mass.
            let forward = own.speed * cos(motion.sideslip);
            let aside = own.speed * sin(motion.sideslip) + ahead * motion.yaw_rate;
            let motion = Motion {
                sideslip: atan2(aside, forward),
                ..motion
            };
            let other = law(setup, ahead, p)?
                .command(&motion, steering, &wanted)
                .ok()?;
            largest = largest
                .max((other.speed * cos(motion.sideslip) - forward).abs())
                .max((other.steering_rate - own.steering_rate).abs());
        }
    }
    Some(largest)
}

/// Steady motions over a range of dl: how many are unstable with the paper's position loop
/// around the law, whose states are the position of P as well; how many are without it; and how
/// many of these are stable with it. In ticks of 1 ms. None if one can't be studied.
pub(super) fn with_position_loop(setup: &Setup, [from, to]: [f64; 2]) -> Option<[f64; 3]> {
    let mut counts = [0.0; 3];
    for speed in SPEEDS.map(|speed| speed * setup.scale()) {
        for step in 0..=20 {
            let deviation = from + (to - from) * f64::from(step) / 20.0;
            let closed_loop = ClosedLoop::new(
                setup.vehicle,
                Law::FrontPoint,
                setup.point_distance_m(),
                speed,
                deviation,
            )
            .ok()?
            .believing(Belief::CentreOfMass);
            let with_gain = |position_gain| {
                let timing = Timing {
                    position_gain,
                    ..Timing::new(1e-3, 0.0)
                };
                SampledLoop::new(closed_loop, timing).ok()
            };
            let (alone, looped) = (with_gain(0.0)?, with_gain(GAIN)?);
            for (count, counts_here) in counts.iter_mut().zip([
                !looped.is_stable(),
                !alone.is_stable(),
                !alone.is_stable() && looped.is_stable(),
            ]) {
                *count += f64::from(u8::from(counts_here));
            }
        }
    }
    Some(counts)
}

/// cos(β - δ) at which the law has no solution, if that is so at these angles, in
/// degrees.
pub(super) fn cosine_refused(setup: &Setup, sideslip: f64, steering: f64) -> Option<f64> {
    let motion = Motion {
        yaw: 0.0,
        yaw_rate: 0.0,
        sideslip: sideslip.to_radians(),
    };
    let law = law(setup, 0.0, setup.point_distance_m())?;
    match law.command(&motion, steering.to_radians(), &direction(0.0)) {
        Err(Singularity::WheelsAcrossVelocity(cosine)) => Some(cosine),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_assumptions_have_the_numbers_of_an_independent_computation() {
        let setup = Setup::paper();
        assert!(similitude(&setup).unwrap() < 1e-9);
        let steering = |angles| steering_on_circle(&setup, angles);
        assert!((steering(SlipAngles::Small) - 0.328_643).abs() < 1e-6);
        // Of a simulation of the exact car under the law, written apart from this.
        assert!((steering(SlipAngles::Exact) - 0.322_630).abs() < 2e-6);
        assert!(direction_matters(&setup).unwrap() < 1e-12);
        assert!(error_of_any_p(&setup).unwrap() < 1e-12);
        assert!(measured_point(&setup).unwrap() < 1e-12);
        let [from, to] = ClosedLoop::meaningful_deviations(&setup.vehicle);
        assert_eq!(with_position_loop(&setup, [from, to]).unwrap()[0], 0.0);
        // The claim's text names the number.
        let outside = with_position_loop(&setup, [5.0 * from, from]).unwrap();
        assert_eq!(outside[1..], [47.0, 0.0]);
        assert!((2.0 * setup.amplitude_m() - 1.788_854).abs() < 1e-6);
    }

    #[test]
    fn the_law_has_no_answer_at_the_corner_of_the_stated_ranges() {
        let cosine = cosine_refused(&Setup::paper(), 40.0, -50.0).unwrap();
        assert!(cosine.abs() < 1e-15, "{cosine}");
        assert_eq!(cosine_refused(&Setup::paper(), 40.0, -26.0), None);
    }
}
