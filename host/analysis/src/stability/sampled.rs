//! The sampled loop, with delay and intermittent markers.
//!
//! The paper analyses a law without sampling or delay. Here the law is evaluated at ticks.
//! Its command takes effect after a delay and is held until the next command (a steering
//! rate under the front-point law, an angle under the velocity-point law). The pose may be
//! measured at every n-th tick only and is held in between; yaw rate, sideslip and steering
//! are measured at every tick. Between the ticks the car is the linearised single-track
//! model (equations 1 and 2), solved exactly by matrix exponentials. To first order the speed
//! is constant.

use nalgebra::{DMatrix, DVector};
use num_dual::Dual64;
use singletrack_control::{LateralMotion, SingleTrack, SingleTrackState, VehicleParameters};

use super::closed_loop::{Belief, ClosedLoop, Law};
use crate::dual::DualFunctions;

/// A closed loop that runs in ticks.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SampledLoop {
    closed_loop: ClosedLoop,
    period: f64,
    delay: f64,
    position_gain: f64,
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

impl SampledLoop {
    /// `closed_loop` evaluated every `period` s, with commands that take effect `delay` s after
    /// their tick.
    ///
    /// # Errors
    ///
    /// A period that is not above zero, a delay below zero or above a thousand
    /// periods.
    pub fn new(closed_loop: ClosedLoop, period: f64, delay: f64) -> Result<Self, SamplingError> {
        let error = |name, value, rule| Err(SamplingError { name, value, rule });
        if !(period.is_finite() && period > 0.0) {
            return error("the control period in s", period, "finite and above zero");
        }
        if !(0.0..=MOST_TICKS * period).contains(&delay) {
            return error(
                "the delay in s",
                delay,
                "between 0 and 1000 control periods",
            );
        }
        Ok(Self {
            closed_loop,
            period,
            delay,
            position_gain: 0.0,
        })
    }

    /// The same loop inside a proportional position loop of this gain, in 1/s, about a straight
    /// path. With zero it is the law alone.
    ///
    /// # Errors
    ///
    /// A gain that is negative or not finite.
    pub fn with_position_gain(self, position_gain: f64) -> Result<Self, SamplingError> {
        if !(position_gain.is_finite() && position_gain >= 0.0) {
            return Err(SamplingError {
                name: "the position gain in 1/s",
                value: position_gain,
                rule: "finite and not negative",
            });
        }
        Ok(Self {
            position_gain,
            ..self
        })
    }

    /// The spectral radius per tick if the pose is measured at every `interval`-th tick: the
    /// factor by which disturbances grow or decay per tick in the long run. Below one the
    /// motion is stable.
    #[must_use]
    pub fn spectral_radius(&self, interval: u32) -> f64 {
        let interval = interval.max(1);
        let over_interval = spectral_radius(self.over_interval(interval));
        libm::pow(over_interval, 1.0 / f64::from(interval))
    }

    /// The smallest delay in s that makes the motion unstable, with the pose measured at every
    /// tick. Zero if it is unstable without a delay, none if it is stable with every delay up
    /// to the limit. The loop's own delay has no influence.
    #[must_use]
    pub fn delay_margin(&self, limits: MarginLimits) -> Option<f64> {
        let is_stable = |delay: f64| is_stable(Self { delay, ..*self }.over_interval(1));
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
    #[must_use]
    pub fn longest_marker_interval(&self, limits: MarginLimits) -> Option<f64> {
        let (measured, held) = (self.tick(true), self.tick(false));
        let mut over_interval = measured;
        for interval in 1..=limits.marker_interval {
            if !is_stable(over_interval.clone()) {
                return Some(f64::from(interval - 1) * self.period);
            }
            over_interval = &held * over_interval;
        }
        None
    }

    /// The map from a tick with a pose to the next tick with a pose.
    fn over_interval(&self, interval: u32) -> DMatrix<f64> {
        let mut map = self.tick(true);
        if interval > 1 {
            let held = self.tick(false);
            for _ in 1..interval {
                map = &held * map;
            }
        }
        map
    }

    /// The map of one tick on the car's state, the pending commands from the newest to the
    /// oldest, and the held pose (position, yaw).
    fn tick(&self, has_pose: bool) -> DMatrix<f64> {
        let plant = Plant::of(&self.closed_loop);
        let states = plant.dynamics.nrows();
        let ticks = (self.delay / self.period + 1e-9) as usize;
        let late = (self.delay - ticks as f64 * self.period).max(0.0);
        let [begin, end] = plant.split_input(self.period, late);
        let free = plant.transition(self.period);

        let size = states + ticks + 1 + 2;
        let (commands, held) = (states, states + ticks + 1);
        // The measurements of the controller, and its command.
        let mut measured = DMatrix::<f64>::zeros(states, size);
        for state in 0..states {
            let is_pose = state == POSITION || state == YAW;
            let from = if is_pose && !has_pose {
                held + state
            } else {
                state
            };
            measured[(state, from)] = 1.0;
        }
        let command = self.gains().transpose() * measured;

        let mut map = DMatrix::<f64>::zeros(size, size);
        map.view_mut((0, 0), (states, states)).copy_from(&free);
        // The command at the beginning of the tick is one older than the one at its end.
        for (input, age) in [(&begin, ticks + 1), (&end, ticks)] {
            if age == 0 {
                let mut rows = map.rows_mut(0, states);
                rows += input * &command;
            } else {
                let mut column = map.view_mut((0, commands + age - 1), (states, 1));
                column += input;
            }
        }
        map.row_mut(commands).copy_from(&command);
        for age in 1..=ticks {
            map[(commands + age, commands + age - 1)] = 1.0;
        }
        for pose in [POSITION, YAW] {
            let from = if has_pose { pose } else { held + pose };
            map[(held + pose, from)] = 1.0;
        }
        if self.position_gain == 0.0 {
            // Without the outer loop nothing depends on the position.
            map = map
                .remove_rows_at(&[POSITION, held + POSITION])
                .remove_columns_at(&[POSITION, held + POSITION]);
        }
        map
    }

    /// The linearised law: the command as a linear combination of the car's states.
    fn gains(&self) -> DVector<f64> {
        let ClosedLoop {
            vehicle,
            law,
            belief,
            point_distance: p,
            speed: v,
            deviation,
        } = self.closed_loop;
        let VehicleParameters {
            mass_kg: m,
            front_cornering_stiffness_n_rad: c_f,
            rear_cornering_stiffness_n_rad: c_r,
            ..
        } = vehicle;
        let l_f = vehicle.front_axle_distance_m + deviation;
        let gain = self.position_gain;
        match law {
            // u = (v_Py - v (yaw + sideslip) - l_f r) / p - r, with
            // v_Py = -gain (y + l_f yaw + p (yaw + steering)).
            Law::FrontPoint => DVector::from_vec(vec![
                -gain / p,
                -(gain * (l_f + p) + v) / p,
                -l_f / p - 1.0,
                -v / p,
                -gain,
            ]),
            // turn rate = (v_Py - v (yaw + sideslip)) / p, with
            // v_Py = -gain (y + p (yaw + sideslip)).
            Law::VelocityPoint => {
                let l_r = match belief {
                    Belief::CentreOfMass => vehicle.rear_axle_distance_m - deviation,
                    Belief::FrontAxle => vehicle.rear_axle_distance_m,
                };
                let turning = m * v / c_f;
                let course = -turning * (gain + v / p);
                DVector::from_vec(vec![
                    -turning * gain / p,
                    course,
                    -(c_r * l_r - c_f * l_f) / (c_f * v),
                    course + (c_r + c_f) / c_f,
                ])
            }
        }
    }
}

const POSITION: usize = 0;
const YAW: usize = 1;

/// The linearised car: lateral position, yaw, yaw rate and sideslip, and also steering if
/// its rate is the input.
struct Plant {
    dynamics: DMatrix<f64>,
    input: DVector<f64>,
}

impl Plant {
    fn of(closed_loop: &ClosedLoop) -> Self {
        let [columns @ .., steering] = [0, 1, 2, 3, 4].map(|variable| slope(closed_loop, variable));
        let car = DMatrix::from_iterator(4, 4, columns.iter().flatten().copied());
        let steering = DVector::from_row_slice(&steering);
        match closed_loop.law() {
            Law::VelocityPoint => Self {
                dynamics: car,
                input: steering,
            },
            Law::FrontPoint => {
                let mut dynamics = car.resize(5, 5, 0.0);
                dynamics.view_mut((0, 4), (4, 1)).copy_from(&steering);
                Self {
                    dynamics,
                    input: DVector::from_vec(vec![0.0, 0.0, 0.0, 0.0, 1.0]),
                }
            }
        }
    }

    /// The state after `time` without input.
    fn transition(&self, time: f64) -> DMatrix<f64> {
        (&self.dynamics * time).exp()
    }

    /// The contributions of a unit of input over the first `late` s of `period`, and over the
    /// rest, to the state at its end.
    fn split_input(&self, period: f64, late: f64) -> [DVector<f64>; 2] {
        let rest = period - late;
        [self.transition(rest) * self.held(late), self.held(rest)]
    }

    /// The contribution of a unit of input over `time` to the state: the integral of the
    /// transition, from the exponential of a bordered matrix.
    fn held(&self, time: f64) -> DVector<f64> {
        let states = self.dynamics.nrows();
        let mut bordered = self.dynamics.clone().resize(states + 1, states + 1, 0.0);
        bordered
            .view_mut((0, states), (states, 1))
            .copy_from(&self.input);
        (bordered * time)
            .exp()
            .view((0, states), (states, 1))
            .into_owned()
            .column(0)
            .into_owned()
    }
}

/// The exact derivative of the car's motion by one of y, yaw, yaw rate, sideslip and
/// steering at the steady motion: equations 1 and 2 without the position along the path.
fn slope(closed_loop: &ClosedLoop, variable: usize) -> [f64; 4] {
    let mut variables = [Dual64::from(0.0); 5];
    if let Some(variable) = variables.get_mut(variable) {
        variable.eps = 1.0;
    }
    let [y, yaw, yaw_rate, sideslip, steering] = variables;
    let state = SingleTrackState {
        x: Dual64::from(0.0),
        y,
        yaw,
        yaw_rate,
        sideslip,
    };
    let speed = Dual64::from(closed_loop.speed());
    let lateral = SingleTrack::new(*closed_loop.vehicle()).lateral(&LateralMotion {
        yaw_rate,
        sideslip,
        speed,
        steering,
    });
    let rate = state.derivative::<DualFunctions>(speed, lateral);
    [rate.y, rate.yaw, rate.yaw_rate, rate.sideslip].map(|rate| rate.eps)
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

fn spectral_radius(matrix: DMatrix<f64>) -> f64 {
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
fn is_stable(matrix: DMatrix<f64>) -> bool {
    let mut squaring = Squaring::new(matrix);
    for _ in 0..SQUARINGS {
        if squaring.logarithm < 0.0 {
            return true;
        }
        squaring.square();
    }
    false
}
