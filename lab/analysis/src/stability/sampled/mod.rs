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
//!
//! In continuous time the first unstable speed and the least distance p follow from a quadratic (see
//! [`critical_speed`](super::critical_speed)). Here they are searched for.

mod plant;
mod switched;
mod tick;

use nalgebra::DMatrix;
use singletrack_control::VehicleParameters;

use super::closed_loop::{ClosedLoop, Law, StabilityError};

pub use self::{
    plant::{Ages, Compensation, Prediction, Servo},
    switched::{IrregularLimits, LyapunovFunction, RandomLosses, Switched, UnstablePattern},
};

/// A closed loop that runs in ticks.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SampledLoop {
    pub(super) closed_loop: ClosedLoop,
    timing: Timing,
}

/// What happens between a measurement and the wheels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Timing {
    /// From tick to tick, in s.
    pub period: f64,
    /// From a tick until its command takes effect, in s.
    pub delay: f64,
    /// From pose to pose, in ticks; in between the pose is held.
    pub marker_interval: u32,
    /// How long the estimator predicts the pose after the tick that saw it, before it holds it, in
    /// ticks (`estimator.prediction_horizon_ms`).
    pub predicted_pose: u32,
    /// The gain of a proportional position loop about a straight path, in 1/s; zero for the law alone.
    pub position_gain: f64,
    /// A steering servo, whose dead time adds to the delay.
    pub servo: Option<Servo>,
    /// The servo takes the command of every tick of this number, and keeps it until the next one: a
    /// servo pulse every 20 ms.
    pub servo_frame: u32,
    /// The ages of the measurements at the tick. An exact [`Prediction`] is one from their own time on:
    /// they have no effect with it.
    pub ages: Ages,
    /// A controller that predicts. It needs a servo, and has no effect without one.
    pub prediction: Option<Prediction>,
    /// The pilot's compensation, in place of a [`Prediction`]. It needs a servo and the front-point law,
    /// and has no effect otherwise.
    pub compensation: Option<Compensation>,
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

impl Timing {
    /// A pose and a command at every tick, wheels that follow at once, and no position loop.
    pub const fn new(period: f64, delay: f64) -> Self {
        Self {
            period,
            delay,
            marker_interval: 1,
            predicted_pose: 0,
            position_gain: 0.0,
            servo: None,
            servo_frame: 1,
            ages: Ages {
                yaw_rate: 0.0,
                sideslip: 0.0,
            },
            prediction: None,
            compensation: None,
        }
    }

    /// A prediction by the true servo and delay, and by this car.
    pub fn exact_prediction(&self, vehicle: VehicleParameters) -> Option<Prediction> {
        self.servo.map(|servo| Prediction {
            lag: servo.lag,
            delay: self.delay + servo.dead_time,
            vehicle,
        })
    }

    fn validate(&self) -> Result<(), SamplingError> {
        let most = MOST_TICKS * self.period;
        type Rule = (&'static str, fn(f64, f64) -> bool);
        let positive: Rule = ("finite and above zero", |value, _| {
            value.is_finite() && value > 0.0
        });
        let not_negative: Rule = ("finite and not negative", |value, _| {
            value.is_finite() && value >= 0.0
        });
        let within: Rule = ("between 0 and 1000 control periods", |value, most| {
            (0.0..=most).contains(&value)
        });
        let mut values = vec![
            ("the control period in s", self.period, positive),
            ("the delay in s", self.delay, within),
            ("the age of the yaw rate in s", self.ages.yaw_rate, within),
            ("the age of the sideslip in s", self.ages.sideslip, within),
            ("the position gain in 1/s", self.position_gain, not_negative),
        ];
        let modelled = self.compensation.map(|compensation| compensation.servo);
        let predicted = self.prediction.map(|prediction| Servo {
            lag: prediction.lag,
            dead_time: prediction.delay,
        });
        for Servo { lag, dead_time } in [self.servo, modelled, predicted].into_iter().flatten() {
            values.push(("the lag of the servo in s", lag, positive));
            values.push(("the dead time of the servo in s", dead_time, not_negative));
        }
        if let Some(Servo { dead_time, .. }) = modelled {
            values.push(("the modelled dead time in s", dead_time, within));
        }
        for (name, value, (rule, holds)) in values {
            if !holds(value, most) {
                return Err(SamplingError { name, value, rule });
            }
        }
        Ok(())
    }
}

impl SampledLoop {
    /// `closed_loop` evaluated in ticks.
    ///
    /// # Errors
    ///
    /// A period or a lag that is not above zero, a negative gain, or a time below zero or above a
    /// thousand periods.
    pub fn new(closed_loop: ClosedLoop, mut timing: Timing) -> Result<Self, SamplingError> {
        timing.validate()?;
        let has_servo = timing.servo.is_some();
        let is_front_point = closed_loop.law == Law::FrontPoint;
        timing.compensation = timing.compensation.filter(|_| has_servo && is_front_point);
        timing.prediction = timing
            .prediction
            .filter(|_| has_servo && timing.compensation.is_none());
        timing.marker_interval = timing.marker_interval.max(1);
        timing.servo_frame = timing.servo_frame.max(1);
        Ok(Self {
            closed_loop,
            timing,
        })
    }

    /// This timing around another steady motion.
    #[must_use]
    pub const fn around(mut self, closed_loop: ClosedLoop) -> Self {
        self.closed_loop = closed_loop;
        self
    }

    /// Whether the motion is stable.
    pub fn is_stable(&self) -> bool {
        is_stable(Cycle::of(self).map())
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
        let is_stable = |delay: f64| {
            let mut delayed = *self;
            delayed.timing.delay = delay;
            delayed.is_stable()
        };
        let mut stable = 0.0;
        if !is_stable(stable) {
            return Some(0.0);
        }
        let limit = limits.delay.min(MOST_TICKS * self.timing.period);
        let mut unstable = loop {
            if stable >= limit {
                return None;
            }
            let next = (stable + self.timing.period).min(limit);
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
                return Some(f64::from(cycle.interval - 1) * self.timing.period);
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
        let others = (1..sampled.timing.servo_frame).map(|_| kept);
        Self {
            interval: 1,
            predicted: sampled.timing.predicted_pose,
            frame: sampled.timing.servo_frame,
            intervals: [taken].into_iter().chain(others).cloned().collect(),
            ticks,
        }
    }

    fn of(sampled: &SampledLoop) -> Self {
        let mut cycle = Self::new(sampled);
        for _ in 1..sampled.timing.marker_interval {
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

/// The ratio of two values of the search: narrower regions are not found.
const RATIO: f64 = 1.05;
/// The relative resolution of the result.
const RESOLUTION: f64 = 1e-6;

/// The lowest speed in m/s from which the motion is unstable with one of `deviations` (dl, m),
/// between the ends of a range above zero. None if it is stable throughout; the
/// first speed if it is unstable there.
///
/// # Errors
///
/// A speed or a deviation without a steady motion.
pub fn first_unstable_speed(
    sampled: &SampledLoop,
    deviations: &[f64],
    [from, to]: [f64; 2],
) -> Result<Option<f64>, StabilityError> {
    boundary(from, to, |speed| {
        let at = sampled.closed_loop.with_speed(speed)?;
        is_stable_at_all(sampled, at, deviations)
    })
}

/// The least distance p in m from which on the motion is stable with each of `deviations` (dl,
/// m), between the ends of a range above zero. None if it is unstable at the last
/// one; the first one if it is stable throughout.
///
/// # Errors
///
/// A distance or a deviation without a steady motion.
pub fn least_point_distance(
    sampled: &SampledLoop,
    deviations: &[f64],
    [from, to]: [f64; 2],
) -> Result<Option<f64>, StabilityError> {
    let is_stable = |p: f64| {
        let at = sampled.closed_loop.with_point_distance(p)?;
        is_stable_at_all(sampled, at, deviations)
    };
    if !is_stable(to)? {
        return Ok(None);
    }
    // From the largest distance down.
    Ok(Some(boundary(to, from, is_stable)?.unwrap_or(from)))
}

/// Whether the motion is stable with each of these deviations.
fn is_stable_at_all(
    sampled: &SampledLoop,
    at: ClosedLoop,
    deviations: &[f64],
) -> Result<bool, StabilityError> {
    for deviation in deviations {
        if !sampled.around(at.with_deviation(*deviation)?).is_stable() {
            return Ok(false);
        }
    }
    Ok(true)
}

/// Where, on the way from `from` to `to`, the motion is no longer stable.
fn boundary(
    from: f64,
    to: f64,
    is_stable: impl Fn(f64) -> Result<bool, StabilityError>,
) -> Result<Option<f64>, StabilityError> {
    if !is_stable(from)? {
        return Ok(Some(from));
    }
    let steps = (libm::fabs(libm::log(to / from)) / libm::log(RATIO))
        .ceil()
        .max(1.0) as u32;
    let at = |step: u32| from * libm::pow(to / from, f64::from(step) / f64::from(steps));
    let mut stable = from;
    for step in 1..=steps {
        let mut unstable = at(step);
        if is_stable(unstable)? {
            stable = unstable;
            continue;
        }
        while libm::fabs(unstable - stable) > RESOLUTION * stable {
            let middle = 0.5 * (stable + unstable);
            if is_stable(middle)? {
                stable = middle;
            } else {
                unstable = middle;
            }
        }
        return Ok(Some(0.5 * (stable + unstable)));
    }
    Ok(None)
}
