//! Model predictive control of the single-track model, to compare with.
//!
//! Linear time-varying, by real-time iterations (Diehl, Bock and Schlöder 2005). A tick linearises
//! the dynamic single-track model with saturating tyres, and with lag and dead time of both
//! actuators, about the last plan shifted by a period. A quadratic program, from which the states
//! are eliminated, then brings the front axle onto the reference within the limits of steering
//! angle, steering rate, speed and acceleration. If the program has no solution, the shifted plan is
//! driven on.

use std::collections::VecDeque;

use libm::{ceil, cos, exp, sin, sincos, tanh};
use nalgebra::{SMatrix, SVector};
use singletrack_analysis::quadratic::{self, CscMatrix};
use singletrack_control::{ActuatorModel, Estimate, GRAVITY, Limits, VehicleParameters};

use super::{course::Table, foreign::Known};

/// Length of each stage of the plan, in control periods; the horizon is 0.5 s at 100 Hz.
const STAGE_TICKS: [u8; STAGES] = [1, 1, 2, 3, 4, 5, 5, 5, 6, 6, 6, 6];
const STAGES: usize = 12;
/// The variables of the program: the commands of steering and speed at the end of each stage.
const VARIABLES: usize = 2 * STAGES;
/// Weight of the squared error of the front axle, in m⁻²: 1 cm costs 1.
const POSITION_WEIGHT: f64 = 1e4;
/// The share of the unexplained part of [`ACROSS`], [`YAW_RATE`] and [`SPEED`] that a tick
/// believes: 0.2 s and 0.07 s at 100 Hz.
const BIAS_GAINS: [f64; 3] = [0.05, 0.05, 0.15];
/// Slip angles are computed with no less speed, in m/s.
const SLIPS_FROM_M_S: f64 = 0.3;
/// The longest step in which the model follows the commands that were sent, in s.
const LONGEST_STEP_S: f64 = 0.005;
/// Commands that are kept: those of the longest dead time at the shortest period.
const COMMANDS: usize = 128;

/// State of the model: [`X`], [`Y`], [`YAW`], [`ACROSS`], [`YAW_RATE`], [`SPEED`], [`WHEELS`].
type State = SVector<f64, 7>;
/// Position of the front axle along x, world frame, in m.
const X: usize = 0;
/// Position of the front axle along y, world frame, in m.
const Y: usize = 1;
/// Angle from the world's x axis to the car's, in rad.
const YAW: usize = 2;
/// Velocity of G to the left of the car, in m/s.
const ACROSS: usize = 3;
/// Yaw rate, in rad/s.
const YAW_RATE: usize = 4;
/// Forward velocity of the car, in m/s.
const SPEED: usize = 5;
/// Angle of the front wheels, in rad.
const WHEELS: usize = 6;

/// The commands that act at the beginning and at the end of a step: of the steering in rad, and of
/// the forward velocity in m/s.
type Acting = [[f64; 2]; 2];

/// The single-track model behind its actuators.
#[derive(Clone, Copy, Debug)]
struct Model {
    vehicle: VehicleParameters,
    /// Time constants of steering and speed, in s.
    lags: [f64; 2],
    /// What the measured [`ACROSS`] (without unit) and [`YAW_RATE`] (1/m), each over the speed, and
    /// the measured [`SPEED`] (m/s) are above those of the model.
    bias: SVector<f64, 3>,
}

/// A lag of first order after `step` seconds, in which its target moves evenly.
fn lagged(value: f64, [begin, end]: [f64; 2], lag: f64, step: f64) -> f64 {
    if lag <= 0.0 {
        return end;
    }
    let behind = lag * (end - begin) / step;
    end - behind + (value - begin + behind) * exp(-step / lag)
}

impl Model {
    /// The state after `step` seconds.
    fn after(&self, state: &State, [steering, speed]: Acting, step: f64) -> State {
        let VehicleParameters {
            mass_kg: m,
            yaw_inertia_kg_m2: inertia,
            front_axle_distance_m: l_f,
            rear_axle_distance_m: l_r,
            friction,
            ..
        } = self.vehicle;
        let mut next = *state;
        next[WHEELS] = lagged(state[WHEELS], steering, self.lags[0], step);
        next[SPEED] = lagged(state[SPEED], speed, self.lags[1], step);
        let (v, wheels) = (next[SPEED], next[WHEELS]);
        // The secant of the tyre's curve at a slip angle.
        let pace = v.max(SLIPS_FROM_M_S);
        let secant = |stiffness: f64, other_axle: f64, slip: f64| {
            // Where G is believed to be at an axle, the other one still has some grip.
            let load = m * GRAVITY * (other_axle / (l_f + l_r)).max(0.25);
            let used = (stiffness * slip / (friction * load)).abs().max(1e-6);
            stiffness * tanh(used) / used
        };
        let c_f = secant(
            self.vehicle.front_cornering_stiffness_n_rad,
            l_r,
            wheels - (state[ACROSS] + l_f * state[YAW_RATE]) / pace,
        );
        let c_r = secant(
            self.vehicle.rear_cornering_stiffness_n_rad,
            l_f,
            (l_r * state[YAW_RATE] - state[ACROSS]) / pace,
        );
        // Implicit Euler of equation 1 for the lateral velocity in place of the sideslip, times
        // the speed: regular at standstill, and a steady change lags as it should.
        let moment = c_r * l_r - c_f * l_f;
        let [a, b] = [v + step * (c_f + c_r) / m, step * (v * v - moment / m)];
        let damping = c_f * l_f * l_f + c_r * l_r * l_r;
        let [c, d] = [-step * moment / inertia, v + step * damping / inertia];
        let force = step * v * c_f * wheels;
        let across = v * state[ACROSS] + force / m;
        let turn = v * state[YAW_RATE] + force * l_f / inertia;
        let determinant = a * d - b * c;
        next[ACROSS] = (d * across - b * turn) / determinant;
        next[YAW_RATE] = (a * turn - c * across) / determinant;
        let mean = |index: usize| 0.5 * (state[index] + next[index]);
        let speed = mean(SPEED);
        let yaw_rate = mean(YAW_RATE) + self.bias[1] * speed;
        let left = step * (mean(ACROSS) + self.bias[0] * speed + l_f * yaw_rate);
        let forward = step * (speed + self.bias[2]);
        next[YAW] += step * yaw_rate;
        let (sine, cosine) = sincos(state[YAW] + 0.5 * step * yaw_rate);
        next[X] += forward * cosine - left * sine;
        next[Y] += forward * sine + left * cosine;
        next
    }

    /// The state after `step` seconds, and its derivatives with respect to the state before and to
    /// the four commands, by central differences.
    fn linearise(
        &self,
        state: &State,
        acting: Acting,
        step: f64,
    ) -> (State, SMatrix<f64, 7, 7>, SMatrix<f64, 7, 4>) {
        const SMALL: f64 = 1e-5;
        let slope =
            |change: &dyn Fn(f64) -> State| (change(SMALL) - change(-SMALL)) / (2.0 * SMALL);
        let mut by_state = SMatrix::<f64, 7, 7>::zeros();
        for index in 0..7 {
            let change = |by: f64| {
                let mut other = *state;
                other[index] += by;
                self.after(&other, acting, step)
            };
            by_state.set_column(index, &slope(&change));
        }
        let mut by_command = SMatrix::<f64, 7, 4>::zeros();
        for index in 0..4 {
            let change = |by: f64| {
                let mut other = acting;
                other[index / 2][index % 2] += by;
                self.after(state, other, step)
            };
            by_command.set_column(index, &slope(&change));
        }
        (self.after(state, acting, step), by_state, by_command)
    }
}

/// A place in the plan: a node, and the share of the way to the next one.
type Place = (usize, f64);

/// A stage of the plan.
#[derive(Clone, Copy, Debug)]
struct Stage {
    /// Its duration, in s.
    length: f64,
    /// Its end after the beginning of the plan, in s.
    end: f64,
    /// Where in the plan the commands of steering and speed lie that act at its beginning and at
    /// its end.
    places: [[Place; 2]; 2],
}

/// The controller on its way along a path.
#[derive(Clone, Debug)]
pub(super) struct Predictive<'a> {
    model: Model,
    /// From a command to the first answer of steering and speed, in s.
    dead_times: [f64; 2],
    period: f64,
    /// Weights of the squared steering rate, in (rad/s)⁻², and of the squared acceleration, in
    /// (m/s²)⁻².
    rate_weights: [f64; 2],
    table: &'a Table,
    /// The time (s) of the last tick, and the state of the model, which never follows what is
    /// measured.
    followed: Option<(f64, State)>,
    /// Steering (rad) and forward velocity (m/s) that were sent, with their times (s).
    sent: VecDeque<(f64, [f64; 2])>,
    /// The commands of steering (rad) and forward velocity (m/s) at the beginning of the plan and
    /// at the end of each stage.
    plan: [[f64; 2]; STAGES + 1],
    stages: [Stage; STAGES],
    /// The limits of the commands.
    limits: Limits,
    /// The matrix of the bounds, in the order of [`Self::bounds`].
    bounded: CscMatrix,
}

impl<'a> Predictive<'a> {
    /// With these weights of steering rate and acceleration, for a car whose control has this
    /// period, in s.
    pub(super) fn new(
        rate_weights: [f64; 2],
        vehicle: VehicleParameters,
        actuators: ActuatorModel,
        limits: Limits,
        period: f64,
        table: &'a Table,
    ) -> Self {
        let dead_times = [actuators.steering_dead_time, actuators.speed_dead_time];
        let mut end = 0.0;
        let ends = STAGE_TICKS.map(|ticks| {
            end += f64::from(ticks) * period;
            end
        });
        // A command is held for a period: on average it is half a period ahead of an even change.
        // The plan begins when a command begins to turn the wheels; the motor acts later.
        let leads = dead_times.map(|dead_time| 0.5 * period + dead_times[0] - dead_time);
        let stages = core::array::from_fn(|index| {
            let length = f64::from(STAGE_TICKS[index]) * period;
            let edges = [ends[index] - length, ends[index]];
            Stage {
                length,
                end: ends[index],
                places: leads.map(|lead| edges.map(|edge| place(&ends, edge + lead))),
            }
        });
        // A row for each value of `bounds`.
        let mut rows = Vec::new();
        for variable in 0..VARIABLES {
            for sign in [1.0, -1.0] {
                let mut row = [0.0; VARIABLES];
                row[variable] = sign;
                rows.push(row);
                if let Some(before) = variable.checked_sub(2) {
                    row[before] = -sign;
                }
                rows.push(row);
            }
        }
        Self {
            model: Model {
                vehicle,
                lags: [actuators.steering_lag, actuators.speed_lag],
                bias: SVector::zeros(),
            },
            dead_times,
            period,
            rate_weights,
            table,
            followed: None,
            sent: VecDeque::new(),
            plan: [[0.0; 2]; STAGES + 1],
            stages,
            limits,
            bounded: CscMatrix::from(&rows),
        }
    }

    /// Steering (rad) and speed of G (m/s) for the tick after one that knows this.
    pub(super) fn answer(&mut self, known: &Known<'_>) -> [f64; 2] {
        let estimate = known.estimate;
        let sent = [known.steering, known.speed * cos(estimate.sideslip)];
        if self.sent.len() >= COMMANDS {
            self.sent.pop_front();
        }
        self.sent.push_back((known.time, sent));
        let state = self.observe(known.time, estimate);
        let begins = known.time + self.period + self.dead_times[0];
        let start = self.follow(state, [known.time, begins]);
        let ends = self.stages.map(|stage| stage.end);
        let last = core::mem::replace(&mut self.plan, [sent; STAGES + 1]);
        for (node, end) in self.plan.iter_mut().skip(1).zip(&ends) {
            *node = at(&last, place(&ends, end + self.period));
        }
        if let Some(change) = self.improve(start, begins) {
            for (variable, change) in change.into_iter().enumerate() {
                self.plan[variable / 2 + 1][variable % 2] += change;
            }
        }
        let [steering, speed] = self.plan[1];
        [steering, speed.max(0.0) / cos(estimate.sideslip)]
    }

    /// Takes the measured velocities into the bias; the state now.
    fn observe(&mut self, time: f64, estimate: &Estimate) -> State {
        let mut measured = State::zeros();
        measured[YAW] = estimate.yaw;
        measured[ACROSS] = estimate.speed * sin(estimate.sideslip);
        measured[YAW_RATE] = estimate.yaw_rate;
        measured[SPEED] = estimate.speed * cos(estimate.sideslip);
        let velocities =
            |state: &State| SVector::from([ACROSS, YAW_RATE, SPEED].map(|it| state[it]));
        let mut state = match self.followed {
            Some((last, state)) => self.follow(state, [last, time]),
            None => measured,
        };
        self.followed = Some((time, state));
        let pace = state[SPEED].max(SLIPS_FROM_M_S);
        let mut unexplained = velocities(&measured) - velocities(&state);
        unexplained.component_div_assign(&SVector::from([pace, pace, 1.0]));
        unexplained -= self.model.bias;
        self.model.bias += unexplained.component_mul(&SVector::from(BIAS_GAINS));
        let l_f = self.model.vehicle.front_axle_distance_m;
        state[X] = estimate.position.x + l_f * cos(estimate.yaw);
        state[Y] = estimate.position.y + l_f * sin(estimate.yaw);
        state[YAW] = estimate.yaw;
        state
    }

    /// The state of the model after the commands that were sent, between two times in s.
    fn follow(&self, mut state: State, [from, until]: [f64; 2]) -> State {
        let steps = ceil((until - from) / LONGEST_STEP_S).max(1.0);
        let step = (until - from) / steps;
        for index in 0..steps as u32 {
            let time = from + (f64::from(index) + 0.5) * step;
            let acting = [0, 1].map(|axis| {
                let due = time - self.dead_times[axis];
                let mut newest = self.sent.iter().rev();
                let command = newest.find(|(sent, _)| *sent <= due);
                [command.map_or(0.0, |(_, command)| command[axis]); 2]
            });
            state = self.model.after(&state, acting, step);
        }
        state
    }

    /// The change of the plan that the quadratic program finds, from this state at this time in s.
    fn improve(&self, mut state: State, begins: f64) -> Option<[f64; VARIABLES]> {
        let mut sensitivity = SMatrix::<f64, 7, VARIABLES>::zeros();
        let mut hessian = SMatrix::<f64, VARIABLES, VARIABLES>::zeros();
        let mut gradient = SVector::<f64, VARIABLES>::zeros();
        for (index, stage) in self.stages.iter().enumerate() {
            let places = stage.places;
            let acting = [0, 1].map(|axis| places[axis].map(|place| at(&self.plan, place)[axis]));
            let (next, by_state, by_command) = self.model.linearise(&state, acting, stage.length);
            state = next;
            sensitivity = by_state * sensitivity;
            for (axis, edge) in [(0, 0), (0, 1), (1, 0), (1, 1)] {
                let (node, share) = places[axis][edge];
                for (node, share) in [(node, 1.0 - share), (node + 1, share)] {
                    // The first node was sent.
                    if let Some(before) = node.checked_sub(1) {
                        let mut column = sensitivity.column_mut(2 * before + axis);
                        column += share * by_command.column(2 * axis + edge);
                    }
                }
            }
            let share = stage.length / self.period;
            let wanted = self.table.at(begins + stage.end).position;
            for axis in [X, Y] {
                let row = sensitivity.row(axis).transpose();
                let weight = share * POSITION_WEIGHT;
                hessian.ger(weight, &row, &row, 1.0);
                gradient += weight * (state[axis] - wanted[axis]) * row;
            }
            for (axis, weight) in self.rate_weights.into_iter().enumerate() {
                let weight = share * weight / (stage.length * stage.length);
                let change = self.plan[index + 1][axis] - self.plan[index][axis];
                let after = 2 * index + axis;
                hessian[(after, after)] += weight;
                gradient[after] += weight * change;
                if let Some(before) = after.checked_sub(2) {
                    hessian[(before, before)] += weight;
                    hessian[(before, after)] -= weight;
                    hessian[(after, before)] -= weight;
                    gradient[before] -= weight * change;
                }
            }
        }
        self.solve(&hessian, &gradient)
    }

    /// How far each command may rise, how far its change may, and how far both may fall.
    fn bounds(&self) -> Vec<f64> {
        let limits = &self.limits;
        let rates = [limits.max_steering_rate, limits.max_acceleration];
        let mut bounds = Vec::with_capacity(4 * VARIABLES);
        for (stage, nodes) in self.stages.iter().zip(self.plan.windows(2)) {
            let [before, after] = [nodes[0], nodes[1]];
            let most = [limits.max_steering, limits.max_speed];
            let least = [-limits.max_steering, 0.0];
            for axis in 0..2 {
                let change = after[axis] - before[axis];
                let largest = rates[axis] * stage.length;
                bounds.extend([most[axis] - after[axis], largest - change]);
                bounds.extend([after[axis] - least[axis], largest + change]);
            }
        }
        bounds
    }

    fn solve(
        &self,
        hessian: &SMatrix<f64, VARIABLES, VARIABLES>,
        gradient: &SVector<f64, VARIABLES>,
    ) -> Option<[f64; VARIABLES]> {
        // The weights make the scale of the cost: that of an error of 1 cm.
        let cost = CscMatrix::from(&hessian.upper_triangle().transpose().data.0);
        let (gradient, bounds) = (gradient.as_slice(), self.bounds());
        let change = quadratic::minimum(&cost, gradient, &self.bounded, &bounds)?;
        change.try_into().ok()
    }
}

/// Where a time (s) after the beginning of the plan lies between its nodes.
fn place(ends: &[f64; STAGES], time: f64) -> Place {
    let stage = ends.partition_point(|end| *end < time).min(STAGES - 1);
    let begin = stage.checked_sub(1).map_or(0.0, |before| ends[before]);
    let share = (time - begin) / (ends[stage] - begin);
    (stage, share.clamp(0.0, 1.0))
}

/// The commands at a place of a plan.
fn at(plan: &[[f64; 2]; STAGES + 1], (node, share): Place) -> [f64; 2] {
    [0, 1].map(|axis| plan[node][axis] + share * (plan[node + 1][axis] - plan[node][axis]))
}

#[cfg(test)]
mod tests {
    use libm::{atan2, hypot};
    use singletrack_control::{Position, SingleTrack, SingleTrackState, Time};

    use super::super::course::{Course, PathName};
    use super::*;

    const PERIOD_S: f64 = 0.01;
    const ACTUATORS: ActuatorModel = ActuatorModel {
        steering_dead_time: 0.0,
        steering_lag: 0.04,
        speed_dead_time: 0.0,
        speed_lag: 0.08,
    };

    fn model(friction: f64, lags: [f64; 2]) -> Model {
        Model {
            vehicle: VehicleParameters {
                friction,
                ..VehicleParameters::paper()
            },
            lags,
            bias: SVector::zeros(),
        }
    }

    #[test]
    fn a_linearised_step_is_that_of_the_model_but_for_the_square_of_a_change() {
        let model = model(0.25, [0.04, 0.08]);
        let state = State::from([1.0, 2.0, 0.5, 0.02, 0.8, 1.2, 0.2]);
        let acting = [[0.2, 0.25], [1.2, 1.3]];
        let (next, by_state, by_command) = model.linearise(&state, acting, 0.03);
        let error = |size: f64| {
            let change = size * State::from([0.3, -0.2, 0.5, 0.1, -0.7, 0.4, 0.6]);
            let command = size * SVector::from([0.5, -0.3, 0.2, 0.8]);
            let of = |axis: usize| [0, 1].map(|edge| acting[axis][edge] + command[2 * axis + edge]);
            let true_next = model.after(&(state + change), [of(0), of(1)], 0.03);
            (next + by_state * change + by_command * command - true_next).norm()
        };
        let [small, large] = [1e-3, 1e-2].map(error);
        assert!(large < 1e-3, "{large}");
        assert!(small < large / 50.0, "{small} {large}");
    }

    #[test]
    fn with_tyres_that_hold_the_model_is_that_of_equations_1_and_2() {
        let model = model(1e3, [0.0; 2]);
        let truth = SingleTrack::new(model.vehicle);
        let [speed, steering, step] = [1.2, 0.1, 1e-3];
        let mut state = State::zeros();
        state[SPEED] = speed;
        let l_f = model.vehicle.front_axle_distance_m;
        state[X] = l_f;
        let mut car = SingleTrackState::default();
        for _ in 0..500 {
            state = model.after(&state, [[steering; 2], [speed; 2]], step);
            for _ in 0..10 {
                let slope = truth.derivative(&car, speed, steering);
                let part = 0.1 * step;
                car.x += part * slope.x;
                car.y += part * slope.y;
                car.yaw += part * slope.yaw;
                car.yaw_rate += part * slope.yaw_rate;
                car.sideslip += part * slope.sideslip;
            }
        }
        // The speed of G is that forward but for the cosine of the sideslip, 0.03 rad.
        assert!((state[YAW_RATE] - car.yaw_rate).abs() < 1e-3 * car.yaw_rate);
        assert!((state[ACROSS] / speed - car.sideslip).abs() < 1e-3);
        let front = [car.x + l_f * cos(car.yaw), car.y + l_f * sin(car.yaw)];
        let error = hypot(state[X] - front[0], state[Y] - front[1]);
        assert!(error < 2e-3, "{error}");
    }

    /// A drive on the model itself from `aside` (m) to the left of a circle: the largest distance
    /// of the front axle from its reference in the last second, in m, and the commands.
    fn circle(aside: f64, seconds: f64) -> (f64, Vec<[f64; 2]>) {
        let course = Course::new(PathName::Circle, 1.0);
        let table = Table::new(&course, seconds + 5.0).unwrap();
        let mut law = predictive(&table);
        let plant = model(0.25, [ACTUATORS.steering_lag, ACTUATORS.speed_lag]);
        let mut state = State::zeros();
        state[X] = course.start[0] - aside;
        state[Y] = course.start[1];
        state[YAW] = course.heading;
        let (mut commands, mut last) = (vec![[0.0; 2]], 0.0_f64);
        for tick in 0..(seconds / PERIOD_S) as u32 {
            let time = f64::from(tick) * PERIOD_S;
            let wanted = table.at(time).position;
            if time > seconds - 1.0 {
                last = last.max(hypot(state[X] - wanted[0], state[Y] - wanted[1]));
            }
            let [steering, speed] = commands[commands.len() - 1];
            let estimate = seen(&plant, &state);
            let known = Known {
                estimate: &estimate,
                steering,
                speed,
                time,
            };
            commands.push(law.answer(&known));
            let forward = speed * cos(estimate.sideslip);
            state = plant.after(&state, [[steering; 2], [forward; 2]], PERIOD_S);
        }
        (last, commands)
    }

    fn predictive(table: &Table) -> Predictive<'_> {
        let vehicle = VehicleParameters::paper();
        let weights = [0.01, 0.3];
        Predictive::new(
            weights,
            vehicle,
            ACTUATORS,
            Limits::paper(),
            PERIOD_S,
            table,
        )
    }

    fn seen(model: &Model, state: &State) -> Estimate {
        let l_f = model.vehicle.front_axle_distance_m;
        let yaw = state[YAW];
        Estimate {
            time: Time(0),
            position: Position::new(state[X] - l_f * cos(yaw), state[Y] - l_f * sin(yaw)),
            yaw,
            yaw_rate: state[YAW_RATE],
            sideslip: atan2(state[ACROSS], state[SPEED]),
            speed: hypot(state[ACROSS], state[SPEED]),
            pose_time: Time(0),
        }
    }

    #[test]
    fn a_front_axle_from_beside_a_circle_comes_onto_it_within_the_limits() {
        let limits = Limits::paper();
        let (error, commands) = circle(0.3, 8.0);
        // Commands are held for a period, which the plan takes for an even change: half of the way of
        // a period, at 1 m/s.
        assert!(error < 0.5 * PERIOD_S, "{error}");
        let most = [limits.max_steering_rate, limits.max_acceleration].map(|rate| rate * PERIOD_S);
        for pair in commands.windows(2) {
            let [steering, speed] = [0, 1].map(|axis| (pair[1][axis] - pair[0][axis]).abs());
            // The speed of G is that forward over the cosine of the sideslip.
            assert!(
                steering < most[0] + 1e-6 && speed < 1.1 * most[1],
                "{pair:?}"
            );
            assert!(pair[1][0].abs() < limits.max_steering + 1e-6, "{pair:?}");
            assert!(
                (0.0..=1.02 * limits.max_speed).contains(&pair[1][1]),
                "{pair:?}"
            );
        }
        let widest = commands.iter().map(|[steering, _]| steering.abs());
        assert!(widest.fold(0.0, f64::max) > 0.9 * limits.max_steering);
    }

    #[test]
    fn without_a_solution_the_last_plan_is_driven_on() {
        let course = Course::new(PathName::Circle, 1.0);
        let table = Table::new(&course, 5.0).unwrap();
        let mut law = predictive(&table);
        let mut state = State::zeros();
        [state[X], state[Y]] = course.start;
        state[YAW] = course.heading;
        let mut estimate = seen(&law.model, &state);
        let mut command = [0.0; 2];
        for tick in 0..3 {
            let plan = law.plan;
            if tick == 2 {
                estimate.position.x = f64::NAN;
            }
            command = law.answer(&Known {
                estimate: &estimate,
                steering: command[0],
                speed: command[1],
                time: f64::from(tick) * PERIOD_S,
            });
            if tick == 2 {
                assert_eq!(command, plan[2]);
                assert!(command[1] > 0.0, "{command:?}");
            }
        }
    }
}
