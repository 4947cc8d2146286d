//! What the safety filter answers in states of all kinds, as numbers.
//!
//! The claims are tested in `safety_filter.rs`. They hold with room to spare, so that a wrong term
//! need not break them: here every term shows. With `SINGLETRACK_RENEW=1` the file is written.

#![allow(clippy::unwrap_used, reason = "a test may fail")]

use std::{env, fmt::Write as _, fs};

use singletrack_control::{
    Actuation, ConvexArea, Estimate, Filtered, FrontPointLaw, LimitedLaw, Limits, Position,
    SafetyConfig, SafetyFilter, SafetyInput, Time, Velocity,
};

const FILE: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/safety_answers.txt");
const PERIOD: f64 = 0.01;

/// Numbers between -1 and 1.
struct Random(u64);

impl Random {
    fn next(&mut self) -> f64 {
        // xorshift
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        (self.0 >> 11) as f64 / (1_u64 << 52) as f64 - 1.0
    }

    fn velocity(&mut self, most: f64, left: f64) -> Velocity {
        Velocity::new(most * self.next(), left * most * self.next())
    }
}

/// The lengths of the way since the last pose up to which the filter agrees; none if it never does.
fn agrees_up_to(agrees: impl Fn(f64) -> bool) -> Option<f64> {
    let (mut least, mut most) = (0.0, 4.0);
    if !agrees(least) {
        return None;
    }
    for _ in 0..50 {
        let middle = 0.5 * (least + most);
        *(if agrees(middle) {
            &mut least
        } else {
            &mut most
        }) = middle;
    }
    Some(least)
}

fn config(area: ConvexArea) -> SafetyConfig {
    SafetyConfig {
        area,
        reaction: 0.15,
        steering_ticks: 10,
        position_error: 0.01,
        course_error: 0.02,
        curvature_error: 0.1,
        curvature_error_growth: 0.0,
        speed_error: 0.02,
        max_speed: 1.4,
        max_lateral_acceleration: 1.2,
        slip: 0.02,
        wheelbase: 0.26,
    }
}

/// The answers in a state: to a velocity, up to which length of the way to a demand, and to a demand.
/// `left` is 1, or -1 for the state in a mirror.
fn answers(seed: u64, left: f64) -> (Filtered, Option<f64>, Filtered<f64>) {
    let mut random = Random(seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1);
    for _ in 0..8 {
        random.next();
    }
    let mut corners = [(-2.2, -1.6), (2.0, -1.8), (2.3, 1.5), (-1.9, 1.7)];
    if left < 0.0 {
        corners.reverse();
    }
    let area = ConvexArea::new(&corners.map(|(x, y)| Position::new(x, left * y))).unwrap();
    let config = config(area);
    let limits = Limits {
        max_acceleration: 2.0,
        ..Limits::paper()
    };
    let law = FrontPointLaw::new(0.1368, 0.35, 0.26).unwrap();
    let mut law = LimitedLaw::new(law, limits);
    let speed = 0.6 + 0.9 * random.next();
    let estimate = Estimate {
        time: Time(0),
        position: Position::new(1.5 * random.next(), left * 1.1 * random.next()),
        yaw: left * 3.2 * random.next(),
        yaw_rate: left * speed * 2.0 * random.next(),
        sideslip: left * 0.1 * random.next(),
        speed,
        pose_time: Time(0),
    };
    let goal = random.velocity(1.2, left);
    for _ in 0..(40.0 + 40.0 * random.next()) as u32 {
        let _ = law.step(&estimate.motion(), speed, &goal, PERIOD);
    }
    let mut filter = SafetyFilter::new(config).unwrap();
    for _ in 0..15 {
        filter.observe(
            speed + 0.1 * random.next(),
            left * 0.3 * random.next(),
            0.9,
            PERIOD,
        );
    }
    let blind = 0.05 + 0.05 * random.next();
    let input = |blind| SafetyInput {
        estimate: &estimate,
        law: &law,
        wheels: law.actuation().steering,
        wave: 0.02,
        blind,
        braking: 0.9,
        period: PERIOD,
        neighbours: &[],
    };
    let wanted = random.velocity(1.8, left);
    let answer = filter.step(&input(blind), &wanted, |law, velocity| {
        law.step(&estimate.motion(), speed, velocity, PERIOD)
    });
    let given = Actuation {
        speed: speed + 0.05 * random.next(),
        steering: left * 0.35 * random.next(),
        ..law.actuation()
    };
    let whole = agrees_up_to(|blind| {
        let demand = filter.demand(&input(blind), |_, _| Ok(given));
        demand == Filtered::Unchanged
    });
    let scaled = filter.demand(&input(blind), |law, share| {
        let now = law.actuation();
        Ok(Actuation {
            speed: share * given.speed,
            steering: now.steering + share * (given.steering - now.steering),
            ..now
        })
    });
    (answer, whole, scaled)
}

#[test]
fn the_answers_are_those_of_before_to_the_bit() {
    let mut rows = String::new();
    for seed in 1..=600 {
        let (velocity, whole, demand) = answers(seed, 1.0);
        writeln!(rows, "{velocity:?} | {whole:?} | {demand:?}").unwrap();
    }
    if env::var_os("SINGLETRACK_RENEW").is_some_and(|value| value == "1") {
        fs::write(FILE, &rows).unwrap();
    }
    let before = fs::read_to_string(FILE).unwrap();
    for (number, (now, before)) in (1..).zip(rows.lines().zip(before.lines())) {
        assert_eq!(now, before, "state {number}");
    }
    assert_eq!(rows.lines().count(), before.lines().count());
}

#[test]
fn left_and_right_are_treated_alike() {
    let numbers = |answer: &(Filtered, Option<f64>, Filtered<f64>), left: f64| {
        let (kind, velocity) = match answer.0 {
            Filtered::Unchanged => (0, Velocity::zeros()),
            Filtered::Limited(velocity) => (1, velocity),
            Filtered::Scaled(velocity) => (2, velocity),
            Filtered::Stop => (3, Velocity::zeros()),
        };
        (
            kind,
            answer.2,
            [velocity.x, left * velocity.y, answer.1.unwrap_or(-1.0)],
        )
    };
    for seed in 1..=2_000 {
        let one = numbers(&answers(seed, 1.0), 1.0);
        let other = numbers(&answers(seed, -1.0), -1.0);
        assert_eq!((one.0, one.1), (other.0, other.1), "state {seed}");
        for (one, other) in one.2.into_iter().zip(other.2) {
            assert!((one - other).abs() < 1e-6, "state {seed}: {one} {other}");
        }
    }
}

#[test]
fn a_car_that_still_rolls_backward_keeps_a_stop_behind_it_whatever_is_commanded() {
    let corners = [(-2.0, -2.0), (2.0, -2.0), (2.0, 2.0), (-2.0, 2.0)];
    let area = ConvexArea::new(&corners.map(|(x, y)| Position::new(x, y))).unwrap();
    let law = FrontPointLaw::new(0.1368, 0.35, 0.26).unwrap();
    let law = LimitedLaw::new(law, Limits::paper());
    let mut filter = SafetyFilter::new(config(area)).unwrap();
    filter.observe(0.5, 0.0, 0.9, PERIOD);
    for (x, may) in [(-1.8, false), (-1.0, true)] {
        let estimate = Estimate {
            time: Time(0),
            position: Position::new(x, 0.0),
            yaw: 0.0,
            yaw_rate: 0.0,
            sideslip: 0.0,
            speed: -0.5,
            pose_time: Time(0),
        };
        let input = SafetyInput {
            estimate: &estimate,
            law: &law,
            wheels: 0.0,
            wave: 0.0,
            blind: 0.0,
            braking: 0.9,
            period: PERIOD,
            neighbours: &[],
        };
        let forward = Actuation {
            speed: 0.1,
            ..Actuation::default()
        };
        let answer = filter.demand(&input, |_, _| Ok(forward));
        assert_eq!(answer == Filtered::Unchanged, may, "{x}: {answer:?}");
    }
}
