//! The leader: a car without slip, whose P is the governed reference.

use core::f64::consts::FRAC_PI_4;

use libm::{atan2, fabs, sin, sqrt};

use super::{GovernorConfig, SPEED_RESERVE, SPEED_RESERVE_PART, STANDS, SlowedBy, USABLE};
use crate::{Position, Reference, ReferencePoint, Velocity, direction};

/// The steps of the leader, s.
pub(super) const STEP: f64 = 0.02;
/// A leader beside the path heads for the point this far along it, m.
const AIM: f64 = 0.2;
/// It is on the path again at this distance (m) and angle (as its sine).
const JOINS: f64 = 1e-3;
const ALIGNED: f64 = 0.02;
/// The reference moves backward where the front axle does, with this share of its speed.
const BACKWARD: f64 = 0.02;
/// A steering angle that exceeds its limit by this factor does so by rounding.
const ROUNDING: f64 = 1.0 + 1e-9;

/// The leader at one of its steps.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Sample {
    /// The time of the leader, s.
    pub(super) time: f64,
    /// How far the path parameter is behind it, s.
    pub(super) lag: f64,
    /// P and its velocity in the time of the leader; none where that is the reference itself.
    pub(super) beside: Option<(Position, Velocity)>,
    /// The highest rate of the leader's time, and why.
    pub(super) rate: f64,
    pub(super) by: Option<SlowedBy>,
}

/// A car without slip that moves P along the reference, or as near to it as its wheels can steer.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Leader {
    /// The directions of body and front wheels, as unit vectors.
    body: Velocity,
    wheels: Velocity,
    /// How far the path parameter is behind the time of the leader, s.
    lag: f64,
    /// P, where the steering has kept it from the reference.
    beside: Option<Position>,
    /// The speed of the front axle as a share of that of P.
    axle_share: f64,
}

/// The speed of the front axle, m/s, and the angles by which body and wheels turn, rad/s.
#[derive(Clone, Copy, Debug)]
struct LeaderMotion {
    axle: f64,
    body_turn: f64,
    wheels_turn: f64,
}

/// The vector turned to the left by an angle, rad.
fn turned(vector: &Velocity, angle: f64) -> Velocity {
    let by = direction(angle);
    Velocity::new(
        by.x * vector.x - by.y * vector.y,
        by.y * vector.x + by.x * vector.y,
    )
}

fn left(vector: &Velocity) -> Velocity {
    Velocity::new(-vector.y, vector.x)
}

impl Leader {
    /// Straight along a velocity; none where that has no direction.
    pub(super) fn along(velocity: &Velocity) -> Option<Self> {
        let speed = sqrt(velocity.norm_squared());
        (speed > 0.0 && speed.is_finite()).then(|| Self {
            body: velocity / speed,
            wheels: velocity / speed,
            lag: 0.0,
            beside: None,
            axle_share: 1.0,
        })
    }

    /// The leader at `time` (s, its own); then it moves on by a step.
    pub(super) fn step(
        &mut self,
        time: f64,
        reference: &Reference,
        config: &GovernorConfig,
    ) -> Sample {
        let path = time - self.lag;
        let here = reference.at(path);
        let free = Sample {
            time,
            lag: self.lag,
            beside: self.beside.map(|point| (point, Velocity::zeros())),
            rate: 1.0,
            by: self.beside.map(|_| SlowedBy::Steering),
        };
        let speed = sqrt(here.velocity.norm_squared());
        if !(speed >= STANDS && speed.is_finite()) {
            return free;
        }
        if self.beside.is_none() {
            let motion = self.towards(&here.velocity, config);
            let moved = self.moved(&motion);
            let reverses = motion.axle < -BACKWARD * speed;
            let is_steered = fabs(moved.steering()) <= ROUNDING * config.limits.max_steering;
            if is_steered && (!reverses || config.limits.max_reverse_speed > 0.0) {
                let (rate, by) = self.takes(&motion, speed, here.position, config);
                *self = Self {
                    axle_share: motion.axle / speed,
                    ..moved
                };
                return Sample { rate, by, ..free };
            }
            self.beside = here.position;
        }
        let Some(point) = self.beside else {
            return free;
        };
        let wanted = self.heads_for(reference, path, &here, &point, config);
        let motion = self.steered(&wanted, config);
        let velocity = self.point_velocity(&motion, config);
        let (rate, by) = self.takes(&motion, speed, Some(point), config);
        let sample = Sample {
            beside: Some((point, velocity)),
            rate,
            by: by.or(Some(SlowedBy::Steering)),
            ..free
        };
        *self = Self {
            axle_share: motion.axle / speed,
            ..self.moved(&motion)
        };
        let point = point + STEP * velocity;
        let advances = advance(reference, path, &here, &point);
        self.lag += STEP - advances;
        self.beside = Some(point);
        self.join(reference, time + STEP - self.lag, &velocity, config);
        sample
    }

    /// The motion that gives P this velocity.
    fn towards(&self, velocity: &Velocity, config: &GovernorConfig) -> LeaderMotion {
        let axle = self.wheels.dot(velocity);
        LeaderMotion {
            axle,
            body_turn: axle * self.body.perp(&self.wheels) / config.limits.wheelbase,
            wheels_turn: self.wheels.perp(velocity) / config.law.point_distance(),
        }
    }

    /// The forward motion nearest to this velocity of P that the wheels can be steered for, at the
    /// same speed of P. Some of the steering is left for corrections.
    fn steered(&self, velocity: &Velocity, config: &GovernorConfig) -> LeaderMotion {
        let limits = &config.limits;
        let mut motion = self.towards(velocity, config);
        let speed = sqrt(velocity.norm_squared());
        let p = config.law.point_distance();
        if motion.axle < 0.0 {
            motion = LeaderMotion {
                axle: 0.0,
                body_turn: 0.0,
                wheels_turn: (speed / p).copysign(motion.wheels_turn),
            };
        }
        let fastest = USABLE * limits.max_steering_rate;
        let rate = (motion.wheels_turn - motion.body_turn).clamp(-fastest, fastest);
        let steering = self.steering();
        let most = USABLE * limits.max_steering;
        let next = steering + rate * STEP;
        if fabs(next) > most {
            // To the largest angle, and round the smallest circle: the axle as fast as P needs
            // it for its speed.
            let end = most.copysign(next);
            let rate = (end - steering) / STEP;
            let turn = sin(end) / limits.wheelbase;
            let square = 1.0 + p * p * turn * turn;
            let linear = p * p * turn * rate;
            let rest = p * p * rate * rate - speed * speed;
            let root = sqrt((linear * linear - square * rest).max(0.0));
            motion.axle = ((root - linear) / square).max(0.0);
            motion.body_turn = motion.axle * turn;
            motion.wheels_turn = motion.body_turn + rate;
        } else {
            motion.wheels_turn = motion.body_turn + rate;
        }
        motion
    }

    fn point_velocity(&self, motion: &LeaderMotion, config: &GovernorConfig) -> Velocity {
        let across = config.law.point_distance() * motion.wheels_turn;
        motion.axle * self.wheels + across * left(&self.wheels)
    }

    /// The highest rate of this motion with P at `point` and at most at `speed`, and what limits
    /// it.
    fn takes(
        &self,
        motion: &LeaderMotion,
        speed: f64,
        point: Option<Position>,
        config: &GovernorConfig,
    ) -> (f64, Option<SlowedBy>) {
        let limits = &config.limits;
        let mut most = (1.0, None);
        let mut allows = |rate: f64, by: SlowedBy| {
            if rate < most.0 {
                most = (rate, Some(by));
            }
        };
        let reserve = SPEED_RESERVE.min(SPEED_RESERVE_PART * limits.max_speed);
        allows((limits.max_speed - reserve) / speed, SlowedBy::Speed);
        let rear = motion.axle * self.body.dot(&self.wheels);
        let lateral = fabs(rear * motion.body_turn);
        let grip = sqrt(USABLE * limits.max_lateral_acceleration / lateral);
        allows(grip, SlowedBy::Tyres);
        let steering_rate = fabs(motion.wheels_turn - motion.body_turn);
        let servo = USABLE * limits.max_steering_rate / steering_rate;
        allows(servo, SlowedBy::SteeringRate);
        // Wheels that turn away from where P goes stop the car, in a corner at once.
        let change = fabs(motion.axle / speed - self.axle_share) * speed / STEP;
        let motor = sqrt(USABLE * limits.max_acceleration / change);
        allows(motor, SlowedBy::Steering);
        if let (Some(room), Some(point)) = (&config.room, point) {
            let front = config.law.front_axle_distance();
            let centre = point - config.law.point_distance() * self.wheels - front * self.body;
            let rear_to_centre = limits.wheelbase - front;
            let across = rear_to_centre * motion.body_turn;
            let velocity = rear * self.body + across * left(&self.body);
            let pace = sqrt(velocity.norm_squared());
            if pace > 0.0 {
                let stops = room.speed(&centre, &velocity, motion.body_turn);
                allows(stops / pace, SlowedBy::Geofence);
            }
        }
        most
    }

    /// This car a step later.
    fn moved(&self, motion: &LeaderMotion) -> Self {
        let body = turned(&self.body, motion.body_turn * STEP);
        let wheels = turned(&self.wheels, motion.wheels_turn * STEP);
        Self {
            // Rounding does not add up.
            body: body / sqrt(body.norm_squared()),
            wheels: wheels / sqrt(wheels.norm_squared()),
            ..*self
        }
    }

    fn steering(&self) -> f64 {
        atan2(self.body.perp(&self.wheels), self.body.dot(&self.wheels))
    }

    /// The velocity with which P would come nearer to the path, or to the circle round a bend
    /// that is too tight.
    fn heads_for(
        &self,
        reference: &Reference,
        path: f64,
        here: &ReferencePoint,
        point: &Position,
        config: &GovernorConfig,
    ) -> Velocity {
        let speed = sqrt(here.velocity.norm_squared());
        let along = here.velocity / speed;
        let across = left(&along);
        let wide = bend_offset(reference, path, config.least_radius());
        let off = |position: Position| (position - point).dot(&across);
        let away = here.position.map_or(0.0, off) + wide;
        let aim = AIM * along + away * across;
        aim * (speed / sqrt(aim.norm_squared()))
    }

    /// Ends the departure where P is on the path again.
    fn join(
        &mut self,
        reference: &Reference,
        path: f64,
        velocity: &Velocity,
        config: &GovernorConfig,
    ) {
        let here = reference.at(path);
        let (Some(point), Some(position)) = (self.beside, here.position) else {
            return;
        };
        let away = point - position;
        let sine = velocity.perp(&here.velocity);
        let product = sqrt(velocity.norm_squared() * here.velocity.norm_squared());
        let is_aligned = fabs(sine) < ALIGNED * product && velocity.dot(&here.velocity) > 0.0;
        if away.norm_squared() < JOINS * JOINS
            && is_aligned
            && bend_offset(reference, path, config.least_radius()) == 0.0
        {
            self.beside = None;
        }
    }
}

/// The advance of the path parameter in a step that ends with P at `point`, s: to the path
/// point beside P. It only moves forward, at most in real time.
fn advance(reference: &Reference, path: f64, here: &ReferencePoint, point: &Position) -> f64 {
    let Some(position) = here.position else {
        return STEP;
    };
    let speed = sqrt(here.velocity.norm_squared());
    let along = here.velocity / speed;
    let away = point - position;
    // The path point beside a P on the outside of a bend moves more slowly than P.
    let next = reference.at(path + STEP).velocity;
    let turn = atan2(along.perp(&next), along.dot(&next)) / STEP;
    let slope = (speed - turn * left(&along).dot(&away)).clamp(0.25 * speed, 4.0 * speed);
    (along.dot(&away) / slope).clamp(0.0, STEP)
}

/// The path is looked at in this many pieces before and behind a place.
const PIECES: u32 = 14;
/// The longest time for a piece, s.
const LONGEST: f64 = 0.5;

/// The distance of the widened path from the reference at `path` (s), to the left, in m: 0 where
/// the bend is not too tight.
///
/// The bend is that of a quarter of the smallest circle, of this radius (m). A path that turns by
/// more than a right angle on that way is one of a smaller radius; the widened path goes round the
/// same centre. A single corner is not: a car goes through it.
fn bend_offset(reference: &Reference, path: f64, smallest: f64) -> f64 {
    let half = FRAC_PI_4 * smallest;
    let (ahead, way_ahead) = turns(reference, path, 1.0, half);
    let (behind, way_behind) = turns(reference, path, -1.0, half);
    let turn = ahead + behind;
    let radius = (way_ahead + way_behind) / fabs(turn);
    (radius - smallest).min(0.0).copysign(-turn)
}

/// The angle by which the reference turns on this way (m) after `path` (s), or before it; and the
/// way, which is shorter at the beginning and where the reference is slow.
fn turns(reference: &Reference, path: f64, sense: f64, way: f64) -> (f64, f64) {
    let piece = way / f64::from(PIECES);
    let mut at = path;
    let mut velocity = reference.at(at).velocity;
    let (mut angle, mut covered) = (0.0, 0.0);
    for _ in 0..PIECES {
        let speed = sqrt(velocity.norm_squared());
        let time = (piece / speed).min(LONGEST);
        at += sense * time;
        if at < 0.0 {
            break;
        }
        let next = reference.at(at).velocity;
        if !(moves(&velocity) && moves(&next)) {
            // It begins or ends here: no bend.
            covered = way;
            break;
        }
        angle += atan2(velocity.perp(&next), velocity.dot(&next));
        covered += time * speed;
        velocity = next;
    }
    (sense * angle, covered)
}

fn moves(velocity: &Velocity) -> bool {
    velocity.norm_squared() >= STANDS * STANDS
}
