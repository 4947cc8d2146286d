//! From what the law wants to what the car can do.
//!
//! The law is exact for a car without limits. This file keeps it inside them:
//! speed, acceleration, steering angle and rate, no reverse unless enabled, and
//! a way round when P should move where the car does not point.

use libm::{atan, fabs, sqrt, tan};

use crate::{FrontPointLaw, Motion, Singularity, Velocity, angle_between, direction};

/// What the car may do, in SI units and radians.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limits {
    /// Fastest forward, m/s.
    pub max_speed: f64,
    /// Fastest in reverse, m/s; 0 disables reverse.
    pub max_reverse_speed: f64,
    /// Largest change of speed, m/s².
    pub max_acceleration: f64,
    /// Largest acceleration to the side, m/s²; below μg, or the tyres slide.
    pub max_lateral_acceleration: f64,
    /// Distance between the axles, m: with steering and speed it tells the
    /// acceleration to the side.
    pub wheelbase: f64,
    /// Largest steering angle to either side.
    pub max_steering: f64,
    /// Largest steering rate.
    pub max_steering_rate: f64,
    /// Speed at which the car turns round, m/s.
    pub creep_speed: f64,
    /// A wanted velocity of P below this is standstill, m/s.
    pub standstill_speed: f64,
}

impl Limits {
    /// For the paper's car.
    #[must_use]
    pub const fn paper() -> Self {
        Self {
            max_speed: 1.5,
            max_reverse_speed: 0.0,
            max_acceleration: 2.0,
            max_lateral_acceleration: 2.0,
            wheelbase: 0.26,
            max_steering: 0.45,
            max_steering_rate: 5.0,
            creep_speed: 0.3,
            standstill_speed: 0.02,
        }
    }

    /// The steering angle at which the acceleration to the side reaches its limit,
    /// at this speed (m/s).
    #[must_use]
    pub fn steering_at(&self, speed: f64) -> f64 {
        atan(self.max_lateral_acceleration * self.wheelbase / (speed * speed))
    }

    /// The speed at which the acceleration to the side reaches its limit, with
    /// this steering angle (rad): that of a car that does not slip, v² tan δ/L.
    /// One that understeers, as the paper's does, stays below. Straight on there is
    /// no such speed: infinity.
    #[must_use]
    pub fn speed_in_bend(&self, steering: f64) -> f64 {
        let curvature = fabs(tan(steering)) / self.wheelbase;
        sqrt(self.max_lateral_acceleration / curvature)
    }
}

/// P's wanted velocity this far off the car's heading starts a turn: 90 degrees,
/// where the law would reverse.
const TURN_FROM: f64 = core::f64::consts::FRAC_PI_2;
/// And this far off ends it: 75 degrees. In between nothing changes, so that
/// noise cannot make the car dither.
const TURN_UNTIL: f64 = 1.31;
/// A turn that has gone this far chases a velocity that turns as fast as the car
/// does; from the other side they meet.
const TURN_AT_MOST: f64 = 1.5 * core::f64::consts::PI;

/// Speed and steering for the car.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Actuation {
    /// Speed of G, m/s.
    pub speed: f64,
    /// Steering angle, rad.
    pub steering: f64,
    /// Rate at which it got there, rad/s.
    pub steering_rate: f64,
}

/// The law with its steering integrator and the car's limits.
#[derive(Clone, Debug, PartialEq)]
pub struct LimitedLaw {
    law: FrontPointLaw,
    limits: Limits,
    actuation: Actuation,
    turning: Option<Turn>,
}

/// A turn towards a velocity behind the car.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Turn {
    side: Side,
    /// How far the car has turned, to either side.
    turned: f64,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Side {
    Left,
    Right,
}

impl Side {
    fn of(angle: f64) -> Self {
        if angle < 0.0 { Self::Right } else { Self::Left }
    }

    const fn other(self) -> Self {
        match self {
            Self::Left => Self::Right,
            Self::Right => Self::Left,
        }
    }
}

impl LimitedLaw {
    /// A car that stands with its wheels straight.
    #[must_use]
    pub const fn new(law: FrontPointLaw, limits: Limits) -> Self {
        Self {
            law,
            limits,
            actuation: Actuation {
                speed: 0.0,
                steering: 0.0,
                steering_rate: 0.0,
            },
            turning: None,
        }
    }

    /// The law.
    #[must_use]
    pub const fn law(&self) -> &FrontPointLaw {
        &self.law
    }

    /// What the car was last told.
    #[must_use]
    pub const fn actuation(&self) -> Actuation {
        self.actuation
    }

    /// Whether the car is turning round.
    #[must_use]
    pub const fn is_turning_round(&self) -> bool {
        self.turning.is_some()
    }

    /// Starts over from standstill; the steering stays where it is.
    pub fn reset(&mut self) {
        self.actuation.speed = 0.0;
        self.actuation.steering_rate = 0.0;
        self.turning = None;
    }

    /// One step of `period` seconds that moves P with `wanted` (world frame, m/s)
    /// as well as the limits allow.
    ///
    /// # Errors
    ///
    /// Where the law has no answer; the actuation then stays what it was.
    pub fn step(
        &mut self,
        motion: &Motion,
        measured_speed: f64,
        wanted: &Velocity,
        period: f64,
    ) -> Result<Actuation, Singularity> {
        let limits = self.limits;
        let wanted_speed = wanted.norm();
        if !wanted_speed.is_finite() {
            return Err(Singularity::NotFinite);
        }
        // The direction of P's motion is worth more than its pace.
        let wanted = if wanted_speed > limits.max_speed {
            wanted * (limits.max_speed / wanted_speed)
        } else {
            *wanted
        };
        let (speed, rate) = if wanted_speed < limits.standstill_speed {
            self.turning = None;
            (0.0, self.standing_rate(motion, measured_speed, &wanted)?)
        } else if let Some(side) = self.turn_round(motion, &wanted, period) {
            let rate = match side {
                Side::Left => limits.max_steering_rate,
                Side::Right => -limits.max_steering_rate,
            };
            (limits.creep_speed, rate)
        } else {
            let command = self.law.command(motion, self.actuation.steering, &wanted)?;
            (command.speed, command.steering_rate)
        };
        Ok(self.apply(speed, rate, period))
    }

    /// Keeps the speed that the next step starts from, and what it was told last,
    /// at `most` m/s in either direction.
    pub const fn cap_speed(&mut self, most: f64) {
        self.actuation.speed = self.actuation.speed.clamp(-most, most);
    }

    /// One step of `period` seconds that slows down, wheels held.
    pub fn slow_down(&mut self, deceleration: f64, period: f64) -> Actuation {
        let change = deceleration * period;
        let speed = self.actuation.speed;
        self.turning = None;
        self.actuation = Actuation {
            speed: speed - speed.clamp(-change, change),
            steering: self.actuation.steering,
            steering_rate: 0.0,
        };
        self.actuation
    }

    /// The steering rate of a car that should stand.
    ///
    /// Held once it does: the integrator has nothing to steer by, and a gyro
    /// bias b would wind it up by -(`l_f`/p + 1) b.
    fn standing_rate(
        &self,
        motion: &Motion,
        measured_speed: f64,
        wanted: &Velocity,
    ) -> Result<f64, Singularity> {
        let stands =
            self.actuation.speed == 0.0 || measured_speed.abs() < self.limits.standstill_speed;
        if stands {
            return Ok(0.0);
        }
        Ok(self
            .law
            .command(motion, self.actuation.steering, wanted)?
            .steering_rate)
    }

    /// To which side the car turns round, if it does.
    fn turn_round(&mut self, motion: &Motion, wanted: &Velocity, period: f64) -> Option<Side> {
        if self.limits.max_reverse_speed > 0.0 {
            return None;
        }
        let off_heading = angle_between(&direction(motion.yaw), wanted);
        self.turning = match self.turning {
            None => {
                let wheels = motion.yaw + self.actuation.steering;
                let off_wheels = angle_between(&direction(wheels), wanted);
                let behind = off_wheels.abs() > TURN_FROM || off_heading.abs() > TURN_FROM;
                behind.then_some(Turn {
                    side: Side::of(off_heading),
                    turned: 0.0,
                })
            }
            Some(turn) if off_heading.abs() > TURN_UNTIL => {
                // Straight behind, either side will do, but it must stay the
                // same one, unless it leads nowhere.
                let turned = turn.turned + motion.yaw_rate * period;
                Some(if turned.abs() > TURN_AT_MOST {
                    Turn {
                        side: turn.side.other(),
                        turned: 0.0,
                    }
                } else {
                    Turn { turned, ..turn }
                })
            }
            Some(_) => None,
        };
        self.turning.map(|turn| turn.side)
    }

    fn apply(&mut self, speed: f64, rate: f64, period: f64) -> Actuation {
        let limits = self.limits;
        let rate = rate.clamp(-limits.max_steering_rate, limits.max_steering_rate);
        // The integrator is limited itself, so it cannot wind up beyond.
        let steering = (self.actuation.steering + rate * period)
            .clamp(-limits.max_steering, limits.max_steering);
        let change = limits.max_acceleration * period;
        // A car that can't slow down as fast as the wheels turn in, turns them in
        // as fast as it slows down.
        let slowest = (fabs(self.actuation.speed) - change).max(0.0);
        let widest = limits
            .steering_at(slowest)
            .max(fabs(self.actuation.steering));
        let steering = steering.clamp(-widest, widest);
        let in_bend = limits.speed_in_bend(steering);
        let speed = speed
            .clamp(-limits.max_reverse_speed, limits.max_speed)
            .clamp(-in_bend, in_bend)
            .clamp(self.actuation.speed - change, self.actuation.speed + change);
        self.actuation = Actuation {
            speed,
            steering,
            steering_rate: (steering - self.actuation.steering) / period,
        };
        self.actuation
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PERIOD: f64 = 0.01;

    fn limited(limits: Limits) -> LimitedLaw {
        LimitedLaw::new(FrontPointLaw::new(0.1368, 0.35, 0.26).unwrap(), limits)
    }

    fn standing(yaw: f64) -> Motion {
        Motion {
            yaw,
            yaw_rate: 0.0,
            sideslip: 0.0,
        }
    }

    #[test]
    fn a_gyro_bias_does_not_wind_up_the_steering_of_a_standing_car() {
        let mut law = limited(Limits::paper());
        let biased = Motion {
            yaw_rate: 0.05,
            ..standing(0.0)
        };
        for _ in 0..10_000 {
            law.step(&biased, 0.0, &Velocity::zeros(), PERIOD).unwrap();
        }
        assert_eq!(law.actuation().steering, 0.0);
    }

    #[test]
    fn steering_stops_at_its_limit_and_leaves_it_at_once() {
        let mut law = limited(Limits::paper());
        for _ in 0..1000 {
            law.step(&standing(0.0), 0.5, &Velocity::new(0.05, 0.5), PERIOD)
                .unwrap();
        }
        assert_eq!(law.actuation().steering, Limits::paper().max_steering);
        let after = law
            .step(&standing(0.0), 0.5, &Velocity::new(0.5, -0.2), PERIOD)
            .unwrap();
        assert!(after.steering < Limits::paper().max_steering);
    }

    #[test]
    fn speed_changes_no_faster_than_allowed() {
        let mut law = limited(Limits::paper());
        let mut last = 0.0;
        for step in 0..400 {
            let wanted = Velocity::new(if step < 200 { 5.0 } else { 0.0 }, 0.0);
            let speed = law
                .step(&standing(0.0), last, &wanted, PERIOD)
                .unwrap()
                .speed;
            assert!((speed - last).abs() <= 2.0 * PERIOD + 1e-12);
            assert!((0.0..=1.5).contains(&speed));
            last = speed;
        }
        assert_eq!(last, 0.0);
    }

    #[test]
    fn a_velocity_behind_the_car_is_reached_going_forward() {
        for degrees in [91.0, 135.0, 179.0, 180.0, -180.0, -135.0, -91.0_f64] {
            let mut law = limited(Limits::paper());
            let mut yaw = 0.0;
            let wanted = 0.5 * direction(degrees.to_radians());
            let mut reached = None;
            for step in 0..3000 {
                let now = law.step(&standing(yaw), 0.3, &wanted, PERIOD).unwrap();
                assert!(now.speed >= 0.0, "{degrees}: reversed");
                // The car rolls without slip.
                yaw += now.speed * libm::tan(now.steering) / 0.26 * PERIOD;
                if angle_between(&direction(yaw), &wanted).abs() < 0.1 {
                    reached.get_or_insert(step);
                }
            }
            assert!(reached.is_some(), "{degrees}: never turned");
        }
    }

    #[test]
    fn the_side_of_a_turn_does_not_flicker_straight_behind() {
        let mut law = limited(Limits::paper());
        let mut yaw: f64 = 0.0;
        let mut sides = 0;
        let mut last = 0.0_f64;
        for step in 0..200 {
            let noise = if step % 2 == 0 { 0.02 } else { -0.02 };
            let wanted = -0.5 * direction(noise);
            let now = law.step(&standing(yaw), 0.3, &wanted, PERIOD).unwrap();
            if now.steering_rate * last < 0.0 {
                sides += 1;
            }
            if now.steering_rate != 0.0 {
                last = now.steering_rate;
            }
            yaw += now.speed * libm::tan(now.steering) / 0.26 * PERIOD;
        }
        assert_eq!(sides, 0);
    }

    #[test]
    fn reverse_is_only_driven_when_enabled() {
        let behind = Velocity::new(-0.5, 0.0);
        let mut forward_only = limited(Limits::paper());
        let mut either = limited(Limits {
            max_reverse_speed: 0.3,
            ..Limits::paper()
        });
        for _ in 0..100 {
            assert!(
                forward_only
                    .step(&standing(0.0), 0.0, &behind, PERIOD)
                    .unwrap()
                    .speed
                    >= 0.0
            );
            either.step(&standing(0.0), 0.0, &behind, PERIOD).unwrap();
        }
        assert_eq!(either.actuation().speed, -0.3);
    }

    #[test]
    fn in_a_bend_the_acceleration_to_the_side_bounds_the_speed() {
        let limits = Limits {
            max_speed: 5.0,
            ..Limits::paper()
        };
        let mut law = limited(limits);
        let mut largest: f64 = 0.0;
        for step in 0..2_000 {
            // Ever farther to the left of where the car points.
            let wanted = 3.0 * direction(f64::from(step) * 5e-4);
            let now = law.step(&standing(0.0), 0.5, &wanted, PERIOD).unwrap();
            let lateral = now.speed * now.speed * libm::tan(now.steering.abs()) / 0.26;
            largest = largest.max(lateral);
        }
        assert!(largest <= 2.0 + 1e-9, "{largest}");
        assert!(law.actuation().steering > 0.3);
        assert_eq!(limits.speed_in_bend(0.0), f64::INFINITY);
        let at_limit = limits.speed_in_bend(-0.45);
        assert!((at_limit - (2.0 * 0.26 / libm::tan(0.45)).sqrt()).abs() < 1e-12);
    }

    #[test]
    fn wheels_that_turn_in_quickly_keep_to_the_acceleration_to_the_side() {
        let mut law = limited(Limits::paper());
        for _ in 0..200 {
            law.step(&standing(0.0), 1.5, &Velocity::new(1.5, 0.0), PERIOD)
                .unwrap();
        }
        assert_eq!(law.actuation().speed, 1.5);
        for _ in 0..100 {
            let wanted = 1.5 * direction(core::f64::consts::FRAC_PI_4);
            let now = law.step(&standing(0.0), 1.5, &wanted, PERIOD).unwrap();
            let lateral = now.speed * now.speed * libm::tan(now.steering.abs()) / 0.26;
            assert!(lateral <= 2.0 + 1e-9, "{lateral}");
        }
        assert!(law.actuation().steering > 0.4);
    }

    #[test]
    fn a_velocity_that_is_no_number_changes_nothing() {
        let mut law = limited(Limits::paper());
        law.step(&standing(0.0), 0.0, &Velocity::new(0.5, 0.1), PERIOD)
            .unwrap();
        let before = law.clone();
        for wanted in [
            Velocity::new(f64::NAN, 0.0),
            Velocity::new(0.0, f64::INFINITY),
        ] {
            assert!(law.step(&standing(0.0), 0.0, &wanted, PERIOD).is_err());
            assert_eq!(law, before);
        }
    }
}
