//! The law within the limits of the car.
//!
//! The law is exact for a car without limits. [`LimitedLaw`] limits speed, acceleration,
//! steering angle and steering rate, drives in reverse only if that is enabled, and turns
//! the car around when the wanted velocity of P points behind it.

#[cfg(test)]
mod tests;

use libm::{atan, atanh, fabs, sqrt, tan};

use crate::{
    GRAVITY, SpeedDemand, SteeringDemand, VehicleParameters,
    law::{FrontPointLaw, Singularity, front_point_velocity},
    measurement::{Motion, Velocity, angle_between, direction},
};

/// Limits of speed, acceleration and steering, in SI units and radians.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limits {
    /// Largest speed forward, m/s.
    pub max_speed: f64,
    /// Largest speed in reverse, m/s; 0 disables reverse.
    pub max_reverse_speed: f64,
    /// Largest change of speed, m/s².
    pub max_acceleration: f64,
    /// Largest lateral acceleration, m/s²; it must stay below μg, or the tyres slide.
    pub max_lateral_acceleration: f64,
    /// Distance between the axles, m. Steering and speed give the lateral acceleration
    /// with it.
    pub wheelbase: f64,
    /// The part of the steering angle that the tyres' slip takes at that limit, rad: 0 for a
    /// car that neither understeers nor oversteers.
    pub slip: f64,
    /// Largest steering angle to either side, rad.
    pub max_steering: f64,
    /// Largest steering rate, rad/s.
    pub max_steering_rate: f64,
    /// Speed at which the car turns around, m/s.
    pub creep_speed: f64,
    /// A wanted velocity of P below this means standstill, m/s.
    pub standstill_speed: f64,
}

impl Limits {
    /// For the paper's car.
    pub const fn paper() -> Self {
        Self {
            max_speed: 1.5,
            max_reverse_speed: 0.0,
            max_acceleration: 2.0,
            max_lateral_acceleration: 2.0,
            wheelbase: 0.26,
            slip: 0.0,
            max_steering: 0.45,
            max_steering_rate: 5.0,
            creep_speed: 0.3,
            standstill_speed: 0.02,
        }
    }

    /// These limits for a car with the tyres of `vehicle`.
    ///
    /// In a steady bend both axles use the same part of their grip, and with saturating tyres
    /// the slip angles of front and rear differ by m/L (`l_r`/`C_f` - `l_f`/`C_r`) μg
    /// atanh(a/μg).
    #[must_use]
    pub fn with_tyres(self, vehicle: &VehicleParameters) -> Self {
        // Beyond it the slip of the model grows without bound.
        const MOST: f64 = 0.98;
        let [m, _, l_f, l_r, c_f, c_r] = vehicle.symbols();
        let grip = vehicle.friction * GRAVITY;
        let used = (self.max_lateral_acceleration / grip).min(MOST);
        let understeer = m / vehicle.wheelbase_m() * (l_r / c_f - l_f / c_r);
        Self {
            slip: understeer * grip * atanh(used),
            ..self
        }
    }

    /// The steering angle at which the lateral acceleration reaches its limit, at this speed
    /// (m/s), in rad: atan(a L/v²), and the part that the tyres' slip takes.
    pub fn steering_at(&self, speed: f64) -> f64 {
        let rolling = atan(self.max_lateral_acceleration * self.wheelbase / (speed * speed));
        (rolling + self.slip).max(0.0)
    }

    /// The speed at which the lateral acceleration reaches its limit, with this steering
    /// angle (rad), in m/s; infinite where it never does.
    pub fn speed_in_bend(&self, steering: f64) -> f64 {
        let rolling = (fabs(steering) - self.slip).max(0.0);
        let curvature = tan(rolling) / self.wheelbase;
        sqrt(self.max_lateral_acceleration / curvature)
    }
}

/// The angle between heading and wanted velocity of P at which a turn begins: 90 degrees,
/// where the law would reverse.
const TURN_FROM: f64 = core::f64::consts::FRAC_PI_2;
/// The angle at which a turn ends: 75 degrees. The hysteresis keeps noise from switching
/// it.
const TURN_UNTIL: f64 = 1.31;
/// The largest turn to one side: beyond it, the wanted velocity turns as fast as the car,
/// and a turn to the other side meets it.
const TURN_AT_MOST: f64 = 1.5 * core::f64::consts::PI;

/// A command of speed and steering.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Actuation {
    /// Speed of G, m/s.
    pub speed: f64,
    /// Steering angle, rad.
    pub steering: f64,
    /// Steering rate of the last step, rad/s.
    pub steering_rate: f64,
}

/// The law with its steering integrator and the limits of the car.
#[derive(Clone, Debug, PartialEq)]
pub struct LimitedLaw {
    law: FrontPointLaw,
    limits: Limits,
    actuation: Actuation,
    basis: Basis,
    turning: Option<Turn>,
}

/// What the last step of the law rested on.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Basis {
    motion: Motion,
    /// The angle of the front wheels, rad.
    wheels: f64,
    /// The lead over the actuators, as far as it was used.
    lead: Option<Lead>,
}

/// What a step may know beyond the velocity that is wanted of P.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Ahead {
    /// The velocity of the reference that P has overtaken, and which comes after it, in m/s.
    ///
    /// When P is ahead of its reference, the loop demands backward motion. A car that turns round
    /// for that has lost its reference: it brakes, unless the reference itself moves backward.
    pub overtaken: Option<Velocity>,
    /// The actuators, if their lags are compensated.
    pub lead: Option<Lead>,
}

/// The lead over the actuators' lags.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lead {
    /// The angle of the front wheels when the command acts, in rad.
    pub wheels: f64,
    /// The change of the commanded angle over a period, for each rad/s of the wheels, in s.
    pub steering: f64,
    /// What the speed commanded has to be above the speed that is wanted, in m/s.
    pub speed: f64,
}

/// A turn towards a velocity behind the car.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Turn {
    /// 1 to the left, -1 to the right.
    side: f64,
    /// The angle turned so far, rad; positive to the left.
    turned: f64,
}

impl LimitedLaw {
    /// A standing car with straight wheels.
    pub fn new(law: FrontPointLaw, limits: Limits) -> Self {
        Self {
            law,
            limits,
            actuation: Actuation::default(),
            basis: Basis::default(),
            turning: None,
        }
    }

    /// The law.
    pub const fn law(&self) -> &FrontPointLaw {
        &self.law
    }

    /// Goes on with another law: the steering angle and every other state stay.
    pub const fn set_law(&mut self, law: FrontPointLaw) {
        self.law = law;
    }

    /// The last command.
    pub const fn actuation(&self) -> Actuation {
        self.actuation
    }

    /// Whether the car turns around.
    pub const fn is_turning_round(&self) -> bool {
        self.turning.is_some()
    }

    /// The velocity that the last command gives P by the law, in m/s, after every limit; the lead
    /// over the actuators is taken off. Only after a step of the law.
    ///
    /// It is the wanted velocity where nothing limited that.
    pub fn point_velocity(&self) -> Velocity {
        let (basis, sent) = (&self.basis, &self.actuation);
        let (speed, rate) = match basis.lead {
            None => (sent.speed, sent.steering_rate),
            Some(lead) => {
                // A lead that a limit cut does not make a car of it that drives backward.
                let led = sent.speed - lead.speed;
                let speed = if led * sent.speed < 0.0 { 0.0 } else { led };
                (speed, (sent.steering - lead.wheels) / lead.steering)
            }
        };
        front_point_velocity(&self.law, &basis.motion, basis.wheels, speed, rate)
    }

    /// Restarts from standstill; the steering angle is kept.
    pub fn reset(&mut self) {
        self.actuation.speed = 0.0;
        self.actuation.steering_rate = 0.0;
        self.turning = None;
    }

    /// One step of `period` seconds that moves P with the velocity `wanted` (world frame,
    /// m/s), as far as the limits allow. `measured_speed` is that of the car, in m/s.
    ///
    /// # Errors
    ///
    /// [`Singularity`] where the law is singular; the actuation does not change then.
    pub fn step(
        &mut self,
        motion: &Motion,
        measured_speed: f64,
        wanted: &Velocity,
        period: f64,
    ) -> Result<Actuation, Singularity> {
        self.step_ahead(motion, measured_speed, wanted, &Ahead::default(), period)
    }

    /// Does a [`step`](Self::step) for a car of which more is known. With a [`Lead`], `motion` is
    /// that of the moment at which the command acts.
    ///
    /// # Errors
    ///
    /// [`Singularity`] where the law is singular; the actuation does not change then.
    pub fn step_ahead(
        &mut self,
        motion: &Motion,
        measured_speed: f64,
        wanted: &Velocity,
        ahead: &Ahead,
        period: f64,
    ) -> Result<Actuation, Singularity> {
        let limits = self.limits;
        let steering = ahead
            .lead
            .map_or(self.actuation.steering, |lead| lead.wheels);
        let wanted_speed = wanted.norm();
        if !wanted_speed.is_finite() {
            return Err(Singularity::NotFinite);
        }
        // The speed of P is limited, its direction is kept.
        let wanted = if wanted_speed > limits.max_speed {
            wanted * (limits.max_speed / wanted_speed)
        } else {
            *wanted
        };
        let mut basis = Basis {
            motion: *motion,
            wheels: steering,
            lead: None,
        };
        let is_slow = wanted_speed < limits.standstill_speed;
        let standing = is_slow.then_some(wanted);
        let standing = standing.or_else(|| self.overtakes(motion, steering, &wanted, ahead));
        let (speed, rate) = if let Some(wanted) = standing {
            self.turning = None;
            // The steering is held once the car stands: a gyro bias b would drive the integrator
            // with -(l_f/p + 1) b.
            let stands =
                self.actuation.speed == 0.0 || measured_speed.abs() < limits.standstill_speed;
            let rate = match stands {
                true => 0.0,
                false => self.law.command(motion, steering, &wanted)?.steering_rate,
            };
            (0.0, rate)
        } else if let Some(side) = self.turn_around(motion, steering, &wanted, period) {
            (limits.creep_speed, side * limits.max_steering_rate)
        } else {
            let command = self.law.command(motion, steering, &wanted)?;
            match ahead.lead {
                None => (command.speed, command.steering_rate),
                Some(lead) => {
                    let most = limits.max_steering_rate;
                    let angle =
                        lead.wheels + command.steering_rate.clamp(-most, most) * lead.steering;
                    let speed = match command.speed {
                        // The lead does not make a car that should stand or drive forward
                        // drive in reverse.
                        forward if forward >= 0.0 => (forward + lead.speed).max(0.0),
                        backward => (backward + lead.speed).min(0.0),
                    };
                    basis.lead = Some(Lead {
                        speed: speed - command.speed,
                        ..lead
                    });
                    (speed, (angle - self.actuation.steering) / period)
                }
            }
        };
        if !rate.is_finite() || !speed.is_finite() {
            return Err(Singularity::NotFinite);
        }
        self.basis = basis;
        Ok(self.apply(speed, rate, period))
    }

    /// One step of `period` seconds towards steering and speed that a controller outside
    /// demands, as far as the limits allow.
    ///
    /// # Errors
    ///
    /// [`Singularity::NotFinite`] for a demand that is not finite; the actuation does not
    /// change then.
    pub fn follow(
        &mut self,
        steering: SteeringDemand,
        speed: SpeedDemand,
        period: f64,
    ) -> Result<Actuation, Singularity> {
        let towards = |angle: f64| (angle - self.actuation.steering) / period;
        let rate = match steering {
            SteeringDemand::Angle(angle) => towards(angle),
            SteeringDemand::AngleWithin { angle, rate } => {
                let most = fabs(rate);
                towards(angle).max(-most).min(most)
            }
            SteeringDemand::Rate(rate) => rate,
        };
        let speed = match speed {
            // That of the rear axle, where the sideslip is not known.
            SpeedDemand::Speed(speed) | SpeedDemand::RearSpeed(speed) => speed,
            SpeedDemand::Acceleration(change) => self.actuation.speed + change * period,
        };
        if !rate.is_finite() || !speed.is_finite() {
            return Err(Singularity::NotFinite);
        }
        self.turning = None;
        Ok(self.apply(speed, rate, period))
    }

    /// Limits the last command, from which the next step starts, to `most` m/s in either
    /// direction.
    pub const fn cap_speed(&mut self, most: f64) {
        self.actuation.speed = self.actuation.speed.clamp(-most, most);
    }

    /// One step of `period` seconds that slows down with `deceleration` (m/s²) and holds the
    /// steering.
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

    /// The part of the wanted velocity across the wheels, for a car whose P has overtaken its
    /// reference: it brakes, and waits for it.
    fn overtakes(
        &self,
        motion: &Motion,
        steering: f64,
        wanted: &Velocity,
        ahead: &Ahead,
    ) -> Option<Velocity> {
        let reference = ahead.overtaken?;
        if self.limits.max_reverse_speed > 0.0 || self.turning.is_some() {
            return None;
        }
        let wheels = direction(motion.yaw + steering);
        let heading = direction(motion.yaw);
        let is_behind = |velocity: &Velocity| {
            angle_between(&wheels, velocity).abs() > TURN_FROM
                || angle_between(&heading, velocity).abs() > TURN_FROM
        };
        (is_behind(wanted) && !is_behind(&reference)).then(|| wanted - wanted.dot(&wheels) * wheels)
    }

    /// The side to which the car turns around, if it does: 1 to the left, -1 to the right.
    fn turn_around(
        &mut self,
        motion: &Motion,
        steering: f64,
        wanted: &Velocity,
        period: f64,
    ) -> Option<f64> {
        if self.limits.max_reverse_speed > 0.0 {
            return None;
        }
        let off_heading = angle_between(&direction(motion.yaw), wanted);
        self.turning = match self.turning {
            None => {
                let wheels = motion.yaw + steering;
                let off_wheels = angle_between(&direction(wheels), wanted);
                let behind = off_wheels.abs() > TURN_FROM || off_heading.abs() > TURN_FROM;
                behind.then_some(Turn {
                    side: if off_heading < 0.0 { -1.0 } else { 1.0 },
                    turned: 0.0,
                })
            }
            Some(turn) if off_heading.abs() > TURN_UNTIL => {
                // The side is kept, so that a velocity straight behind does not switch it,
                // unless the turn never ends.
                let turned = turn.turned + motion.yaw_rate * period;
                Some(if turned.abs() > TURN_AT_MOST {
                    Turn {
                        side: -turn.side,
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
        // The integrator itself is limited, so it does not wind up.
        let steering = (self.actuation.steering + rate * period)
            .clamp(-limits.max_steering, limits.max_steering);
        let change = limits.max_acceleration * period;
        // A steering angle that would need a lower speed than the car can reach in this
        // step is limited too.
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
