//! Several cars in one world keep apart.

use singletrack_core::config::{NeighboursSection, ReferenceSection, Start};
use singletrack_pilot::{Arming, Filtering, Mode, PilotRequest, Reason};
use singletrack_scenario::{
    simulated::{Drive, daemon_config},
    virtual_fleet::{FleetCar, Sight, VirtualFleet},
};
use singletrack_sim::StartPose;

/// A car that follows a circle of 1 m around `centre` at `speed` (m/s), from its first point.
fn car(name: &str, centre: [f64; 2], speed: f64) -> FleetCar {
    let mut config = daemon_config(Drive::following(ReferenceSection::Circle {
        centre_m: centre,
        radius_m: 1.0,
        angular_velocity_rad_s: speed,
        start: Start::Nearest,
    }));
    config.motion_capture.rigid_body = name.to_owned();
    config.fence.braking_m_s2 = 0.9;
    config.safety_filter.enabled = true;
    config.neighbours.enabled = true;
    config.neighbours.expected = ["car1", "car2", "car3"]
        .iter()
        .filter(|other| **other != name)
        .map(|other| (*other).to_owned())
        .collect();
    FleetCar {
        config,
        start: StartPose {
            x_m: centre[0] + 1.0,
            y_m: centre[1] - 0.5,
            yaw_rad: core::f64::consts::FRAC_PI_2,
        },
        seed: centre[0].to_bits(),
    }
}

/// What each tick of a car's drive showed.
#[derive(Clone, Copy, Debug, Default)]
struct Seen {
    way: f64,
    yields: u32,
    speed: f64,
    ended: Option<(u64, Reason)>,
}

fn advance(fleet: &mut VirtualFleet, seconds: f64) -> Vec<Seen> {
    let mut seen = vec![Seen::default(); fleet.cars.len()];
    let until_us = fleet.now_us + (seconds * 1e6) as u64;
    fleet.advance_to(until_us, &mut |index, tick| {
        let output = &tick.tick.output;
        let seen = &mut seen[index];
        (seen.way, seen.speed) = (tick.truth.way, tick.truth.speed);
        seen.yields += u32::from(output.filtering == Filtering::Yielded);
        if !output.mode.commands() {
            let at_ms = tick.now.0 / 1_000_000;
            seen.ended = seen.ended.or(output.reason.map(|reason| (at_ms, reason)));
        }
    });
    seen
}

fn three(spacing: f64, speed: f64) -> VirtualFleet {
    let cars = [
        car("car1", [0.0, 0.0], speed),
        car("car2", [spacing, 0.0], speed),
        car("car3", [0.5 * spacing, 0.87 * spacing], speed),
    ];
    let mut fleet = VirtualFleet::new(&cars).unwrap();
    fleet.start().unwrap();
    fleet
}

#[test]
fn cars_on_circles_that_cross_yield_and_go_on() {
    let mut fleet = three(1.8, 0.5);
    let seen = advance(&mut fleet, 60.0);
    assert!(fleet.nearest_m() > 0.3, "{}", fleet.nearest_m());
    for car in &seen {
        // Half a metre a second, less what it waited.
        assert!(car.ended.is_none() && car.way > 27.0, "{seen:?}");
    }
    assert!(seen.iter().any(|car| car.yields > 0), "{seen:?}");
}

#[test]
fn cars_that_stand_in_each_others_way_end_their_drives_apart() {
    let mut fleet = three(1.2, 0.8);
    let seen = advance(&mut fleet, 60.0);
    assert!(fleet.nearest_m() > 0.1, "{}", fleet.nearest_m());
    for car in &seen {
        assert_eq!(
            car.ended.map(|(_, reason)| reason),
            Some(Reason::NeighbourNear)
        );
    }
}

#[test]
fn a_car_that_the_cameras_lose_stops_the_others_before_it_could_have_come() {
    let mut fleet = three(1.8, 0.5);
    advance(&mut fleet, 5.0);
    fleet.show(2, Sight::Not);
    let seen = advance(&mut fleet, 1.5);
    for car in &seen[..2] {
        // It goes up to 2 m/s, and was 2 m away at most.
        assert!(car.speed.abs() < 0.01, "{seen:?}");
    }
    let seen = advance(&mut fleet, 12.0);
    for car in &seen[..2] {
        assert_eq!(
            car.ended.map(|(_, reason)| reason),
            Some(Reason::NeighbourNear)
        );
    }
}

#[test]
fn a_car_is_not_armed_without_one_that_it_expects() {
    let mut lonely = car("car1", [0.0, 0.0], 0.5);
    lonely.config.neighbours.expected = vec!["car2".to_owned()];
    let mut fleet = VirtualFleet::new(&[lonely]).unwrap();
    advance(&mut fleet, 3.0);
    let drive = &fleet.cars[0];
    drive
        .request(PilotRequest::Arm(Arming::Unattended))
        .unwrap();
    advance(&mut fleet, 0.5);
    let pilot = &fleet.cars[0].controller().pilot;
    assert_eq!(
        (pilot.mode(), pilot.reason()),
        (Mode::Idle, Some(Reason::NeighbourUnknown))
    );
}

#[test]
fn a_car_with_the_right_of_way_waits_for_less() {
    let seen = |expects| {
        let mut cars = [car("car1", [0.0, 0.0], 0.5), car("car2", [1.8, 0.0], 0.5)];
        for car in &mut cars {
            car.config.neighbours.expected.retain(|_| false);
        }
        if expects {
            cars[0].config.neighbours.expected = vec!["car2".to_owned()];
            cars[1].config.neighbours.expected = vec!["car1".to_owned()];
        }
        let mut fleet = VirtualFleet::new(&cars).unwrap();
        fleet.start().unwrap();
        let seen = advance(&mut fleet, 30.0);
        assert!(fleet.nearest_m() > 0.3);
        seen
    };
    let (with, without) = (seen(true), seen(false));
    assert!(with[0].yields < without[0].yields, "{with:?} {without:?}");
}

#[test]
fn the_reference_of_an_unproved_car_that_waits_for_another_never_goes_back() {
    let [mut one, mut other] = against_each_other();
    // Against it on the same circle, so near that the first metre ends before it.
    other.start = StartPose {
        x_m: 0.2,
        y_m: 1.0,
        yaw_rad: -0.2,
    };
    for car in [&mut one, &mut other] {
        car.config.supervisor.prove_first_metre = true;
    }
    let mut fleet = VirtualFleet::new(&[one, other]).unwrap();
    fleet.start().unwrap();
    let mut last = [0.0; 2];
    let mut waited = 0;
    let until_us = fleet.now_us + 8_000_000;
    fleet.advance_to(until_us, &mut |index, tick| {
        let output = &tick.tick.output;
        if output.mode == Mode::Driving {
            assert!(!output.proved, "it waits before it is proved");
            let path = output.path.unwrap();
            // A tick that comes with its frame may be shorter than a period.
            assert!(path > last[index] - 0.005, "{path} after {}", last[index]);
            last[index] = path.max(last[index]);
            waited += u32::from(output.filtering == Filtering::Yielded);
        }
    });
    assert!(waited > 100, "{waited}");
}

/// Two cars that drive one circle in opposite directions, at 0.9 m/s each.
fn against_each_other() -> [FleetCar; 2] {
    let [mut one, mut other] = ["car1", "car2"].map(|name| car(name, [0.0, 0.0], 0.9));
    one.config.neighbours.expected = vec!["car2".to_owned()];
    other.config.neighbours.expected = vec!["car1".to_owned()];
    if let ReferenceSection::Circle {
        angular_velocity_rad_s: velocity,
        ..
    } = &mut other.config.reference
    {
        *velocity = -*velocity;
    }
    [one, other]
}

/// The least distance between two cars that meet on one circle, at 0.9 m/s each.
fn meet(change: impl Fn(&mut NeighboursSection)) -> f64 {
    let [mut one, mut other] = against_each_other();
    other.start = StartPose {
        x_m: -1.0,
        y_m: -0.5,
        ..one.start
    };
    for car in [&mut one, &mut other] {
        change(&mut car.config.neighbours);
    }
    let mut fleet = VirtualFleet::new(&[one, other]).unwrap();
    fleet.start().unwrap();
    advance(&mut fleet, 6.0);
    fleet.nearest_m()
}

#[test]
fn cars_that_meet_head_on_stop_apart_and_each_thing_that_is_expected_of_them_counts() {
    let as_it_is = meet(|_| {});
    let no_reaction = meet(|neighbours| {
        neighbours.reaction_ms = Some(0.0);
        neighbours.acceleration_m_s2 = 0.01;
    });
    let brakes_hard = meet(|neighbours| neighbours.braking_m_s2 = Some(50.0));
    let touching = meet(|neighbours| neighbours.clearance_m = Some(0.2));
    let blind = meet(|neighbours| neighbours.enabled = false);
    assert!(as_it_is > 0.4, "{as_it_is}");
    for nearest in [no_reaction, brakes_hard, touching] {
        assert!(nearest < as_it_is - 0.1, "{nearest} {as_it_is}");
    }
    assert!(blind < 0.0, "{blind}");
}

#[test]
fn cars_that_do_not_look_stand_against_each_other_where_they_meet() {
    let mut cars = [car("car1", [0.0, 0.0], 0.5), car("car2", [0.0, 0.0], -0.5)];
    cars[1].start.y_m = 0.8;
    cars[1].start.yaw_rad = -core::f64::consts::FRAC_PI_2;
    for car in &mut cars {
        car.config.neighbours.enabled = false;
        car.config.neighbours.expected.clear();
    }
    let mut fleet = VirtualFleet::new(&cars).unwrap();
    fleet.start().unwrap();
    let seen = advance(&mut fleet, 10.0);
    let gap_m = fleet.nearest_m();
    assert!((-0.02..0.0).contains(&gap_m), "{gap_m}");
    for seen in seen {
        let (_, reason) = seen.ended.unwrap();
        assert_eq!(reason, Reason::BoardFailsafe);
        assert!(seen.way < 0.5 && seen.speed == 0.0, "{seen:?}");
    }
}
