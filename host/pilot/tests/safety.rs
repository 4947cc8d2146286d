//! The safety filter in the pilot.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test may fail")]

use singletrack_control::{
    Circle, ConvexArea, External, FigureOfEight, OpenLoop, Position, ProportionalLoop, Reference,
    SafetyConfig, SafetyFilter, Setpoint, SpeedDemand, SteeringDemand, TrackingLoop, Velocity,
    VelocityStep, VelocitySteps, direction,
};
use singletrack_pilot::{
    Arming, Event, Fence, Filtering, Mode, Output, PilotConfig, PilotRequest, Reason,
    SupervisorConfig,
};

use crate::bench::{Bench, Pose, config};

/// Half the width of the geofence, m.
const HALF: f64 = 2.0;

fn square(half: f64) -> [Position; 4] {
    let corner = |x: f64, y: f64| Position::new(x * half, y * half);
    [
        corner(-1.0, -1.0),
        corner(1.0, -1.0),
        corner(1.0, 1.0),
        corner(-1.0, 1.0),
    ]
}

/// The bench's car follows every command at once.
fn safety() -> SafetyConfig {
    SafetyConfig {
        area: ConvexArea::new(&square(HALF)).unwrap(),
        reaction: 0.15,
        steering_ticks: 5,
        position_error: 0.01,
        course_error: 0.02,
        curvature_error: 0.1,
        curvature_error_growth: 0.0,
        speed_error: 0.05,
        max_speed: config().limits.max_speed,
        max_lateral_acceleration: 2.45,
        slip: 0.0,
        wheelbase: 0.26,
    }
}

fn filter() -> SafetyFilter {
    SafetyFilter::new(safety()).unwrap()
}

fn with(reference: Reference, filter: Option<SafetyFilter>) -> PilotConfig {
    PilotConfig {
        reference,
        fence: Fence::new(&square(HALF), 0.0).unwrap(),
        safety: filter,
        ..config()
    }
}

fn external() -> Reference {
    Reference::External(External::new(0.2).unwrap())
}

/// A bench that drives by the set-points of `wanted`.
struct Outside {
    bench: Bench,
    /// The least distance from the geofence, m.
    clearance: f64,
}

impl Outside {
    fn new(filter: Option<SafetyFilter>) -> Self {
        Self::of(with(external(), filter))
    }

    fn of(config: PilotConfig) -> Self {
        let mut bench = Bench::with(config);
        for tick in 0..200 {
            let setpoint = Setpoint::point(bench.now(), None, Velocity::zeros());
            bench.extra.push(Event::Setpoint(setpoint));
            if tick == 100 {
                bench
                    .extra
                    .push(Event::Request(PilotRequest::Arm(Arming::Unattended)));
            }
            bench.step();
        }
        assert_eq!(bench.pilot.mode(), Mode::Driving);
        Self {
            bench,
            clearance: HALF,
        }
    }

    fn step(&mut self, setpoint: Setpoint) -> Output {
        self.bench.extra.push(Event::Setpoint(setpoint));
        let output = self.bench.step();
        let Position { coords, .. } = self.bench.position;
        self.clearance = self.clearance.min(HALF - coords.amax());
        output
    }

    fn velocity(&mut self, velocity: Velocity) -> Output {
        self.step(Setpoint::point(self.bench.now(), None, velocity))
    }

    fn actuation(&mut self, steering: f64, speed: f64) -> Output {
        let (steering, speed) = (SteeringDemand::Angle(steering), SpeedDemand::Speed(speed));
        self.step(Setpoint::actuation(self.bench.now(), steering, speed))
    }
}

#[test]
fn a_drive_well_inside_has_the_same_bits_with_and_without_it() {
    let circle = Circle::new(Position::origin(), 1.0, 0.5).unwrap();
    let eight = FigureOfEight::new(Position::origin(), 1.4, 0.7, 0.3).unwrap();
    let steps = [(0.5, 0.0), (0.4, 0.3), (0.0, 0.5)].map(|(x, y)| VelocityStep {
        duration: 1.0,
        velocity: Velocity::new(x, y),
    });
    let steps = VelocitySteps::new(&steps).unwrap();
    for (reference, position, yaw, tracking) in [
        (
            Reference::Circle(circle),
            Position::new(1.0, -0.4868),
            core::f64::consts::FRAC_PI_2,
            config().tracking,
        ),
        (
            Reference::FigureOfEight(eight),
            Position::new(-0.4, -0.2),
            0.5,
            config().tracking,
        ),
        (
            Reference::VelocitySteps(steps),
            Position::origin(),
            0.0,
            TrackingLoop::OpenLoop(OpenLoop),
        ),
    ] {
        let drive = |filter| {
            let mut bench = Bench::with(PilotConfig {
                tracking: tracking.clone(),
                ..with(reference.clone(), filter)
            });
            (bench.position, bench.yaw) = (position, yaw);
            bench.run(100);
            bench.step_with(Some(PilotRequest::Arm(Arming::Unattended)));
            let outputs: Vec<_> = (0..1_000).map(|_| bench.step()).collect();
            (outputs, bench.position)
        };
        let (with, there) = drive(Some(filter()));
        let (without, place) = drive(None);
        for (tick, (with, without)) in with.iter().zip(&without).enumerate() {
            assert_eq!(with.filtering, Filtering::None, "tick {tick}: {with:?}");
            assert_eq!(with, without, "tick {tick}");
        }
        assert!(with.iter().any(|output| output.actuation.speed > 0.3));
        assert_eq!(there, place);
    }
}

#[test]
fn a_start_from_rest_is_no_intervention() {
    let mut drive = Outside::new(Some(filter()));
    for tick in 0..100 {
        let output = drive.velocity(Velocity::new(0.5, 0.0));
        assert_eq!(output.filtering, Filtering::None, "{tick}");
    }
    assert!(drive.bench.speed > 0.4);
}

#[test]
fn a_velocity_out_of_the_geofence_is_limited_and_the_car_stays_inside() {
    for degrees in [0.0, 30.0, 45.0, 80.0_f64] {
        let mut drive = Outside::new(Some(filter()));
        let wanted = 50.0 * direction(degrees.to_radians());
        let mut kinds = Vec::new();
        for _ in 0..1_000 {
            let output = drive.velocity(wanted);
            if kinds.last() != Some(&output.filtering) {
                kinds.push(output.filtering);
            }
            if output.mode != Mode::Driving {
                break;
            }
        }
        assert_eq!(
            kinds[0],
            Filtering::None,
            "{degrees}: the way is free first"
        );
        assert!(kinds.contains(&Filtering::Limited), "{degrees}: {kinds:?}");
        assert!(drive.clearance > 0.0, "{degrees}: {}", drive.clearance);
        assert!(drive.clearance < 0.7, "{degrees}: {}", drive.clearance);
        assert!(drive.bench.speed < 0.05, "{degrees}: {}", drive.bench.speed);
    }
}

#[test]
fn it_says_in_each_tick_what_it_does_in_that_tick() {
    let mut drive = Outside::new(Some(filter()));
    let mut last = Filtering::None;
    for _ in 0..600 {
        last = drive.velocity(Velocity::new(1.5, 0.0)).filtering;
    }
    assert_ne!(last, Filtering::None);
    for _ in 0..300 {
        last = drive.velocity(Velocity::new(-0.2, 0.0)).filtering;
    }
    assert_eq!(last, Filtering::None);
}

#[test]
fn its_interventions_are_counted_for_each_drive() {
    let mut drive = Outside::new(Some(filter()));
    let mut counted = 0;
    for _ in 0..600 {
        let output = drive.velocity(Velocity::new(1.5, 0.0));
        counted += u32::from(output.filtering != Filtering::None);
        assert_eq!(output.filtered_ticks, counted);
    }
    assert!(counted > 100, "{counted}");
    drive.bench.step_with(Some(PilotRequest::Disarm));
    let mut armed = false;
    for _ in 0..400 {
        armed |= drive.bench.pilot.mode() == Mode::Ready;
        if drive.bench.pilot.mode() == Mode::Ready {
            drive
                .bench
                .extra
                .push(Event::Request(PilotRequest::Arm(Arming::Unattended)));
        }
        let output = drive.velocity(Velocity::zeros());
        let expected = if output.mode == Mode::Driving {
            0
        } else {
            counted
        };
        assert_eq!(output.filtered_ticks, expected, "{}", output.mode);
    }
    assert!(armed && drive.bench.pilot.mode() == Mode::Driving);
}

#[test]
fn steering_and_speed_out_of_the_geofence_are_scaled_and_the_car_stays_inside() {
    for steering in [0.0, 0.1, 0.45] {
        let mut drive = Outside::new(Some(filter()));
        let mut intervened = false;
        for _ in 0..1_500 {
            let output = drive.actuation(steering, 50.0);
            intervened |= output.filtering == Filtering::Scaled;
            assert_ne!(output.filtering, Filtering::Limited);
            if output.mode != Mode::Driving {
                assert_eq!(output.reason, Some(Reason::OutsideFence));
                break;
            }
        }
        // A circle at full lock never comes near.
        assert_eq!(intervened, steering < 0.4, "{steering}");
        assert!(drive.clearance > 0.0, "{steering}: {}", drive.clearance);
    }
}

#[test]
fn steering_and_speed_well_inside_have_the_same_bits_with_and_without_it() {
    let drive = |filter| {
        let mut drive = Outside::new(filter);
        let ticks = 0..800;
        let outputs = ticks.map(|tick| drive.actuation(0.3, 0.4 + 0.1 * f64::from(tick % 3)));
        outputs.collect::<Vec<_>>()
    };
    assert_eq!(drive(Some(filter())), drive(None));
}

#[test]
fn a_demand_that_passes_no_trial_stops_the_car_and_at_standstill_the_drive() {
    // An area so small that nothing passes: the position may be wrong by more.
    let config = SafetyConfig {
        position_error: 2.5,
        ..safety()
    };
    let mut bench = Bench::with(with(external(), Some(SafetyFilter::new(config).unwrap())));
    let mut last = None;
    for tick in 0..200 {
        let setpoint = Setpoint::point(bench.now(), None, Velocity::new(0.5, 0.0));
        bench.extra.push(Event::Setpoint(setpoint));
        if tick == 100 {
            bench
                .extra
                .push(Event::Request(PilotRequest::Arm(Arming::Unattended)));
        }
        let output = bench.step();
        if output.mode == Mode::Driving {
            assert_eq!(output.filtering, Filtering::Stopped);
            assert_eq!(output.actuation.speed, 0.0);
        }
        last = output.reason.or(last);
    }
    assert_eq!(last, Some(Reason::OutsideFence));
    assert!(!bench.pilot.mode().is_underway());
}

#[test]
fn the_first_metre_is_filtered_with_the_braking_of_an_unproved_car() {
    // It looks farther ahead than a proved one, at a third of the speed.
    let stands_at = |prove: bool| {
        let mut config = with(external(), Some(filter()));
        config.supervisor = SupervisorConfig {
            prove,
            ..config.supervisor
        };
        let mut bench = Bench::with(config);
        bench.position = Position::new(0.9, 0.0);
        let mut limited_at = None;
        for tick in 0..600 {
            let setpoint = Setpoint::point(bench.now(), None, Velocity::new(0.3, 0.0));
            bench.extra.push(Event::Setpoint(setpoint));
            if tick == 100 {
                bench
                    .extra
                    .push(Event::Request(PilotRequest::Arm(Arming::Unattended)));
            }
            let output = bench.step();
            if output.filtering != Filtering::None && limited_at.is_none() {
                limited_at = Some(bench.position.x);
            }
        }
        assert!(bench.position.x < HALF);
        limited_at.unwrap()
    };
    assert!(stands_at(true) < stands_at(false) - 0.05);
}

#[test]
fn a_velocity_that_is_not_finite_stops_the_car_with_its_reason() {
    let circle = Reference::Circle(Circle::new(Position::origin(), 1.0, 0.5).unwrap());
    let broken = TrackingLoop::Proportional(ProportionalLoop {
        gain: Velocity::new(f64::NAN, 1.0),
        feed_forward: true,
    });
    for (filter, ends_in) in [(Some(filter()), Mode::Stopping), (None, Mode::Fault)] {
        let mut bench = Bench::with(PilotConfig {
            tracking: broken.clone(),
            ..with(circle.clone(), filter)
        });
        bench.run(100);
        bench.step_with(Some(PilotRequest::Arm(Arming::Unattended)));
        let outputs: Vec<_> = (0..50).map(|_| bench.step()).collect();
        let end = outputs
            .iter()
            .find(|output| !matches!(output.mode, Mode::Arming | Mode::Driving))
            .unwrap();
        assert_eq!((end.mode, end.reason), (ends_in, Some(Reason::LawSingular)));
        let speed = |output: &Output| output.actuation.speed;
        assert!(outputs.iter().all(|output| speed(output) == 0.0));
    }
}

/// The time that a car at 0.4 m/s drives on with wheels that stand `trim` (rad) from where they
/// are sent, s, and why it ends.
fn drives_with_trim(trim: f64, filter: Option<SafetyFilter>) -> (f64, Option<Reason>) {
    let mut outside = Outside::new(filter);
    for tick in 0..300 {
        outside.bench.steering += trim;
        let output = outside.velocity(Velocity::new(0.4, 0.0));
        if output.mode != Mode::Driving {
            return (f64::from(tick) * 0.01, output.reason);
        }
    }
    (3.0, None)
}

#[test]
fn a_path_that_bends_otherwise_than_the_filter_assumes_ends_the_drive() {
    // tan(0.05)/0.26 m: 0.19 1/m beside the assumed error of 0.1.
    let (time, reason) = drives_with_trim(0.05, Some(filter()));
    assert_eq!(reason, Some(Reason::SteeringDiffers));
    assert!((0.2..=0.45).contains(&time), "{time} s");
    let (time, reason) = drives_with_trim(-0.05, Some(filter()));
    assert_eq!(reason, Some(Reason::SteeringDiffers));
    assert!((0.2..=0.45).contains(&time), "{time} s");
    // 0.08 1/m are within it, and nothing rests on it without a filter.
    assert_eq!(drives_with_trim(0.02, Some(filter())), (3.0, None));
    assert_eq!(drives_with_trim(0.05, None), (3.0, None));
}

/// Where a drive at 0.5 m/s towards a side is first filtered, m, if no poses come from a place on.
fn filtered_at(lost_from: f64) -> f64 {
    let mut drive = Outside::new(Some(filter()));
    for _ in 0..600 {
        let at = drive.bench.position.x;
        if at >= lost_from {
            drive.bench.pose = Pose::Missing;
        }
        let output = drive.velocity(Velocity::new(0.5, 0.0));
        assert_eq!(output.mode, Mode::Driving, "{at}");
        if output.filtering != Filtering::None {
            return at;
        }
    }
    panic!("never filtered");
}

#[test]
fn a_car_that_has_lost_its_poses_is_filtered_earlier_by_the_way_since_the_last_one() {
    let seen = filtered_at(f64::INFINITY);
    // The position is predicted for 30 ms and then held; all that was driven since the pose counts as well.
    for before in [0.04, 0.08, 0.12] {
        let earlier = seen - filtered_at(seen - before);
        assert!((0.005..0.025).contains(&earlier), "{before}: {earlier}");
    }
}

#[test]
fn a_car_in_reverse_is_scaled_before_the_side_behind_it() {
    let mut config = with(external(), Some(filter()));
    config.limits.max_reverse_speed = 0.5;
    let mut drive = Outside::of(config);
    let mut intervened = false;
    for _ in 0..1_500 {
        let output = drive.actuation(0.0, -0.5);
        intervened |= output.filtering == Filtering::Scaled;
        if output.mode != Mode::Driving {
            assert_eq!(output.reason, Some(Reason::OutsideFence));
            break;
        }
    }
    assert!(intervened && drive.clearance > 0.0, "{}", drive.clearance);
    assert!(drive.bench.position.x < -1.0, "{}", drive.bench.position.x);
}
