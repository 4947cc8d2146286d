//! The safety filter on a kinematic car with lags and dead times.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test may fail")]

mod attacks;

use std::{collections::VecDeque, f64::consts::TAU};

use singletrack_control::{
    Circle, ConvexArea, Estimate, Filtered, FrontPointLaw, GENTLE_BEND, GRAVITY, LimitedLaw,
    Limits, Position, ProportionalLoop, Reference, RelaxedSingleTrack, SafetyConfig, SafetyFilter,
    SafetyInput, SingleTrackState, Time, VehicleParameters, Velocity, direction,
};

pub(crate) const PERIOD: f64 = 0.01;
pub(crate) const WHEELBASE: f64 = 0.26;
/// From G to the rear axle.
pub(crate) const L_R: f64 = 0.1232;
/// What the car does at least when its motor is at neutral, m/s².
pub(crate) const BRAKING: f64 = 0.9;
/// What the stop of the pilot commands, m/s².
const RAMP: f64 = 1.5;

pub(crate) fn rectangle(x: f64, y: f64) -> ConvexArea {
    let corners = [(-x, -y), (x, -y), (x, y), (-x, y)];
    ConvexArea::new(&corners.map(|(x, y)| Position::new(x, y))).unwrap()
}

pub(crate) fn config(area: ConvexArea) -> SafetyConfig {
    SafetyConfig {
        area,
        // 30 ms of dead time, and the lag of 80 ms: the ramp is behind by no more.
        reaction: 0.15,
        steering_ticks: 20,
        position_error: 0.01,
        course_error: 0.02,
        curvature_error: 0.1,
        curvature_error_growth: 0.0,
        speed_error: 0.0,
        max_speed: 1.5,
        max_lateral_acceleration: 2.0,
        slip: 0.0,
        wheelbase: WHEELBASE,
    }
}

pub(crate) fn limits() -> Limits {
    Limits {
        max_acceleration: 2.0,
        ..Limits::paper()
    }
}

/// A car that rolls without slip, or with the tyres of the paper's. Its servo has a dead time of 20 ms and a lag of 40 ms, its
/// motor one of 30 ms and a lag of 80 ms, and it never slows down faster than [`BRAKING`].
pub(crate) struct Car {
    /// Position of the centre of mass, yaw, yaw rate and sideslip.
    pub(crate) state: SingleTrackState,
    tyres: Option<RelaxedSingleTrack>,
    /// The speed of the rear axle along the car, m/s.
    pub(crate) speed: f64,
    steering: f64,
    steering_commands: VecDeque<f64>,
    speed_commands: VecDeque<f64>,
}

impl Car {
    pub(crate) fn standing(at: Position, yaw: f64) -> Self {
        Self {
            state: SingleTrackState {
                x: at.x,
                y: at.y,
                yaw,
                ..SingleTrackState::default()
            },
            tyres: None,
            speed: 0.0,
            steering: 0.0,
            steering_commands: vec![0.0; 2].into(),
            speed_commands: vec![0.0; 3].into(),
        }
    }

    fn centre_of_mass(&self) -> Position {
        Position::new(self.state.x, self.state.y)
    }

    pub(crate) fn estimate(&self, time: Time, error: Velocity) -> Estimate {
        Estimate {
            time,
            position: self.centre_of_mass() + error,
            yaw: self.state.yaw,
            yaw_rate: self.state.yaw_rate,
            sideslip: self.state.sideslip,
            speed: self.speed / self.state.sideslip.cos(),
            pose_time: time,
        }
    }

    fn advance(&mut self, speed: f64, steering: f64) {
        self.steering_commands.push_back(steering);
        self.speed_commands.push_back(speed);
        let steering = self.steering_commands.pop_front().unwrap();
        let speed = self.speed_commands.pop_front().unwrap();
        for _ in 0..10 {
            let step = PERIOD / 10.0;
            self.steering += (steering - self.steering) * step / 0.04;
            let change = (speed - self.speed) / 0.08;
            self.speed += change.max(-BRAKING) * step;
            self.speed = self.speed.max(0.0);
            let of_centre = self.speed / self.state.sideslip.cos();
            if let Some(tyres) = &self.tyres {
                let rate = tyres.derivative(&self.state, of_centre, self.steering);
                self.state.yaw_rate += rate.yaw_rate * step;
                self.state.sideslip += rate.sideslip * step;
            } else {
                self.state.sideslip = (L_R * self.steering.tan() / WHEELBASE).atan();
                self.state.yaw_rate = self.speed * self.steering.tan() / WHEELBASE;
            }
            self.state.yaw += self.state.yaw_rate * step;
            let way = of_centre * step * direction(self.state.yaw + self.state.sideslip);
            self.state.x += way.x;
            self.state.y += way.y;
        }
    }
}

#[derive(Default, Debug)]
struct Drive {
    /// The least distance of the centre of mass from a side, m.
    clearance: f64,
    changed: u32,
    scaled: u32,
    stopped: u32,
    way: f64,
    lateral: f64,
    /// The most ticks in a row in which the path bent otherwise than assumed.
    bent: u32,
}

/// Drives the car with whatever `wanted` asks for, by the tick and the position of P.
fn drive(
    car: &mut Car,
    config: &SafetyConfig,
    ticks: u32,
    mut wanted: impl FnMut(u32, &Position, &Estimate) -> Velocity,
) -> Drive {
    let mut law = LimitedLaw::new(
        FrontPointLaw::new(WHEELBASE - L_R, 0.35, WHEELBASE).unwrap(),
        Limits {
            max_speed: config.max_speed,
            max_lateral_acceleration: config.max_lateral_acceleration,
            ..limits()
        },
    );
    let mut filter = SafetyFilter::new(config.clone()).unwrap();
    filter.reset(0.0);
    let mut result = Drive {
        clearance: f64::INFINITY,
        ..Drive::default()
    };
    let mut bent = 0;
    for tick in 0..ticks {
        // The position is wrong by what the filter allows for, in a direction that turns.
        let error = config.position_error * 0.99 * direction(0.01 * f64::from(tick));
        let estimate = car.estimate(Time(u64::from(tick) * 10_000_000), error);
        let point = law
            .law()
            .point(estimate.position, estimate.yaw, law.actuation().steering);
        let wanted = wanted(tick, &point, &estimate);
        let input = SafetyInput {
            estimate: &estimate,
            law: &law,
            wheels: law.actuation().steering,
            wave: 0.0,
            blind: 0.0,
            braking: BRAKING,
            period: PERIOD,
            neighbours: &[],
        };
        let last = law.actuation();
        filter.observe(
            estimate.speed.max(last.speed),
            last.steering,
            BRAKING,
            PERIOD,
        );
        let fits = filter.bends_as_assumed(&estimate, 0.0);
        bent = if fits { 0 } else { bent + 1 };
        result.bent = result.bent.max(bent);
        let advance = |law: &mut LimitedLaw, velocity: &Velocity| {
            law.step(&estimate.motion(), estimate.speed, velocity, PERIOD)
        };
        let filtered = filter.step(&input, &wanted, advance);
        let velocity = match filtered {
            Filtered::Unchanged => Some(wanted),
            Filtered::Limited(velocity) | Filtered::Scaled(velocity) => {
                result.changed += 1;
                result.scaled += u32::from(matches!(filtered, Filtered::Scaled(_)));
                // What it gives instead passes, and is no faster than any.
                assert!(velocity.norm() <= config.max_speed + 1e-9, "{velocity:?}");
                let again = match filter.step(&input, &velocity, advance) {
                    Filtered::Unchanged => velocity,
                    Filtered::Limited(again) | Filtered::Scaled(again) => again,
                    Filtered::Stop => panic!("{velocity:?} for {wanted:?} does not pass"),
                };
                assert!(
                    (again - velocity).norm() < 1e-6,
                    "{again:?} of {velocity:?}"
                );
                Some(velocity)
            }
            Filtered::Stop => {
                result.stopped += 1;
                None
            }
        };
        let actuation = velocity
            .and_then(|velocity| {
                law.step(&estimate.motion(), estimate.speed, &velocity, PERIOD)
                    .ok()
            })
            .unwrap_or_else(|| law.slow_down(RAMP, PERIOD));
        car.advance(actuation.speed, actuation.steering);
        result.way += car.speed * PERIOD;
        result.lateral = f64::max(result.lateral, (car.speed * car.state.yaw_rate).abs());
        result.clearance = result
            .clearance
            .min(filter.clearance(&car.centre_of_mass()));
    }
    result
}

#[test]
fn a_drive_that_keeps_its_distance_is_not_touched() {
    let config = config(rectangle(3.0, 3.0));
    let circle = Reference::Circle(Circle::new(Position::origin(), 1.0, 0.7).unwrap());
    let tracking = ProportionalLoop {
        gain: Velocity::new(2.0, 2.0),
        feed_forward: true,
    };
    let mut car = Car::standing(Position::new(1.0, -0.6), TAU / 4.0);
    let drive = drive(&mut car, &config, 2000, |tick, point, _| {
        tracking.velocity(&circle.at(f64::from(tick) * PERIOD), point)
    });
    assert_eq!((drive.changed, drive.stopped), (0, 0), "{drive:?}");
    assert!(drive.way > 10.0, "{drive:?}");
}

#[test]
fn full_speed_at_a_wall_ends_before_it_and_not_far_from_it() {
    let config = config(rectangle(2.0, 2.0));
    for degrees in [0.0, 20.0, 45.0, 70.0_f64] {
        let heading = degrees.to_radians();
        let mut car = Car::standing(Position::new(-1.0, -1.0), heading);
        let drive = drive(&mut car, &config, 1000, |_, _, _| 1.5 * direction(heading));
        println!("{degrees} degrees: {drive:?}");
        assert!(drive.clearance > 0.0, "{degrees} degrees: {drive:?}");
        assert!(drive.clearance < 0.7, "{degrees} degrees: {drive:?}");
        assert!(drive.way > 1.5, "{degrees} degrees: {drive:?}");
    }
}

#[test]
fn a_velocity_beyond_the_largest_speed_is_left_to_the_law_where_there_is_room() {
    let mut car = Car::standing(Position::new(-15.0, 0.0), 0.0);
    let drive = drive(&mut car, &config(rectangle(20.0, 20.0)), 800, |_, _, _| {
        Velocity::new(4.0, 0.0)
    });
    assert_eq!((drive.changed, drive.stopped), (0, 0), "{drive:?}");
    assert!(drive.way > 8.0, "{drive:?}");
}

#[test]
fn a_velocity_that_is_not_finite_stops_the_car() {
    let config = config(rectangle(3.0, 3.0));
    for broken in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
        let mut car = Car::standing(Position::new(-1.0, 0.0), 0.0);
        let drive = drive(&mut car, &config, 600, |tick, _, _| {
            if tick < 200 {
                Velocity::new(0.8, 0.0)
            } else {
                Velocity::new(broken, 0.3)
            }
        });
        assert_eq!(drive.stopped, 400, "{drive:?}");
        assert!(car.speed < 1e-3, "{}", car.speed);
    }
}

#[test]
fn a_path_too_near_to_a_wall_is_followed_beside_it() {
    // A circle that reaches 0.2 m beyond the area: the car goes on round inside.
    let config = config(rectangle(1.5, 1.5));
    let circle = Reference::Circle(Circle::new(Position::new(0.5, 0.0), 1.2, 0.5).unwrap());
    let tracking = ProportionalLoop {
        gain: Velocity::new(2.0, 2.0),
        feed_forward: true,
    };
    let mut car = Car::standing(Position::new(-0.7, 0.4), -TAU / 4.0);
    let drive = drive(&mut car, &config, 6000, |tick, point, _| {
        tracking.velocity(&circle.at(TAU + f64::from(tick) * PERIOD), point)
    });
    println!("{drive:?}");
    assert!(drive.clearance > 0.0, "{drive:?}");
    assert!(drive.changed > 0 && drive.way > 5.0, "{drive:?}");
}

#[test]
fn settings_that_make_no_sense_are_refused() {
    for change in [
        (|config: &mut SafetyConfig| config.reaction = -0.1) as fn(&mut SafetyConfig),
        |config| config.course_error = f64::NAN,
        |config| config.max_speed = f64::INFINITY,
        |config| config.steering_ticks = 100,
    ] {
        let mut config = config(rectangle(1.0, 1.0));
        change(&mut config);
        assert!(SafetyFilter::new(config).is_err());
    }
}

#[test]
fn a_speed_on_its_way_is_forgotten_as_fast_as_a_stop_brakes() {
    let after = |paces: &[f64]| {
        let corners = [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)];
        let corners = corners.map(|(x, y)| Position::new(x, y));
        let mut filter = SafetyFilter::new(config(ConvexArea::new(&corners).unwrap())).unwrap();
        for pace in paces {
            filter.observe(*pace, 0.0, 1.0, 0.25);
        }
        filter
    };
    assert_eq!(after(&[1.0, 0.0, 0.0]), after(&[0.5]));
    assert_eq!(after(&[1.0, 0.0, 0.75]), after(&[0.75]));
    assert_ne!(after(&[1.0, 0.0]), after(&[0.5]));
}

#[test]
fn a_path_bends_as_assumed_within_the_error_beyond_the_angles_on_their_way() {
    let mut filter = SafetyFilter::new(config(rectangle(2.0, 2.0))).unwrap();
    filter.reset(0.0);
    // The wheels stand between 0 and 0.2 rad.
    filter.observe(0.5, 0.2, BRAKING, PERIOD);
    let bends = |curvature: f64, speed: f64, wave: f64| {
        let estimate = Estimate {
            yaw_rate: curvature * speed,
            speed,
            ..Car::standing(Position::origin(), 0.0).estimate(Time(0), Velocity::zeros())
        };
        filter.bends_as_assumed(&estimate, wave)
    };
    let most = 0.2_f64.tan() / WHEELBASE;
    for (curvature, fits) in [
        (-0.11, false),
        (-0.09, true),
        (most + 0.09, true),
        (most + 0.11, false),
        (f64::NAN, false),
    ] {
        assert_eq!(bends(curvature, 0.5, 0.0), fits, "{curvature}");
        assert_eq!(bends(curvature, -0.5, 0.0), fits, "{curvature}");
        assert!(bends(curvature, 0.2, 0.0), "{curvature}");
    }
    // A wave of 0.05 rad adds 0.19 1/m at the right end.
    assert!(bends(-0.28, 0.5, 0.05));
    assert!(!bends(-0.30, 0.5, 0.05));
}

#[test]
fn the_error_of_the_curvature_grows_beyond_a_gentle_bend_and_up_to_the_grip() {
    let config = SafetyConfig {
        curvature_error_growth: 0.2,
        max_lateral_acceleration: 6.0,
        ..config(rectangle(9.0, 9.0))
    };
    let mut filter = SafetyFilter::new(config).unwrap();
    filter.reset(0.2);
    for _ in 0..30 {
        filter.observe(1.0, 0.2, BRAKING, PERIOD);
    }
    let curvature = 0.2_f64.tan() / WHEELBASE;
    let bends = |beyond: f64, speed: f64| {
        let estimate = Estimate {
            yaw_rate: (curvature + beyond) * speed,
            speed,
            ..Car::standing(Position::origin(), 0.0).estimate(Time(0), Velocity::zeros())
        };
        filter.bends_as_assumed(&estimate, 0.0)
    };
    for (lateral, error) in [
        (1.0, 0.1),
        (GENTLE_BEND, 0.1),
        (GENTLE_BEND + 2.0, 0.5),
        (6.0, 0.1 + 0.2 * (6.0 - GENTLE_BEND)),
        (9.0, 0.1 + 0.2 * (6.0 - GENTLE_BEND)),
    ] {
        let speed = (lateral / curvature).sqrt();
        for sign in [1.0, -1.0] {
            assert!(bends(sign * (error - 1e-6), speed), "{lateral}");
            assert!(!bends(sign * (error + 1e-6), speed), "{lateral}");
        }
    }
}

#[test]
fn a_filter_that_is_reset_forgets_the_drive_but_not_where_the_wheels_were_sent() {
    let new = SafetyFilter::new(config(rectangle(2.0, 2.0))).unwrap();
    let mut filter = new.clone();
    for _ in 0..40 {
        filter.observe(1.4, 0.3, BRAKING, PERIOD);
    }
    assert_ne!(filter, new);
    filter.reset(0.0);
    assert_eq!(filter, new);
    filter.reset(0.2);
    assert_ne!(filter, new);
}
