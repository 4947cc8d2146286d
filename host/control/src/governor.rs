//! The reference governor: a reference that asks too much is followed more slowly.
//!
//! The reference is a function of its own time, the path parameter s. The governor lets s advance
//! with a rate between 0 and 1, and slower than time where the car could not follow: an ideal car
//! that rolls without slip is moved along the reference, ahead of s, and tells which speed,
//! lateral acceleration, steering angle and steering rate the reference takes. These depend on
//! the reference alone, so a reference that the car can follow is passed on as it is, to the bit.

use libm::{atan2, fabs, sqrt, tan};

use crate::{FrontPointLaw, Limits, Position, Reference, ReferencePoint, Velocity, direction};

/// The fastest change of the rate, s⁻¹.
const SLOPE: f64 = 1.0;
/// How far ahead of s the ideal car is, s: from a rate of 1, s stops within 1 / (2 `SLOPE`).
const AHEAD: f64 = 0.6;
/// The steps of the ideal car, s.
const STEP: f64 = 0.02;
/// The steps from s to the ideal car.
const STEPS: usize = (AHEAD / STEP) as usize;
/// The part of a limit that the reference may take; the rest is for corrections.
const USABLE: f64 = 0.95;
/// Where the steering angle ends, the reference turns at least by this much faster than a car
/// that creeps with its wheels at their limit.
const TURNS_FASTER: f64 = 1.1;
/// The reference stands below this speed, m/s.
const STANDS: f64 = 0.02;

/// Why a reference is slowed down.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SlowedBy {
    /// The lateral acceleration of the car.
    Tyres,
    /// Its steering angle, which slowing down only makes less wrong.
    Steering,
    /// Its steering rate.
    SteeringRate,
    /// Its speed.
    Speed,
    /// P, which is far behind.
    Behind,
}

impl SlowedBy {
    /// The word for it.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Tyres => "tyres",
            Self::Steering => "steering",
            Self::SteeringRate => "steering-rate",
            Self::Speed => "speed",
            Self::Behind => "behind",
        }
    }
}

/// The settings of a [`Governor`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GovernorConfig {
    /// The law, which places P.
    pub law: FrontPointLaw,
    /// What the car may do.
    pub limits: Limits,
    /// The distance of P behind its reference from which on s slows down, in m; at twice the
    /// distance it waits.
    pub behind: f64,
}

/// Lets the path parameter of a reference advance as fast as the car can follow.
#[derive(Clone, Debug, PartialEq)]
pub struct Governor {
    config: GovernorConfig,
    /// Time of the drive at the last tick, s.
    time: f64,
    /// The path parameter at that time, s.
    path: f64,
    /// How far it is behind the time, s.
    delay: f64,
    rate: f64,
    /// The change of the rate in the last tick, s⁻¹.
    slope: f64,
    slowed_by: Option<SlowedBy>,
    car: Option<IdealCar>,
    /// The path parameter of the ideal car in steps.
    step: u64,
    /// The highest rates at the steps that lie before the ideal car, the newest last.
    allowed: [Allowed; STEPS + 1],
}

#[derive(Clone, Copy, Debug, PartialEq)]
struct Allowed {
    path: f64,
    rate: f64,
    by: Option<SlowedBy>,
}

const FREE: Allowed = Allowed {
    path: f64::NEG_INFINITY,
    rate: 1.0,
    by: None,
};

/// A car without slip whose P is on the reference.
#[derive(Clone, Copy, Debug, PartialEq)]
struct IdealCar {
    /// The directions of body and front wheels, as unit vectors.
    body: Velocity,
    wheels: Velocity,
}

/// The vector turned to the left by an angle, rad.
fn turned(vector: &Velocity, angle: f64) -> Velocity {
    let by = direction(angle);
    Velocity::new(
        by.x * vector.x - by.y * vector.y,
        by.y * vector.x + by.x * vector.y,
    )
}

impl Governor {
    /// A governor at the start of a reference.
    #[must_use]
    pub const fn new(config: GovernorConfig) -> Self {
        Self {
            config,
            time: 0.0,
            path: 0.0,
            delay: 0.0,
            rate: 1.0,
            slope: 0.0,
            slowed_by: None,
            car: None,
            step: 0,
            allowed: [FREE; STEPS + 1],
        }
    }

    /// Back to the start of the reference.
    pub const fn reset(&mut self) {
        *self = Self::new(self.config);
    }

    /// The path parameter at `time` (s since the start of the drive), which is not before the
    /// last tick; the rate stays as it is until the next tick.
    #[must_use]
    pub fn path_at(&self, time: f64) -> f64 {
        let elapsed = (time - self.time).max(0.0);
        (time - (self.delay + elapsed * (1.0 - self.rate))).max(self.path)
    }

    /// The rate at which the path parameter advances, 0 to 1.
    #[must_use]
    pub const fn rate(&self) -> f64 {
        self.rate
    }

    /// Why the reference is followed more slowly, if it is.
    #[must_use]
    pub const fn slowed_by(&self) -> Option<SlowedBy> {
        self.slowed_by
    }

    /// A tick at `time` (s since the start of the drive) with P at `point`. The path parameter
    /// advances as was decided in the tick before.
    pub fn advance(&mut self, time: f64, reference: &Reference, point: &Position) -> f64 {
        let elapsed = (time - self.time).max(0.0);
        let path = self.path_at(time);
        self.delay += elapsed * (1.0 - self.rate);
        (self.time, self.path) = (time, path);
        let wanted = self.wanted(reference, point);
        let change = SLOPE * elapsed;
        let rate = wanted.rate.clamp(self.rate - change, self.rate + change);
        let rate = rate.clamp(0.0, 1.0);
        self.slope = if elapsed > 0.0 {
            (rate - self.rate) / elapsed
        } else {
            0.0
        };
        self.rate = rate;
        self.slowed_by = match wanted.by {
            Some(by) => Some(by),
            // It is still on its way back.
            None if rate < 1.0 => self.slowed_by,
            None => None,
        };
        path
    }

    /// The governed reference `ahead` seconds after the last tick.
    #[must_use]
    pub fn at(&self, reference: &Reference, ahead: f64) -> ReferencePoint {
        if self.rate >= 1.0 && self.slope >= 0.0 {
            return reference.at(self.path + ahead);
        }
        // The rate goes on to change for a moment: that is the acceleration of the reference.
        const CHANGES: f64 = 0.1;
        let during = ahead.clamp(-CHANGES, CHANGES);
        let rate = (self.rate + self.slope * during).clamp(0.0, 1.0);
        let way = 0.5 * (self.rate + rate) * during + rate * (ahead - during);
        let ReferencePoint { position, velocity } = reference.at(self.path + way);
        ReferencePoint {
            position,
            velocity: rate * velocity,
        }
    }

    /// The highest rate now, and why.
    fn wanted(&mut self, reference: &Reference, point: &Position) -> Allowed {
        self.look(reference);
        let mut wanted = FREE;
        for allowed in &self.allowed {
            let away = allowed.path - self.path;
            if away < -STEP || allowed.by.is_none() {
                continue;
            }
            // From this rate it is reached in time.
            let rate = sqrt(allowed.rate * allowed.rate + 2.0 * SLOPE * away.max(0.0));
            if rate < wanted.rate {
                wanted = Allowed { rate, ..*allowed };
            }
        }
        let here = reference.at(self.path);
        if let Some(position) = here.position {
            let to_reference = position - point;
            let away = sqrt(to_reference.norm_squared());
            let is_behind = to_reference.dot(&here.velocity) >= 0.0;
            let rate = (2.0 - away / self.config.behind).clamp(0.0, 1.0);
            if is_behind && rate < wanted.rate {
                wanted = Allowed {
                    rate,
                    by: Some(SlowedBy::Behind),
                    ..wanted
                };
            }
        }
        wanted
    }

    /// Moves the ideal car on until it is ahead of the path parameter.
    fn look(&mut self, reference: &Reference) {
        while (self.step as f64) * STEP <= self.path + AHEAD {
            let path = self.step as f64 * STEP;
            let velocity = reference.at(path).velocity;
            let (rate, by) = match self.car.as_mut() {
                Some(car) => car.takes(&velocity, &self.config),
                None => {
                    self.car = IdealCar::along(&velocity);
                    (1.0, None)
                }
            };
            self.allowed.rotate_left(1);
            self.allowed[STEPS] = Allowed { path, rate, by };
            self.step += 1;
        }
    }
}

impl IdealCar {
    /// Straight along a velocity; none where that has no direction.
    fn along(velocity: &Velocity) -> Option<Self> {
        let speed = sqrt(velocity.norm_squared());
        (speed > 0.0 && speed.is_finite()).then(|| Self {
            body: velocity / speed,
            wheels: velocity / speed,
        })
    }

    /// The highest rate at which the car lets P move with this velocity, and what limits it. Then
    /// P moves with it for a step.
    fn takes(&mut self, velocity: &Velocity, config: &GovernorConfig) -> (f64, Option<SlowedBy>) {
        let limits = &config.limits;
        let speed = sqrt(velocity.norm_squared());
        if !(speed >= STANDS && speed.is_finite()) {
            return (1.0, None);
        }
        let p = config.law.point_distance();
        let axle = self.wheels.dot(velocity);
        let wheels_turn = self.wheels.perp(velocity) / p;
        let sine = self.body.perp(&self.wheels);
        let cosine = self.body.dot(&self.wheels);
        let body_turn = axle * sine / limits.wheelbase;
        let rear = axle * cosine;
        let steering = atan2(sine, cosine);

        let mut most = (1.0, None);
        let mut allows = |rate: f64, by: SlowedBy| {
            if rate < most.0 {
                most = (rate, Some(by));
            }
        };
        allows(limits.max_speed / speed, SlowedBy::Speed);
        let lateral = fabs(rear * body_turn);
        allows(
            sqrt(USABLE * limits.max_lateral_acceleration / lateral),
            SlowedBy::Tyres,
        );
        let steering_rate = fabs(wheels_turn - body_turn);
        allows(
            USABLE * limits.max_steering_rate / steering_rate,
            SlowedBy::SteeringRate,
        );
        let beyond = fabs(steering) / limits.max_steering - 1.0;
        if beyond > 0.0 {
            // Not slower than the car turns round: it would overtake its reference.
            let turns = tan(limits.max_steering) / limits.wheelbase * limits.creep_speed;
            let least = TURNS_FASTER * turns / fabs(wheels_turn).max(fabs(body_turn));
            allows((1.0 - 2.0 * beyond).max(least), SlowedBy::Steering);
        }

        self.body = turned(&self.body, body_turn * STEP);
        self.wheels = turned(&self.wheels, wheels_turn * STEP);
        // What the car cannot steer, it does not; rounding does not add up either.
        self.body /= sqrt(self.body.norm_squared());
        self.wheels /= sqrt(self.wheels.norm_squared());
        let sine = self.body.perp(&self.wheels);
        let cosine = self.body.dot(&self.wheels);
        let steering = atan2(sine, cosine);
        let widest = 1.5 * limits.max_steering;
        if fabs(steering) > widest {
            self.wheels = turned(&self.body, steering.clamp(-widest, widest));
        }
        most
    }
}
