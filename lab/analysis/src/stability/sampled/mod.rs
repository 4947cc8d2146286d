//! The sampled loop, with delay and intermittent markers.
//!
//! The paper analyses a law without sampling, delay or servo. Here the law is evaluated at
//! ticks. Its command takes effect after a delay and is held until the next command (a
//! steering rate under the front-point law, an angle under the velocity-point law). The pose
//! may be measured at every n-th tick only and is held in between; yaw rate, sideslip and
//! steering are measured at every tick. Between the ticks the car is the linearised
//! single-track model (equations 1 and 2), solved exactly by matrix exponentials. To first
//! order the speed is constant.
//!
//! With a [`Servo`] the command is an angle under both laws, as on the car: the controller
//! integrates the rate of the front-point law and sends the angle at every tick. The wheels
//! follow after a dead time with a lag of first order. The law sees the commanded angle, and
//! the state at the tick, where [`Ages`] may make yaw rate and sideslip older; with a
//! [`Prediction`] it sees the state at which its command acts, and with a [`Compensation`] the
//! one that the pilot predicts.

mod compensation;
mod plant;
mod switched;
mod tick;

use nalgebra::DMatrix;

use super::closed_loop::{ClosedLoop, Law};

pub use self::{
    compensation::Compensation,
    plant::Ages,
    plant::{Prediction, Servo},
    switched::{IrregularLimits, LyapunovFunction, RandomLosses, Switched, UnstablePattern},
};

/// A closed loop that runs in ticks.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SampledLoop {
    pub(super) closed_loop: ClosedLoop,
    period: f64,
    delay: f64,
    /// In ticks.
    marker_interval: u32,
    position_gain: f64,
    servo: Option<Servo>,
    prediction: Option<Prediction>,
    compensation: Option<Compensation>,
    ages: Ages,
    /// In ticks.
    predicted_pose: u32,
    /// In ticks.
    servo_frame: u32,
}

/// An invalid parameter of a sampled loop.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[error("{name} is {value}: it must be {rule}")]
pub struct SamplingError {
    /// The parameter.
    pub name: &'static str,
    /// Its value.
    pub value: f64,
    /// The valid range.
    pub rule: &'static str,
}

impl SamplingError {
    /// Refuses a value that is not valid.
    fn unless(
        is_valid: bool,
        name: &'static str,
        value: f64,
        rule: &'static str,
    ) -> Result<(), Self> {
        match is_valid {
            true => Ok(()),
            false => Err(Self { name, value, rule }),
        }
    }
}

/// The limits of the search for margins.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MarginLimits {
    /// The longest delay, in s.
    pub delay: f64,
    /// The longest marker interval, in ticks.
    pub marker_interval: u32,
}

impl Default for MarginLimits {
    fn default() -> Self {
        Self {
            delay: 0.5,
            marker_interval: 200,
        }
    }
}

/// Resolution of the delay margin, in s.
const DELAY_RESOLUTION: f64 = 1e-6;

/// The longest delay, in ticks: the size of the matrices grows with it.
const MOST_TICKS: f64 = 1_000.0;

impl SampledLoop {
    /// `closed_loop` evaluated every `period` s, with commands that take effect `delay` s after
    /// their tick.
    ///
    /// # Errors
    ///
    /// A period that is not above zero, a delay below zero or above a thousand
    /// periods.
    pub fn new(closed_loop: ClosedLoop, period: f64, delay: f64) -> Result<Self, SamplingError> {
        let is_valid = period.is_finite() && period > 0.0;
        let rule = "finite and above zero";
        SamplingError::unless(is_valid, "the control period in s", period, rule)?;
        let is_valid = (0.0..=MOST_TICKS * period).contains(&delay);
        let rule = "between 0 and 1000 control periods";
        SamplingError::unless(is_valid, "the delay in s", delay, rule)?;
        Ok(Self {
            closed_loop,
            period,
            delay,
            marker_interval: 1,
            position_gain: 0.0,
            servo: None,
            prediction: None,
            compensation: None,
            ages: Ages::default(),
            predicted_pose: 0,
            servo_frame: 1,
        })
    }

    /// The same loop with a pose at every `interval`-th tick only; in between it is held.
    #[must_use]
    pub fn with_marker_interval(mut self, interval: u32) -> Self {
        self.marker_interval = interval.max(1);
        self
    }

    /// The same loop with an estimator that predicts the pose for `ticks` ticks after the one that
    /// saw it, before it holds it (`estimator.prediction_horizon_ms`).
    #[must_use]
    pub fn with_predicted_pose(mut self, ticks: u32) -> Self {
        self.predicted_pose = ticks;
        self
    }

    /// The same loop with a servo that takes the command of every `ticks`-th tick only, and keeps it
    /// until the next one: a servo pulse every 20 ms.
    #[must_use]
    pub fn with_servo_frame(mut self, ticks: u32) -> Self {
        self.servo_frame = ticks.max(1);
        self
    }

    /// The same loop with measurements that are old at the tick. An exact [`Prediction`] is one
    /// from their own time on: the ages have no effect with it.
    ///
    /// # Errors
    ///
    /// An age below zero or above a thousand periods.
    pub fn with_ages(self, ages: Ages) -> Result<Self, SamplingError> {
        ages.validate(MOST_TICKS * self.period)?;
        Ok(Self { ages, ..self })
    }

    /// The same loop with the pilot's compensation, in place of a [`Prediction`]. It needs a servo
    /// and the front-point law, and has no effect otherwise.
    ///
    /// # Errors
    ///
    /// A lag that is not above zero, or a dead time below zero or above a thousand periods.
    pub fn with_compensation(mut self, compensation: Compensation) -> Result<Self, SamplingError> {
        compensation.servo.validate()?;
        let dead_time = compensation.servo.dead_time;
        let is_valid = dead_time <= MOST_TICKS * self.period;
        let rule = "at most 1000 control periods";
        SamplingError::unless(is_valid, "the modelled dead time in s", dead_time, rule)?;
        let applies = self.servo.is_some() && self.closed_loop.law == Law::FrontPoint;
        self.compensation = applies.then_some(compensation);
        self.prediction = None;
        Ok(self)
    }

    /// The same loop with a steering servo, whose dead time adds to the delay.
    ///
    /// # Errors
    ///
    /// A lag that is not above zero, or a negative dead time.
    pub fn with_servo(mut self, servo: Servo) -> Result<Self, SamplingError> {
        servo.validate()?;
        self.servo = Some(servo);
        Ok(self)
    }

    /// The same loop with a controller that predicts. It needs a servo, and has no effect
    /// without one.
    ///
    /// # Errors
    ///
    /// A lag that is not above zero, or a negative delay.
    pub fn with_prediction(mut self, prediction: Prediction) -> Result<Self, SamplingError> {
        prediction.validate()?;
        self.prediction = self.servo.map(|_| prediction);
        self.compensation = None;
        Ok(self)
    }

    /// A prediction by the true car, servo and delay.
    pub fn exact_prediction(&self) -> Option<Prediction> {
        let servo = self.servo?;
        Some(Prediction {
            lag: servo.lag,
            delay: self.delay + servo.dead_time,
            vehicle: self.closed_loop.vehicle,
        })
    }

    /// The same timing around another steady motion.
    #[must_use]
    pub const fn around(mut self, closed_loop: ClosedLoop) -> Self {
        self.closed_loop = closed_loop;
        self
    }

    /// Whether the motion is stable.
    pub fn is_stable(&self) -> bool {
        is_stable(Cycle::of(self).map())
    }

    /// The same loop inside a proportional position loop of this gain, in 1/s, about a straight
    /// path. With zero it is the law alone.
    ///
    /// # Errors
    ///
    /// A gain that is negative or not finite.
    pub fn with_position_gain(mut self, position_gain: f64) -> Result<Self, SamplingError> {
        let is_valid = position_gain.is_finite() && position_gain >= 0.0;
        let rule = "finite and not negative";
        SamplingError::unless(is_valid, "the position gain in 1/s", position_gain, rule)?;
        self.position_gain = position_gain;
        Ok(self)
    }

    /// The spectral radius per tick: the factor by which disturbances grow or decay per tick in
    /// the long run. Below one the motion is stable.
    pub fn spectral_radius(&self) -> f64 {
        let cycle = Cycle::of(self);
        libm::pow(spectral_radius(cycle.map()), 1.0 / cycle.length())
    }

    /// The smallest delay in s that makes the motion unstable. Zero if it is unstable without a delay, none if it is stable with every delay up
    /// to the limit. The loop's own delay has no influence; the servo's dead time comes on top.
    pub fn delay_margin(&self, limits: MarginLimits) -> Option<f64> {
        let is_stable = |delay: f64| Self { delay, ..*self }.is_stable();
        let mut stable = 0.0;
        if !is_stable(stable) {
            return Some(0.0);
        }
        let limit = limits.delay.min(MOST_TICKS * self.period);
        let mut unstable = loop {
            if stable >= limit {
                return None;
            }
            let next = (stable + self.period).min(limit);
            if !is_stable(next) {
                break next;
            }
            stable = next;
        };
        while unstable - stable > DELAY_RESOLUTION {
            let middle = 0.5 * (stable + unstable);
            if is_stable(middle) {
                stable = middle;
            } else {
                unstable = middle;
            }
        }
        Some(0.5 * (stable + unstable))
    }

    /// The longest constant interval between poses, in s, up to which the motion is stable.
    ///
    /// A multiple of the period. Zero if the motion is unstable with a pose at every tick, none
    /// if it is stable up to the limit.
    pub fn longest_constant_interval(&self, limits: MarginLimits) -> Option<f64> {
        let mut cycle = Cycle::new(self);
        while cycle.interval <= limits.marker_interval {
            if !is_stable(cycle.map()) {
                return Some(f64::from(cycle.interval - 1) * self.period);
            }
            cycle.lengthen();
        }
        None
    }
}

/// The ticks until poses and servo pulses meet again.
struct Cycle {
    /// From a pose to the next, in ticks.
    interval: u32,
    predicted: u32,
    frame: u32,
    /// The maps of a tick with and without a pose, each with and without a servo pulse.
    ticks: [[DMatrix<f64>; 2]; 2],
    /// The map of each interval, by its number of ticks since the last servo pulse.
    intervals: Vec<DMatrix<f64>>,
}

impl Cycle {
    /// With an interval of one tick.
    fn new(sampled: &SampledLoop) -> Self {
        let ticks = [true, false].map(|pose| [true, false].map(|takes| sampled.tick(pose, takes)));
        let [[taken, kept], _] = &ticks;
        let others = (1..sampled.servo_frame).map(|_| kept);
        Self {
            interval: 1,
            predicted: sampled.predicted_pose,
            frame: sampled.servo_frame,
            intervals: [taken].into_iter().chain(others).cloned().collect(),
            ticks,
        }
    }

    fn of(sampled: &SampledLoop) -> Self {
        let mut cycle = Self::new(sampled);
        for _ in 1..sampled.marker_interval {
            cycle.lengthen();
        }
        cycle
    }

    /// Makes the interval a tick longer.
    fn lengthen(&mut self) {
        let [measured, held] = &self.ticks;
        let [taken, kept] = if self.interval <= self.predicted {
            measured
        } else {
            held
        };
        for (after, map) in (0..).zip(&mut self.intervals) {
            let takes = (self.interval + after).is_multiple_of(self.frame);
            *map = if takes { taken } else { kept } * &*map;
        }
        self.interval += 1;
    }

    /// How many ticks after a servo pulse its intervals begin.
    fn phases(&self) -> impl Iterator<Item = u32> {
        let (interval, frame) = (self.interval, self.frame);
        let next = move |phase: &u32| Some((phase + interval) % frame).filter(|next| *next > 0);
        core::iter::successors(Some(0), next)
    }

    /// Its number of ticks.
    fn length(&self) -> f64 {
        self.phases().count() as f64 * f64::from(self.interval)
    }

    /// Its map.
    fn map(&self) -> DMatrix<f64> {
        let mut maps = self
            .phases()
            .filter_map(|phase| self.intervals.get(phase as usize));
        let first = maps.next().cloned().unwrap_or_default();
        maps.fold(first, |map, next| next * map)
    }
}

/// The growth of the powers of a matrix by repeated squaring: `‖M^k‖^(1/k)`, which tends to
/// the spectral radius for every matrix (Gelfand).
struct Squaring {
    power: DMatrix<f64>,
    /// Logarithm of the divisor of `power`, over the exponent.
    logarithm: f64,
    exponent: f64,
}

/// Number of squarings.
const SQUARINGS: usize = 40;

impl Squaring {
    fn new(matrix: DMatrix<f64>) -> Self {
        let mut squaring = Self {
            power: matrix,
            logarithm: 0.0,
            exponent: 1.0,
        };
        squaring.normalise();
        squaring
    }

    fn normalise(&mut self) {
        let norm = self.power.norm();
        if norm > 0.0 {
            self.power /= norm;
        }
        self.logarithm += libm::log(norm) / self.exponent;
    }

    fn square(&mut self) {
        self.power = &self.power * &self.power;
        self.exponent *= 2.0;
        self.normalise();
    }
}

pub(super) fn spectral_radius(matrix: DMatrix<f64>) -> f64 {
    let mut squaring = Squaring::new(matrix);
    for _ in 0..SQUARINGS {
        if !squaring.logarithm.is_finite() {
            break;
        }
        squaring.square();
    }
    libm::exp(squaring.logarithm)
}

/// Whether the spectral radius is below one: some power then has a norm below one.
pub(super) fn is_stable(matrix: DMatrix<f64>) -> bool {
    let mut squaring = Squaring::new(matrix);
    for _ in 0..SQUARINGS {
        if squaring.logarithm < 0.0 {
            return true;
        }
        squaring.square();
    }
    false
}
