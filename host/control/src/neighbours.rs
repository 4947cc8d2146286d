//! Other rigid bodies on the floor, and how near the car may come to each of them.
//!
//! A body is expected to do the worst: from where it was seen last, at the speed that it may have
//! had, it becomes faster until it brakes, and it may have turned any way. It stays within a
//! disc, and the car on this side of the disc's tangent. Two cars of which one stops in time before
//! that tangent do not meet: what the other does next lies within what is expected of it
//! (responsibility-sensitive safety, Shalev-Shwartz, Shammah and Shashua, 2017). So of two that
//! keep apart, one has the right of way: it expects of the other only that it brakes.

use heapless::Vec;
use libm::sqrt;

use crate::{Position, Side, Time, Velocity};

/// The most bodies that are followed at a time.
pub const MAX_NEIGHBOURS: usize = 24;
/// Each may be at two places.
const MOST_SIDES: usize = 2 * MAX_NEIGHBOURS;

/// The time over which a speed is measured is once to twice as long, s.
const WINDOW: f64 = 0.05;
/// A body is taken for where it was seen, beyond what its speed explains, within this, m.
const JUMP: f64 = 0.05;
/// A body that has jumped is there, and nowhere else, after so long, s.
const SETTLES: f64 = 0.5;

/// What a frame of the cameras says of another rigid body.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NeighbourSample {
    /// The body's number.
    pub id: i32,
    /// Mid-exposure, on the host's clock.
    pub capture: Time,
    /// Position of the body's origin on the floor, world frame, in m. `None` while the cameras
    /// do not see it.
    pub position: Option<Position>,
    /// Whether it is a car that expects the worst of this one: then this one need not expect it of
    /// that.
    pub yields: bool,
}

/// What is expected of other bodies.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NeighbourConfig {
    /// Distance from the car's centre of mass to the body's origin within which they may touch,
    /// m: half the lengths of both, and the error of the position.
    pub clearance: f64,
    /// The largest speed, m/s.
    pub max_speed: f64,
    /// The largest acceleration, m/s².
    pub acceleration: f64,
    /// The least deceleration of a stop, m/s².
    pub braking: f64,
    /// The longest time from a pose of it until it brakes, s.
    pub reaction: f64,
    /// How long one may stand in the car's way before the drive ends, s.
    pub patience: f64,
}

/// Where a body was seen, and when.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Sighting {
    since: Time,
    at: Time,
    position: Position,
    /// Earlier ones, the oldest first, [`WINDOW`] apart.
    before: [(Time, Position); 2],
}

impl Sighting {
    const fn new(at: Time, position: Position) -> Self {
        Self {
            since: at,
            at,
            position,
            before: [(at, position); 2],
        }
    }

    fn continues(&self, at: Time, position: &Position, config: &NeighbourConfig) -> bool {
        let most = config.max_speed * at.seconds_since(self.at) + JUMP;
        (position - self.position).norm_squared() <= most * most
    }

    fn advance(&mut self, at: Time, position: Position) {
        (self.at, self.position) = (at, position);
        if at.seconds_since(self.before[1].0) >= WINDOW {
            self.before = [self.before[1], (at, position)];
        }
    }

    /// The mean speed over the last window, m/s, and its length, s; none while it is not known.
    fn mean_speed(&self) -> Option<(f64, f64)> {
        let (then, there) = self.before[0];
        let elapsed = self.at.seconds_since(then);
        let way = sqrt((self.position - there).norm_squared());
        (elapsed >= WINDOW).then_some((way / elapsed, elapsed))
    }

    /// How far from here the body may be when it has stopped, m.
    fn reach(&self, now: Time, expected: Expected, config: &NeighbourConfig) -> f64 {
        let age = now.seconds_since(self.at).max(0.0);
        let (speed, time) = match (self.mean_speed(), expected) {
            (Some((mean, elapsed)), Expected::Worst) => (
                mean + 0.5 * config.acceleration * elapsed,
                age + config.reaction,
            ),
            (Some((mean, _)), Expected::BrakesNow) => (mean, age),
            (None, _) => (config.max_speed, age + config.reaction),
        };
        let most = config.max_speed.max(speed);
        let accelerates = ((most - speed) / config.acceleration).min(time);
        let fastest = speed + config.acceleration * accelerates;
        let until_then = 0.5 * (speed + fastest) * accelerates;
        until_then + fastest * (time - accelerates) + 0.5 * fastest * fastest / config.braking
    }
}

/// What a body does that has been seen.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Expected {
    /// It becomes faster until it brakes, as late as it may.
    Worst,
    /// It brakes now.
    BrakesNow,
}

#[derive(Clone, Copy, Debug, PartialEq)]
struct Neighbour {
    id: i32,
    yields: bool,
    heard: Time,
    seen: Option<Time>,
    /// Where it was seen last; none if it never was.
    place: Option<Sighting>,
    /// Where it was seen since, if it can't have come there.
    doubted: Option<Sighting>,
}

impl Neighbour {
    fn see(&mut self, at: Time, position: Position, config: &NeighbourConfig) {
        // Cameras measure noise: a pose that repeats to the bit is an old one.
        let is_old =
            |place: &Option<Sighting>| place.is_some_and(|place| place.position == position);
        if is_old(&self.place) || is_old(&self.doubted) {
            return;
        }
        let is_fresh = |place: &Sighting| at.seconds_since(place.at) < SETTLES;
        match (&mut self.place, &mut self.doubted) {
            (Some(place), doubted) if place.continues(at, &position, config) => {
                place.advance(at, position);
                *doubted = doubted.filter(is_fresh);
            }
            (Some(place), Some(doubted)) if doubted.continues(at, &position, config) => {
                doubted.advance(at, position);
                if at.seconds_since(doubted.since) >= SETTLES {
                    *place = *doubted;
                    self.doubted = None;
                }
            }
            (Some(_), doubted) => *doubted = Some(Sighting::new(at, position)),
            (place @ None, _) => *place = Some(Sighting::new(at, position)),
        }
    }
}

/// The other bodies.
#[derive(Clone, Debug, PartialEq)]
pub struct Neighbours {
    /// What is expected of them.
    pub config: NeighbourConfig,
    bodies: Vec<Neighbour, MAX_NEIGHBOURS>,
    /// Whether there were more than can be followed.
    are_too_many: bool,
}

impl Neighbours {
    /// None yet.
    pub const fn new(config: NeighbourConfig) -> Self {
        Self {
            config,
            bodies: Vec::new(),
            are_too_many: false,
        }
    }

    /// Takes what a frame says of one of them.
    pub fn handle(&mut self, sample: &NeighbourSample) {
        let (id, heard) = (sample.id, sample.capture);
        let index = match self.bodies.iter().position(|body| body.id == id) {
            Some(index) => index,
            None => {
                let neighbour = Neighbour {
                    id,
                    yields: false,
                    heard,
                    seen: None,
                    place: None,
                    doubted: None,
                };
                if self.bodies.push(neighbour).is_err() {
                    self.are_too_many = true;
                    return;
                }
                self.bodies.len() - 1
            }
        };
        let body = &mut self.bodies[index];
        body.heard = body.heard.max(heard);
        body.yields = sample.yields;
        let finite = |position: &Position| position.iter().all(|number| number.is_finite());
        if let Some(position) = sample.position.filter(finite)
            && body.seen.is_none_or(|seen| heard > seen)
        {
            body.seen = Some(heard);
            body.see(heard, position, &self.config);
        }
    }

    /// Forgets those that no frame has listed for `silence` (s).
    pub fn forget(&mut self, now: Time, silence: f64) {
        self.bodies
            .retain(|body| now.seconds_since(body.heard) <= silence);
        self.are_too_many = false;
    }

    /// Whether one is listed that was never seen, or there are more than can be followed: it may
    /// be anywhere.
    pub fn are_unknown(&self) -> bool {
        self.are_too_many || self.bodies.iter().any(|body| body.place.is_none())
    }

    /// For each place where one may be, the line beyond which it may be, seen from `from` (m): the
    /// car's centre of mass must stop before it.
    pub fn sides(&self, now: Time, from: &Position, expected: Expected) -> NeighbourSides {
        let side = |place: Sighting, expected| {
            let way = place.position - from;
            let distance = sqrt(way.norm_squared());
            let outward = if distance > 0.0 {
                way / distance
            } else {
                Velocity::new(1.0, 0.0)
            };
            let kept = place.reach(now, expected, &self.config) + self.config.clearance;
            Side {
                outward,
                offset: outward.dot(&place.position.coords) - kept,
            }
        };
        let sides = |body: &Neighbour| {
            let expected = if body.yields {
                Expected::BrakesNow
            } else {
                expected
            };
            let places = [body.place, body.doubted].into_iter().flatten();
            places.map(move |place| side(place, expected))
        };
        self.bodies.iter().flat_map(sides).collect()
    }
}

/// The lines that keep the car apart from other bodies.
pub type NeighbourSides = Vec<Side, MOST_SIDES>;

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test may fail")]
mod tests {
    use proptest::prelude::*;

    use super::*;

    const CONFIG: NeighbourConfig = NeighbourConfig {
        clearance: 0.4,
        max_speed: 2.0,
        acceleration: 2.0,
        braking: 2.0,
        reaction: 0.1,
        patience: 10.0,
    };

    fn sample(id: i32, ms: u64, place: Option<(f64, f64)>) -> NeighbourSample {
        NeighbourSample {
            id,
            capture: Time(ms * 1_000_000),
            // A measurement never repeats.
            position: place.map(|(x, y)| Position::new(x + 1e-9 * ms as f64, y)),
            yields: false,
        }
    }

    /// One that was seen every 10 ms until `ms`.
    fn seen(ms: u64, place: impl Fn(f64) -> (f64, f64)) -> Neighbours {
        let mut neighbours = Neighbours::new(CONFIG);
        for now in (0..=ms).step_by(10) {
            neighbours.handle(&sample(7, now, Some(place(now as f64 * 1e-3))));
        }
        neighbours
    }

    /// How far along x a car at the origin may go.
    fn room(neighbours: &Neighbours, ms: u64) -> f64 {
        let sides = neighbours.sides(Time(ms * 1_000_000), &Position::origin(), Expected::Worst);
        let room = |side: &Side| side.distance(&Position::origin());
        sides.iter().map(room).fold(f64::INFINITY, f64::min)
    }

    #[test]
    fn a_standing_body_is_kept_apart_from_by_what_it_can_do_within_its_reaction() {
        let neighbours = seen(500, |_| (3.0, 0.0));
        // The speed is known to a * 0.1 s / 2 at most; 0.1 s later it is up to 0.3 m/s.
        let room = room(&neighbours, 500);
        assert!((2.54..2.6).contains(&room), "{room}");
    }

    #[test]
    fn a_body_that_comes_is_kept_further_apart_from_whichever_way_it_goes() {
        for direction in [-1.0, 1.0] {
            let neighbours = seen(1_000, |t| (3.0, direction * (t - 1.0)));
            let room = room(&neighbours, 1_000);
            // 1.05 m/s, which becomes 1.25: 0.115 m, and 0.39 m to a stop.
            assert!((2.0..2.1).contains(&room), "{room}");
        }
    }

    #[test]
    fn one_that_yields_is_expected_to_brake_and_no_more() {
        let mut neighbours = seen(1_000, |t| (3.0, t - 1.0));
        let yielding = NeighbourSample {
            yields: true,
            ..sample(7, 1_010, Some((3.0, 0.01)))
        };
        neighbours.handle(&yielding);
        // A quarter of a metre for 1 m/s.
        let room = room(&neighbours, 1_010);
        assert!((2.34..2.36).contains(&room), "{room}");
    }

    #[test]
    fn a_body_that_is_not_seen_any_more_may_be_wherever_it_could_have_gone() {
        let mut neighbours = seen(500, |_| (9.0, 0.0));
        let mut before = room(&neighbours, 500);
        for ms in (600..3_500).step_by(100) {
            neighbours.handle(&sample(7, ms, None));
            let room = room(&neighbours, ms);
            assert!(room < before);
            before = room;
        }
        // A second in which it becomes faster, 2 s at 2 m/s, and the stop: 6 m.
        assert!((2.5..2.6).contains(&before), "{before}");
        assert!(!neighbours.are_unknown());
    }

    #[test]
    fn a_pose_that_repeats_to_the_bit_is_as_none() {
        let mut neighbours = seen(500, |_| (9.0, 0.0));
        let frozen = sample(7, 500, Some((9.0, 0.0)));
        for ms in (510..3_500).step_by(10) {
            neighbours.handle(&NeighbourSample {
                capture: Time(ms * 1_000_000),
                ..frozen
            });
        }
        let room = room(&neighbours, 3_490);
        assert!(room < 2.6, "{room}");
    }

    #[test]
    fn a_body_that_jumps_is_expected_at_both_places_until_it_has_stayed_at_one() {
        let mut neighbours = seen(500, |_| (3.0, 0.0));
        let sides = |neighbours: &Neighbours, ms| {
            neighbours
                .sides(Time(ms * 1_000_000), &Position::origin(), Expected::Worst)
                .len()
        };
        assert_eq!(sides(&neighbours, 500), 1);
        for ms in (510..1_000).step_by(10) {
            neighbours.handle(&sample(7, ms, Some((-3.0, 0.0))));
            assert_eq!(sides(&neighbours, ms), 2, "{ms}");
        }
        neighbours.handle(&sample(7, 1_010, Some((-3.0, 0.0))));
        assert_eq!(sides(&neighbours, 1_010), 1);
    }

    #[test]
    fn a_pose_that_was_wrong_is_forgotten_after_a_while() {
        let mut neighbours = seen(500, |_| (3.0, 0.0));
        neighbours.handle(&sample(7, 510, Some((-3.0, 0.0))));
        for ms in (520..=1_010).step_by(10) {
            let sides =
                neighbours.sides(Time(ms * 1_000_000), &Position::origin(), Expected::Worst);
            assert_eq!(sides.len(), 2, "{ms}");
            neighbours.handle(&sample(7, ms, Some((3.0, 0.0))));
        }
        let sides = neighbours.sides(Time(1_010_000_000), &Position::origin(), Expected::Worst);
        assert_eq!(sides.len(), 1);
    }

    #[test]
    fn one_that_was_never_seen_and_one_too_many_are_unknown() {
        let mut neighbours = seen(500, |_| (3.0, 0.0));
        neighbours.handle(&sample(8, 500, None));
        assert!(neighbours.are_unknown());
        neighbours.handle(&sample(8, 510, Some((f64::NAN, 0.0))));
        assert!(neighbours.are_unknown());
        neighbours.handle(&sample(8, 520, Some((5.0, 0.0))));
        assert!(!neighbours.are_unknown());
        for id in 100..=100 + MAX_NEIGHBOURS as i32 {
            neighbours.handle(&sample(id, 520, Some((5.0, 0.0))));
        }
        assert!(neighbours.are_unknown());
        neighbours.forget(Time(2_000_000_000), 1.0);
        assert_eq!(neighbours, Neighbours::new(CONFIG));
    }

    proptest! {
        /// Whatever a body does within its limits, it stops on its side of the line.
        #[test]
        fn a_body_within_its_limits_stops_beyond_the_line(
            start in (-2.0..2.0_f64, 1.0..3.0_f64),
            turns in prop::collection::vec((-3.0..3.0_f64, -2.0..2.0_f64), 60),
            unseen in 0_usize..20,
        ) {
            let mut neighbours = Neighbours::new(CONFIG);
            let (mut x, mut y) = start;
            let (mut course, mut speed) = (0.0_f64, 0.0_f64);
            let mut now = 0;
            let mut drive = |turn: f64, change: f64, seen: Option<&mut Neighbours>, ms| {
                speed = (speed + change * 0.01).clamp(0.0, CONFIG.max_speed);
                course += turn * 0.01 * 4.0;
                x += speed * libm::cos(course) * 0.01;
                y += speed * libm::sin(course) * 0.01;
                if let Some(neighbours) = seen {
                    neighbours.handle(&sample(7, ms, Some((x, y))));
                }
                (Position::new(x, y), speed)
            };
            let (blind, seen) = turns.split_at(unseen);
            for &(turn, change) in seen.iter().cycle().take(100) {
                drive(turn, change, Some(&mut neighbours), now);
                now += 10;
            }
            for &(turn, change) in blind {
                drive(turn, change, None, now);
                now += 10;
            }
            // The line at the time of the last tick, seen from the origin.
            let sides = neighbours.sides(Time((now - 10) * 1_000_000), &Position::origin(), Expected::Worst);
            prop_assert_eq!(sides.len(), 1);
            // As fast as it may until it brakes, towards where it went.
            for _ in 0..10 {
                drive(0.0, CONFIG.acceleration, None, now);
            }
            let beyond = |place: &Position| -sides[0].distance(place) >= CONFIG.clearance - 1e-5;
            let mut moving = true;
            while moving {
                let (place, speed) = drive(0.0, -CONFIG.braking, None, now);
                prop_assert!(beyond(&place), "{place}");
                moving = speed > 0.0;
            }
        }
    }
}
