//! The reference governor: a reference that asks too much is followed more slowly, and a bend that
//! is too tight more widely.
//!
//! The reference is a function of its own time, the path parameter s. A leader, an ideal car that
//! rolls without slip, moves along it ahead of s. Its P is the governed reference: on the path
//! while the wheels can be steered for that, and beside it otherwise. The leader tells which
//! speed, lateral acceleration, steering rate and acceleration this takes; the governor lets it
//! advance with a rate between 0 and 1, slower than time where the car could not follow, or could
//! not stop inside the geofence. All that depends on the reference alone, so a reference that the
//! car can follow is passed on as it is, to the bit.

mod leader;

use libm::{floor, rint, sin, sqrt};

use self::leader::{Leader, STEP, Sample};
use crate::{
    ConvexArea, FrontPointLaw, Limits, Position, Reference, ReferencePoint, Stop, Velocity,
    along_bend, words,
};

/// The part of a limit that the reference may take; the rest is for corrections.
const USABLE: f64 = 0.95;
/// The speed that is left to a P that is behind to catch up: this much, m/s, but at most this part
/// of the limit.
const SPEED_RESERVE: f64 = 0.2;
const SPEED_RESERVE_PART: f64 = 0.2;
/// The reference stands below this speed, m/s.
const STANDS: f64 = 1e-3;
/// The fastest change of the rate, s⁻¹.
const SLOPE: f64 = 1.0;
/// How far ahead the leader is, s: from a rate of 1, its time stops within 1 / (2 `SLOPE`); and
/// an outer loop looks so far ahead.
const AHEAD: f64 = 1.5;
/// The steps of the leader that are kept: those ahead, and some behind.
const STEPS: usize = (AHEAD / STEP) as usize + 8;

words! {
    /// Why a reference is slowed down.
    pub enum SlowedBy {
        /// The lateral acceleration of the car.
        Tyres = "tyres",
        /// Its steering angle: the governed reference is beside the path, or the wheels turn from
        /// it.
        Steering = "steering",
        /// Its steering rate.
        SteeringRate = "steering-rate",
        /// Its speed.
        Speed = "speed",
        /// P, which is far behind.
        Behind = "behind",
        /// The geofence, inside which the car must be able to stop.
        Geofence = "geofence",
    }
}

/// The settings of a [`Governor`].
#[derive(Clone, Debug, PartialEq)]
pub struct GovernorConfig {
    /// The law, which places P.
    pub law: FrontPointLaw,
    /// What the car may do.
    pub limits: Limits,
    /// The distance of P behind its reference from which on s slows down, in m; at twice the
    /// distance it waits.
    pub behind: f64,
    /// Where the car must be able to stop; none if that is everywhere.
    pub room: Option<Room>,
}

impl GovernorConfig {
    /// The radius of the circle on which P follows a circle that is smaller, in m. The steering
    /// angle that it takes leaves some for corrections.
    pub fn least_radius(&self) -> f64 {
        let front = self.limits.wheelbase / sin(USABLE * self.limits.max_steering);
        let p = self.law.point_distance();
        sqrt(front * front + p * p)
    }
}

/// Lets a reference advance as fast as the car can follow, and no tighter than it can steer.
#[derive(Clone, Debug, PartialEq)]
pub struct Governor {
    config: GovernorConfig,
    /// Time of the drive at the last tick, s.
    time: f64,
    /// The time of the leader then, s.
    led: f64,
    /// How far that is behind the time, s.
    delay: f64,
    /// The path parameter at the last tick, s.
    path: f64,
    rate: f64,
    /// The change of the rate in the last tick, s⁻¹.
    slope: f64,
    slowed_by: Option<SlowedBy>,
    leader: Option<Leader>,
    /// The number of the leader's steps.
    step: u64,
    /// Whether the leader has left the reference in this drive.
    departed: bool,
    /// The leader's last steps, the newest last.
    samples: [Sample; STEPS],
}

const FREE: Sample = Sample {
    time: f64::NEG_INFINITY,
    lag: 0.0,
    beside: None,
    rate: 1.0,
    by: None,
};

impl Governor {
    /// A governor at the start of a reference.
    pub const fn new(config: GovernorConfig) -> Self {
        Self {
            config,
            time: 0.0,
            led: 0.0,
            delay: 0.0,
            path: 0.0,
            rate: 1.0,
            slope: 0.0,
            slowed_by: None,
            leader: None,
            step: 0,
            departed: false,
            samples: [FREE; STEPS],
        }
    }

    /// Back to the start of the reference.
    pub fn reset(&mut self) {
        *self = Self::new(self.config.clone());
    }

    /// The path parameter at `time` (s since the start of the drive), which is not before the
    /// last tick; the rate stays as it is until the next tick.
    pub fn path_at(&self, time: f64) -> f64 {
        self.path_of(self.led_at(time)).max(self.path)
    }

    /// The rate at which the governed reference advances, 0 to 1: its velocity as a share of the
    /// one asked for. Beside a bend that is too tight the path parameter advances more slowly.
    pub const fn rate(&self) -> f64 {
        self.rate
    }

    /// Why the reference is followed more slowly or beside its path, if it is.
    pub const fn slowed_by(&self) -> Option<SlowedBy> {
        self.slowed_by
    }

    /// A tick at `time` (s since the start of the drive) with P at `point`. The path parameter
    /// advances as was decided in the tick before.
    pub fn advance(&mut self, time: f64, reference: &Reference, point: &Position) -> f64 {
        let elapsed = (time - self.time).max(0.0);
        let led = self.led_at(time);
        self.delay += elapsed * (1.0 - self.rate);
        (self.time, self.led) = (time, led);
        let begins = self.step == 0;
        self.look(reference);
        self.path = self.path_of(led).max(self.path);
        let (wanted, wanted_by) = self.wanted(reference, point);
        let change = SLOPE * elapsed;
        let rate = if begins {
            wanted
        } else {
            wanted.clamp(self.rate - change, self.rate + change)
        };
        let rate = rate.clamp(0.0, 1.0);
        self.slope = if elapsed > 0.0 {
            (rate - self.rate) / elapsed
        } else {
            0.0
        };
        self.rate = rate;
        self.slowed_by = match wanted_by {
            Some(by) => Some(by),
            None if self.is_beside() => Some(SlowedBy::Steering),
            // It is still on its way back.
            None if rate < 1.0 => self.slowed_by,
            None => None,
        };
        self.path
    }

    /// The governed reference `ahead` seconds after the last tick.
    pub fn at(&self, reference: &Reference, ahead: f64) -> ReferencePoint {
        if self.rate >= 1.0 && self.slope >= 0.0 {
            return self.led_point(reference, self.led + ahead);
        }
        // The rate goes on to change for a moment: that is the acceleration of the reference.
        const CHANGES: f64 = 0.1;
        let during = ahead.clamp(-CHANGES, CHANGES);
        let rate = (self.rate + self.slope * during).clamp(0.0, 1.0);
        let way = 0.5 * (self.rate + rate) * during + rate * (ahead - during);
        let mut point = self.led_point(reference, self.led + way);
        point.velocity *= rate;
        point
    }

    /// The time of the leader at `time`.
    fn led_at(&self, time: f64) -> f64 {
        let elapsed = (time - self.time).max(0.0);
        (time - (self.delay + elapsed * (1.0 - self.rate))).max(self.led)
    }

    /// The leader's steps before and after a time of it, and the part of the way between them;
    /// the same step twice at either end of what is known.
    fn between(&self, led: f64) -> (&Sample, &Sample, f64) {
        const NEWEST: usize = STEPS - 1;
        let newest = &self.samples[NEWEST];
        let known = (self.step.min(STEPS as u64) as usize).saturating_sub(1);
        let back = floor(led / STEP) - newest.time / STEP;
        let from_end = rint(-back).clamp(0.0, known as f64) as usize;
        let before = &self.samples[NEWEST - from_end];
        let after = self.samples.get(STEPS - from_end).unwrap_or(newest);
        let part = ((led - before.time) / STEP).clamp(0.0, 1.0);
        (before, after, part)
    }

    fn path_of(&self, led: f64) -> f64 {
        if !self.departed {
            return led;
        }
        let (before, after, part) = self.between(led);
        led - (before.lag + part * (after.lag - before.lag))
    }

    /// P of the leader at a time of it.
    fn led_point(&self, reference: &Reference, led: f64) -> ReferencePoint {
        if !self.departed {
            return reference.at(led);
        }
        let (before, after, part) = self.between(led);
        let Some((from, leaves)) = before.beside else {
            return reference.at(led - before.lag);
        };
        let (to, arrives) = match (after.beside, reference.at(after.time - after.lag)) {
            (Some(beside), _) => beside,
            (None, here) => (here.position.unwrap_or(from), here.velocity),
        };
        if after.time <= before.time {
            // Beyond what is known it goes straight on.
            return ReferencePoint {
                position: Some(from + (led - before.time) * leaves),
                velocity: leaves,
            };
        }
        let velocity: Velocity = leaves + part * (arrives - leaves);
        ReferencePoint {
            position: Some(from + part * (to - from)),
            velocity,
        }
    }

    /// Whether the governed reference is beside its path now.
    fn is_beside(&self) -> bool {
        self.departed && self.between(self.led).0.beside.is_some()
    }

    /// The highest rate now, and why.
    fn wanted(&self, reference: &Reference, point: &Position) -> (f64, Option<SlowedBy>) {
        let mut wanted = (1.0, None);
        for sample in &self.samples {
            let away = sample.time - self.led;
            if away < -STEP || sample.rate >= 1.0 {
                continue;
            }
            // From this rate it is reached in time.
            let rate = sqrt(sample.rate * sample.rate + 2.0 * SLOPE * away.max(0.0));
            if rate < wanted.0 {
                wanted = (rate, sample.by);
            }
        }
        let here = self.led_point(reference, self.led);
        if let Some(position) = here.position {
            let to_reference = position - point;
            let away = sqrt(to_reference.norm_squared());
            let is_behind = to_reference.dot(&here.velocity) >= 0.0;
            let rate = (2.0 - away / self.config.behind).clamp(0.0, 1.0);
            if is_behind && rate < wanted.0 {
                wanted = (rate, Some(SlowedBy::Behind));
            }
        }
        wanted
    }

    /// Moves the leader on until it is ahead.
    fn look(&mut self, reference: &Reference) {
        while (self.step as f64) * STEP <= self.led + AHEAD {
            let time = self.step as f64 * STEP;
            if self.leader.is_none() {
                self.leader = Leader::along(&reference.at(time).velocity);
            }
            let sample = match &mut self.leader {
                Some(leader) => leader.step(time, reference, &self.config),
                None => Sample { time, ..FREE },
            };
            self.departed |= sample.beside.is_some();
            self.samples.rotate_left(1);
            self.samples[STEPS - 1] = sample;
            self.step += 1;
        }
    }
}

/// The distance that the leader keeps from the edge, m: the car is beside it by noise and lag.
const RESERVE: f64 = 0.05;
/// Judged over planned speed. The geofence's watch judges by the estimated speed, whose noise on a
/// car that vibrates is 4 cm/s at 1.4 m/s: without this it stops the car beside a wall.
const JUDGED: f64 = 1.08;
/// The way of a stop is found to this part of it: 2 to the power of this.
const HALVES: u32 = 12;

/// The area in which the centre of mass G must be able to stop, and how the car stops.
#[derive(Clone, Debug, PartialEq)]
pub struct Room {
    /// The area of G, m.
    area: ConvexArea,
    stop: Stop,
}

impl Room {
    /// The room inside `area` for a car that stops with the deceleration `braking` (m/s²) after
    /// the time `reaction` (s). The leader keeps 5 cm from the edge. None if so little is left.
    pub fn new(area: &ConvexArea, braking: f64, reaction: f64) -> Option<Self> {
        let is_valid = braking > 0.0 && braking.is_finite() && reaction >= 0.0;
        let area = area.shrunk(RESERVE).ok()?;
        (is_valid && reaction.is_finite()).then_some(Self {
            area,
            stop: Stop { reaction, braking },
        })
    }

    /// The highest speed of G at which it stops inside, up to that of `velocity`, while it turns
    /// by `turn_rate` (rad/s) at that speed. The wheels are held during the stop.
    fn speed(&self, from: &Position, velocity: &Velocity, turn_rate: f64) -> f64 {
        let speed = sqrt(velocity.norm_squared());
        if speed <= 0.0 || speed.is_nan() {
            return speed;
        }
        let along = velocity / speed;
        let curvature = turn_rate / speed;
        let stays = |way: f64| {
            let mut places = along_bend(&along, curvature, way).into_iter();
            places.all(|place| self.area.clearance(&(from + place)) >= 0.0)
        };
        let whole = self.stop.way(JUDGED * speed);
        if stays(whole) {
            return speed;
        }
        let (mut inside, mut outside) = (0.0, whole);
        for _ in 0..HALVES {
            let middle = 0.5 * (inside + outside);
            if stays(middle) {
                inside = middle;
            } else {
                outside = middle;
            }
        }
        self.stop.fastest(inside) / JUDGED
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn room() -> Room {
        let corners = [(-1.05, -1.05), (1.05, -1.05), (1.05, 1.05), (-1.05, 1.05)];
        let area = ConvexArea::new(&corners.map(|(x, y)| Position::new(x, y))).unwrap();
        Room::new(&area, 1.0, 0.1).unwrap()
    }

    #[test]
    fn a_speed_that_can_be_stopped_inside_is_kept() {
        // 0.108 + 0.583 m before the edge, for the speed that is judged.
        let from = Position::new(0.308, 0.0);
        assert_eq!(room().speed(&from, &Velocity::new(1.0, 0.0), 0.0), 1.0);
        assert_eq!(room().speed(&from, &Velocity::zeros(), 0.0), 0.0);
    }

    #[test]
    fn nearer_to_the_edge_the_way_of_the_stop_ends_there() {
        for before in [0.01, 0.1, 0.3, 0.59] {
            let from = Position::new(1.0 - before, 0.0);
            let speed = room().speed(&from, &Velocity::new(1.0, 0.0), 0.0);
            let way = room().stop.way(JUDGED * speed);
            assert!((way - before).abs() < 1e-3, "{before}: {speed} {way}");
        }
        let outside = Position::new(1.001, 0.0);
        assert_eq!(room().speed(&outside, &Velocity::new(1.0, 0.0), 0.0), 0.0);
    }

    #[test]
    fn a_bend_that_turns_from_the_edge_may_be_faster() {
        let from = Position::new(0.8, 0.0);
        let velocity = Velocity::new(0.6, 0.8);
        let straight = room().speed(&from, &velocity, 0.0);
        let away = room().speed(&from, &velocity, 1.5);
        let towards = room().speed(&from, &velocity, -1.5);
        assert!(
            towards < straight && straight < away,
            "{towards} {straight} {away}"
        );
    }

    #[test]
    fn nothing_is_left_of_an_area_that_is_too_small() {
        let corners = [(0.0, 0.0), (0.05, 0.0), (0.05, 0.05)];
        let area = ConvexArea::new(&corners.map(|(x, y)| Position::new(x, y))).unwrap();
        assert_eq!(Room::new(&area, 1.0, 0.1), None);
    }
}
