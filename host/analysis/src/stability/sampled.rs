//! The loop as it runs: sampled, late, and with markers that are not always seen.
//!
//! The paper's analysis is of a law without sampling or delay. Here the law is
//! evaluated at ticks, its command acts a delay later and is held until the next one
//! acts (a steering rate under the front-point law, an angle under the velocity-point
//! law), and the pose may be seen at every n-th tick only and held in between, while
//! yaw rate, sideslip and steering stay live. The car in between is the linearised
//! single-track model, solved exactly by matrix exponentials; to first order the speed
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

/// A loop that can't be sampled so.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[error("{name} is {value}: it must be {rule}")]
pub struct SamplingError {
    /// What is wrong.
    pub name: &'static str,
    /// Its value.
    pub value: f64,
    /// What it may be.
    pub rule: &'static str,
}

/// How far margins are looked for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MarginLimits {
    /// Longest delay that is looked at, in s.
    pub delay: f64,
    /// Longest marker interval that is looked at, in ticks.
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

/// To how many s the delay margin is found.
const DELAY_RESOLUTION: f64 = 1e-6;

/// Delays longer than this many ticks make matrices too large.
const MOST_TICKS: f64 = 1_000.0;

impl SampledLoop {
    /// `closed_loop` evaluated every `period` s, its command acting `delay` s after
    /// the tick that it was measured at.
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

    /// The same inside a proportional position loop of this gain, in 1/s, about a
    /// straight path; with zero, the law alone.
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

    /// The spectral radius of a tick when the pose is seen at every `interval`-th tick
    /// (at each, if it is 1): the factor by which disturbances grow or decay per tick
    /// in the long run. Below one the motion is stable.
    #[must_use]
    pub fn spectral_radius(&self, interval: u32) -> f64 {
        let interval = interval.max(1);
        let over_interval = spectral_radius(self.over_interval(interval));
        libm::pow(over_interval, 1.0 / f64::from(interval))
    }

    /// The smallest delay in s that makes the motion unstable, with the pose seen at
    /// every tick: zero if it is unstable without a delay, none if it is stable with
    /// every delay up to the limit. The loop's own delay does not matter.
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

    /// The longest time in s that may pass between one pose and the next, again and
    /// again, so that the motion is stable with this and every shorter interval: zero
    /// if it is unstable with a pose at every tick, none if it is stable up to the
    /// limit. In whole ticks.
    #[must_use]
    pub fn longest_marker_interval(&self, limits: MarginLimits) -> Option<f64> {
        let (seen, held) = (self.tick(true), self.tick(false));
        let mut over_interval = seen;
        for interval in 1..=limits.marker_interval {
            if !is_stable(over_interval.clone()) {
                return Some(f64::from(interval - 1) * self.period);
            }
            over_interval = &held * over_interval;
        }
        None
    }

    /// The map from a tick that sees the pose to the next that does.
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

    /// The map of a tick on: the car's state, the commands still under way from the
    /// newest to the oldest, and the pose that is held (position, yaw).
    fn tick(&self, seen: bool) -> DMatrix<f64> {
        let plant = Plant::of(&self.closed_loop);
        let states = plant.dynamics.nrows();
        let ticks = (self.delay / self.period + 1e-9) as usize;
        let late = (self.delay - ticks as f64 * self.period).max(0.0);
        let [begin, end] = plant.over(self.period, late);
        let free = plant.transition(self.period);

        let size = states + ticks + 1 + 2;
        let (commands, held) = (states, states + ticks + 1);
        // What the controller knows, and what it makes of it.
        let mut known = DMatrix::<f64>::zeros(states, size);
        for state in 0..states {
            let is_pose = state == POSITION || state == YAW;
            let from = if is_pose && !seen {
                held + state
            } else {
                state
            };
            known[(state, from)] = 1.0;
        }
        let command = self.gains().transpose() * known;

        let mut map = DMatrix::<f64>::zeros(size, size);
        map.view_mut((0, 0), (states, states)).copy_from(&free);
        // What acts at the beginning of the tick is one older than at its end.
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
            let from = if seen { pose } else { held + pose };
            map[(held + pose, from)] = 1.0;
        }
        if self.position_gain == 0.0 {
            // Nothing depends on where the car is; its position only integrates.
            map = map
                .remove_rows_at(&[POSITION, held + POSITION])
                .remove_columns_at(&[POSITION, held + POSITION]);
        }
        map
    }

    /// The linearised law: the command as a combination of the car's states.
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

/// The linearised car: lateral position, yaw, yaw rate, sideslip, and steering where
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

    /// What a unit of input over the first `late` s of `period`, and over the rest,
    /// adds to the state at its end.
    fn over(&self, period: f64, late: f64) -> [DVector<f64>; 2] {
        let rest = period - late;
        [self.transition(rest) * self.held(late), self.held(rest)]
    }

    /// What a unit of input over `time` adds to the state: the integral of the
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

/// The growth of the powers of a matrix, by squaring it: `‖M^k‖^(1/k)`, which tends to
/// the spectral radius (Gelfand), whatever its eigenvalues are.
struct Squaring {
    power: DMatrix<f64>,
    /// Logarithm of what `power` was divided by, over the exponent.
    logarithm: f64,
    exponent: f64,
}

/// Exponents up to 2 to this power.
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

/// Whether the spectral radius is below one: some power is then shorter than one.
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
