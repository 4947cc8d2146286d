//! Environments for reinforcement learning: many cars side by side.

use std::{f64::consts::TAU, sync::Mutex, thread};

use numpy::{PyArray1, PyArray2, PyReadonlyArray2, ndarray::Array2};
use pyo3::{exceptions::PyValueError, prelude::*};
use rand_chacha::{
    ChaCha8Rng,
    rand_core::{Rng, SeedableRng},
};
use singletrack_control::{Position, Reference, front_point};

use crate::{
    setup::{Setup, SetupError, TruthRange, reference},
    vehicle::{Command, Plant, Seen, System, Vehicle},
};

/// Points of a lap of the reference, for the progress along it.
const LAP_POINTS: usize = 1_000;
/// How far ahead of the last place on the lap the next one is searched, in points.
const SEARCH: usize = 40;
/// Columns of the state.
const STATE: usize = 7;
/// The state and the last action at the head of an observation.
const HEAD: usize = 6;
/// Columns of an observation for each previewed point of the reference.
const PREVIEW: usize = 4;
/// Columns of the information on a step.
const INFORMATION: usize = 3;

/// What a car is rewarded for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Reward {
    /// P is where the reference is.
    Tracking,
    /// P goes on along the path of the reference, at any time.
    Progress,
}

/// The level of the action.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Control {
    Actuation,
    PointVelocity,
}

/// What happens after the end of an episode, with gymnasium's words.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Autoreset {
    NextStep,
    SameStep,
    Disabled,
}

/// What all cars have in common.
struct Task {
    setup: Setup,
    whole_system: bool,
    reference: Reference,
    lap: Option<Lap>,
    reward: Reward,
    control: Control,
    autoreset: Autoreset,
    /// Control periods in a step.
    periods: u32,
    max_steps: u32,
    /// Times ahead of the present at which the reference is seen, in s.
    preview: Vec<f64>,
    /// The distance between P and the reference that ends an episode, in m.
    lost_m: f64,
    /// Largest errors of the start, in m and rad.
    start_error: [f64; 2],
    randomise: Vec<TruthRange>,
    length: f64,
    front: f64,
}

/// A lap of the reference, or its whole way.
struct Lap {
    points: Vec<[f64; 2]>,
    /// Way to each point, in m.
    way: Vec<f64>,
    duration: f64,
    closed: bool,
}

impl Lap {
    fn new(reference: &Reference) -> Option<Self> {
        let (start, duration, closed) = match reference {
            Reference::Circle(circle) => (0.0, TAU / circle.angular_velocity().abs(), true),
            Reference::FigureOfEight(_) => return None,
            Reference::Path(path) if path.is_closed() => {
                // The first lap begins at rest.
                (path.lap_time(), path.lap_time(), true)
            }
            other => (0.0, other.duration()?, false),
        };
        let points: Vec<[f64; 2]> = (0..=LAP_POINTS)
            .filter_map(|index| {
                let time = start + duration * index as f64 / LAP_POINTS as f64;
                reference.at(time).position.map(|point| [point.x, point.y])
            })
            .collect();
        let mut sum = 0.0;
        let mut way = vec![0.0];
        for pair in points.windows(2) {
            if let [[x0, y0], [x1, y1]] = pair {
                sum += libm::hypot(x1 - x0, y1 - y0);
                way.push(sum);
            }
        }
        (points.len() == LAP_POINTS + 1 && duration.is_finite()).then_some(Self {
            points,
            way,
            duration,
            closed,
        })
    }

    fn length(&self) -> f64 {
        self.way.last().copied().unwrap_or_default()
    }

    /// The place nearest to `point` near `from`, and the distance to it.
    fn nearest(&self, [x, y]: [f64; 2], from: usize) -> (usize, f64) {
        let mut best = (from, f64::INFINITY);
        for offset in 0..=2 * SEARCH {
            let at = from + offset + LAP_POINTS - SEARCH / 2;
            let index = if self.closed {
                at % LAP_POINTS
            } else {
                (at - LAP_POINTS.min(at)).min(LAP_POINTS)
            };
            if let Some([px, py]) = self.points.get(index) {
                let distance = libm::hypot(px - x, py - y);
                if distance < best.1 {
                    best = (index, distance);
                }
            }
        }
        best
    }

    /// The way from one place to another, in m; at most half of a closed lap.
    fn between(&self, from: usize, to: usize) -> f64 {
        let at = |index: usize| self.way.get(index).copied().unwrap_or_default();
        let way = at(to) - at(from);
        let length = self.length();
        if self.closed && way > length / 2.0 {
            way - length
        } else if self.closed && way < -length / 2.0 {
            way + length
        } else {
            way
        }
    }
}

/// One car.
struct Instance {
    vehicle: Option<Vehicle>,
    generator: ChaCha8Rng,
    steps: u32,
    action: [f64; 2],
    place: usize,
    ended: bool,
    outcome: Outcome,
}

/// The result of a step.
#[derive(Clone, Debug)]
struct Outcome {
    state: [f64; STATE],
    observation: Vec<f32>,
    reward: f64,
    terminated: bool,
    truncated: bool,
    /// Distance from P to the reference (m), way along the lap (m), true speed (m/s).
    information: [f64; INFORMATION],
    reason: &'static str,
    /// The last state and observation of an episode that ended in this step.
    last: Option<([f64; STATE], Vec<f32>)>,
}

impl Task {
    fn columns(&self) -> usize {
        HEAD + PREVIEW * self.preview.len()
    }

    fn point(&self, seen: &Seen) -> Position {
        front_point(
            Position::new(seen.x, seen.y),
            seen.yaw,
            seen.steering,
            self.front,
            self.length,
        )
    }

    /// The time on the reference that counts: that of the episode or that of the place.
    fn time(&self, instance: &Instance) -> f64 {
        match (&self.lap, self.reward) {
            (Some(lap), Reward::Progress) => {
                lap.duration * instance.place as f64 / LAP_POINTS as f64
            }
            _ => f64::from(instance.steps) * f64::from(self.periods) * 0.01,
        }
    }

    fn reset(&self, instance: &mut Instance) -> Result<(), SetupError> {
        let at = self.reference.at(0.0);
        let soon = self.reference.at(0.05);
        let begin = at.position.unwrap_or_default();
        // At rest the direction is that of the way.
        let way = soon.position.unwrap_or_default() - begin;
        let course = if way.norm() > 0.0 { way } else { at.velocity };
        let mut draw = |most: f64| most * (2.0 * uniform(&mut instance.generator) - 1.0);
        let [position_error, yaw_error] = self.start_error;
        let point = [
            begin.x + draw(position_error),
            begin.y + draw(position_error),
        ];
        let yaw = libm::atan2(course.y, course.x) + draw(yaw_error);
        let drawn: Vec<(&TruthRange, f64)> = self
            .randomise
            .iter()
            .map(|range| {
                let share = uniform(&mut instance.generator);
                (range, range.low + share * (range.high - range.low))
            })
            .collect();
        let seed = instance.generator.next_u64();
        let simulation = self
            .setup
            .simulation(seed, self.setup.start(point, yaw), &drawn)?;
        instance.vehicle = Some(if self.whole_system {
            Vehicle::System(Box::new(System::new(&self.setup, simulation, seed)?))
        } else {
            Vehicle::Plant(Box::new(Plant::new(&self.setup, &simulation)?))
        });
        instance.steps = 0;
        instance.action = [0.0; 2];
        instance.place = 0;
        instance.ended = false;
        self.observe(instance);
        let outcome = &mut instance.outcome;
        outcome.reward = 0.0;
        outcome.terminated = false;
        outcome.truncated = false;
        outcome.reason = "";
        outcome.last = None;
        Ok(())
    }

    fn step(&self, instance: &mut Instance, action: [f64; 2]) -> Result<(), SetupError> {
        instance.outcome.last = None;
        if instance.ended {
            return match self.autoreset {
                // The action is ignored.
                Autoreset::NextStep => self.reset(instance),
                Autoreset::SameStep | Autoreset::Disabled => Err(SetupError::new(
                    "the episode has ended: reset the environment before the next step",
                )),
            };
        }
        if !action.iter().all(|value| value.is_finite()) {
            return Err(SetupError::new(format!(
                "the action is {action:?}: it must be finite"
            )));
        }
        let limits = &self.setup.config.limits;
        let command = match self.control {
            Control::Actuation => {
                let [steering, speed] = action;
                let most = limits.max_steering_rad;
                Command::Actuate([
                    steering.clamp(-most, most),
                    speed.clamp(-limits.max_reverse_speed_m_s, limits.max_speed_m_s),
                ])
            }
            Control::PointVelocity => Command::PointVelocity(action),
        };
        let Some(vehicle) = &mut instance.vehicle else {
            return Err(SetupError::new(
                "reset the environment before the first step",
            ));
        };
        let drives = (0..self.periods).all(|_| vehicle.step(command));
        let reason = vehicle.reason();
        let truth = vehicle.truth();
        instance.steps += 1;
        let before = instance.place;
        let point = self.point(&truth);
        let place = [point.x, point.y];
        let mut distance = 0.0;
        let mut progress = 0.0;
        if let Some(lap) = &self.lap {
            let (nearest, off) = lap.nearest(place, before);
            instance.place = nearest;
            progress = lap.between(before, nearest);
            distance = off;
        }
        let time = self.time(instance);
        if self.reward == Reward::Tracking
            && let Some(wanted) = self.reference.at(time).position
        {
            distance = (wanted - point).norm();
        }
        let change = [
            action[0] - instance.action[0],
            action[1] - instance.action[1],
        ];
        let effort = 0.05 * (change[0] * change[0] + change[1] * change[1]);
        let reward = match self.reward {
            Reward::Tracking => libm::exp(-distance / 0.1) - effort,
            Reward::Progress => {
                let step = f64::from(self.periods) * 0.01;
                progress / (step * limits.max_speed_m_s) - distance - effort
            }
        };
        let ended_way = self.reference.duration().is_some_and(|end| time >= end);
        instance.action = action;
        self.observe(instance);
        let outcome = &mut instance.outcome;
        outcome.terminated = !drives || distance > self.lost_m;
        outcome.truncated = !outcome.terminated && (instance.steps >= self.max_steps || ended_way);
        outcome.reward = if outcome.terminated { -10.0 } else { reward };
        outcome.information = [distance, progress, truth.speed];
        outcome.reason = if drives && outcome.terminated {
            "lost"
        } else {
            reason
        };
        instance.ended = outcome.terminated || outcome.truncated;
        if instance.ended && self.autoreset == Autoreset::SameStep {
            let ended = outcome.clone();
            self.reset(instance)?;
            let first = &instance.outcome;
            instance.outcome = Outcome {
                last: Some((ended.state, ended.observation.clone())),
                state: first.state,
                observation: first.observation.clone(),
                ..ended
            };
        }
        Ok(())
    }

    /// Writes state and observation of the present moment.
    fn observe(&self, instance: &mut Instance) {
        let seen = instance
            .vehicle
            .as_ref()
            .map(Vehicle::seen)
            .unwrap_or_default();
        let time = self.time(instance);
        let outcome = &mut instance.outcome;
        outcome.state = [
            seen.x,
            seen.y,
            seen.steering,
            seen.speed,
            seen.yaw,
            seen.yaw_rate,
            seen.sideslip,
        ];
        let point = self.point(&seen);
        let (sine, cosine) = libm::sincos(seen.yaw);
        let columns = &mut outcome.observation;
        columns.clear();
        let head = [
            seen.speed,
            seen.sideslip,
            seen.yaw_rate,
            seen.steering,
            instance.action[0],
            instance.action[1],
        ];
        columns.extend(head.map(|value| value as f32));
        for ahead in &self.preview {
            let wanted = self.reference.at(time + ahead);
            let way = wanted.position.unwrap_or(point) - point;
            let velocity = wanted.velocity;
            let turned = [
                cosine * way.x + sine * way.y,
                -sine * way.x + cosine * way.y,
                cosine * velocity.x + sine * velocity.y,
                -sine * velocity.x + cosine * velocity.y,
            ];
            columns.extend(turned.map(|value| value as f32));
        }
    }
}

/// Uniform in [0, 1).
fn uniform(generator: &mut ChaCha8Rng) -> f64 {
    (generator.next_u64() >> 11) as f64 / (1_u64 << 53) as f64
}

/// Cars side by side, which are stepped together.
#[pyclass(frozen, module = "singletrack._native")]
pub(crate) struct Batch(Mutex<Cars>);

struct Cars {
    task: Task,
    instances: Vec<Instance>,
    threads: usize,
}

impl Cars {
    /// Calls `each` for every car, on several threads. A car does not depend on the others.
    fn for_each(
        &mut self,
        each: impl Fn(&Task, usize, &mut Instance) -> Result<(), SetupError> + Sync,
    ) -> Result<(), SetupError> {
        let task = &self.task;
        let run = |first: usize, chunk: &mut [Instance]| {
            chunk
                .iter_mut()
                .enumerate()
                .try_for_each(|(index, instance)| each(task, first + index, instance))
        };
        let threads = self.threads.clamp(1, self.instances.len().max(1));
        if threads == 1 {
            return run(0, &mut self.instances);
        }
        let share = self.instances.len().div_ceil(threads);
        thread::scope(|scope| {
            let workers: Vec<_> = self
                .instances
                .chunks_mut(share)
                .enumerate()
                .map(|(number, chunk)| scope.spawn(move || run(number * share, chunk)))
                .collect();
            workers.into_iter().try_for_each(|worker| {
                worker
                    .join()
                    .unwrap_or_else(|_| Err(SetupError::new("a simulation has panicked")))
            })
        })
    }
}

/// `(state, observation, reward, terminated, truncated, information)`.
type Arrays<'py> = (
    Bound<'py, PyArray2<f64>>,
    Bound<'py, PyArray2<f32>>,
    Bound<'py, PyArray1<f64>>,
    Bound<'py, PyArray1<bool>>,
    Bound<'py, PyArray1<bool>>,
    Bound<'py, PyArray2<f64>>,
);

/// Index of a car, its state and its observation.
type Last<'py> = (usize, Bound<'py, PyArray1<f64>>, Bound<'py, PyArray1<f32>>);

fn refuse(error: impl ToString) -> PyErr {
    PyValueError::new_err(error.to_string())
}

#[pymethods]
impl Batch {
    #[new]
    #[pyo3(signature = (num_envs, *, whole_system, reference_toml, configuration, truth, randomise,
        reward, control, autoreset, periods, max_steps, preview, lost_m, start_error, threads))]
    #[expect(clippy::too_many_arguments, reason = "keywords of Python")]
    fn new(
        num_envs: usize,
        whole_system: bool,
        reference_toml: &str,
        configuration: &str,
        truth: &str,
        randomise: Vec<(String, f64, f64)>,
        reward: &str,
        control: &str,
        autoreset: &str,
        periods: u32,
        max_steps: u32,
        preview: Vec<f64>,
        lost_m: f64,
        start_error: [f64; 2],
        threads: usize,
    ) -> PyResult<Self> {
        let section = reference(reference_toml).map_err(refuse)?;
        let wanted = section.reference().map_err(refuse)?;
        let setup = Setup::new(section, configuration, truth).map_err(refuse)?;
        if wanted.at(0.0).position.is_none() {
            return Err(refuse("the reference must have positions"));
        }
        let randomise = randomise
            .into_iter()
            .map(|(name, low, high)| {
                let (section, key) = name.split_once('.').ok_or_else(|| {
                    refuse(format!("randomise: write {name:?} as section.key"))
                })?;
                if !(low.is_finite() && high.is_finite() && low <= high) {
                    return Err(refuse(format!(
                        "randomise: {name} is between {low} and {high}: give two finite numbers in order"
                    )));
                }
                Ok(TruthRange {
                    section: section.to_owned(),
                    key: key.to_owned(),
                    low,
                    high,
                })
            })
            .collect::<PyResult<Vec<_>>>()?;
        let lap = Lap::new(&wanted);
        let reward = match reward {
            "tracking" => Reward::Tracking,
            "progress" if lap.is_some() => Reward::Progress,
            "progress" => {
                return Err(refuse(
                    "the reward \"progress\" needs a circle, a path or waypoints",
                ));
            }
            other => {
                return Err(refuse(format!(
                    "reward is {other:?}: use \"tracking\" or \"progress\""
                )));
            }
        };
        let task = Task {
            whole_system,
            lap,
            reward,
            control: match control {
                "actuation" => Control::Actuation,
                "point_velocity" => Control::PointVelocity,
                other => return Err(refuse(format!("control is {other:?}"))),
            },
            autoreset: match autoreset {
                "next_step" => Autoreset::NextStep,
                "same_step" => Autoreset::SameStep,
                "disabled" => Autoreset::Disabled,
                other => return Err(refuse(format!("autoreset is {other:?}"))),
            },
            reference: wanted,
            periods: periods.max(1),
            max_steps: max_steps.max(1),
            preview,
            lost_m,
            start_error,
            randomise,
            length: setup.config.law.point_distance_m,
            front: setup.config.law.front_axle_distance_m,
            setup,
        };
        // A mistake in the ranges is found here, at both of their ends.
        for end in [0.0, 1.0] {
            let drawn: Vec<_> = task
                .randomise
                .iter()
                .map(|range| (range, range.low + end * (range.high - range.low)))
                .collect();
            task.setup
                .simulation(0, task.setup.start([0.0; 2], 0.0), &drawn)
                .map_err(refuse)?;
        }
        let columns = task.columns();
        let instances = (0..num_envs)
            .map(|_| Instance {
                vehicle: None,
                generator: ChaCha8Rng::seed_from_u64(0),
                steps: 0,
                action: [0.0; 2],
                place: 0,
                ended: false,
                outcome: Outcome {
                    state: [0.0; STATE],
                    observation: vec![0.0; columns],
                    reward: 0.0,
                    terminated: false,
                    truncated: false,
                    information: [0.0; INFORMATION],
                    reason: "",
                    last: None,
                },
            })
            .collect();
        Ok(Self(Mutex::new(Cars {
            task,
            instances,
            threads,
        })))
    }

    /// Columns of an observation.
    #[getter]
    fn columns(&self) -> PyResult<usize> {
        Ok(self.cars()?.task.columns())
    }

    /// Largest steering angle, reverse speed and speed.
    #[getter]
    fn limits(&self) -> PyResult<(f64, f64, f64)> {
        let cars = self.cars()?;
        let limits = &cars.task.setup.config.limits;
        Ok((
            limits.max_steering_rad,
            limits.max_reverse_speed_m_s,
            limits.max_speed_m_s,
        ))
    }

    /// Resets the cars in `mask`, all without one. A seed of a car restarts its random numbers.
    #[pyo3(signature = (seeds, mask = None))]
    fn reset<'py>(
        &self,
        py: Python<'py>,
        seeds: Vec<Option<u64>>,
        mask: Option<Vec<bool>>,
    ) -> PyResult<Arrays<'py>> {
        py.detach(|| {
            self.cars()?
                .for_each(|task, index, instance| {
                    if mask
                        .as_ref()
                        .is_some_and(|mask| !mask.get(index).copied().unwrap_or(false))
                    {
                        return Ok(());
                    }
                    if let Some(Some(seed)) = seeds.get(index) {
                        instance.generator = ChaCha8Rng::seed_from_u64(*seed);
                    }
                    task.reset(instance)
                })
                .map_err(refuse)
        })?;
        self.arrays(py)
    }

    /// Steps all cars; `actions` has a row for each.
    fn step<'py>(
        &self,
        py: Python<'py>,
        actions: PyReadonlyArray2<'py, f64>,
    ) -> PyResult<Arrays<'py>> {
        let actions: Vec<[f64; 2]> = actions
            .as_array()
            .rows()
            .into_iter()
            .filter_map(|row| Some([*row.first()?, *row.get(1)?]))
            .collect();
        py.detach(|| {
            let mut cars = self.cars()?;
            if actions.len() != cars.instances.len() {
                return Err(refuse(format!(
                    "the actions have {} rows of two numbers: {} are needed",
                    actions.len(),
                    cars.instances.len()
                )));
            }
            cars.for_each(|task, index, instance| {
                task.step(instance, actions.get(index).copied().unwrap_or_default())
            })
            .map_err(refuse)
        })?;
        self.arrays(py)
    }

    /// The last state and observation of the episodes that ended in the last step and have
    /// been reset in it, by the index of the car.
    fn last<'py>(&self, py: Python<'py>) -> PyResult<Vec<Last<'py>>> {
        let cars = self.cars()?;
        Ok(cars
            .instances
            .iter()
            .enumerate()
            .filter_map(|(index, instance)| {
                let (state, observation) = instance.outcome.last.as_ref()?;
                Some((
                    index,
                    PyArray1::from_slice(py, state),
                    PyArray1::from_slice(py, observation),
                ))
            })
            .collect())
    }

    /// Why the episodes have ended, by the index of the car.
    fn reasons(&self) -> PyResult<Vec<(usize, &'static str)>> {
        let cars = self.cars()?;
        Ok(cars
            .instances
            .iter()
            .enumerate()
            .filter(|(_, instance)| !instance.outcome.reason.is_empty())
            .map(|(index, instance)| (index, instance.outcome.reason))
            .collect())
    }

    /// Ground truth: `pose_x, pose_y, delta, linear_vel_x, pose_theta, ang_vel_z, beta` of each.
    fn truth<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let cars = self.cars()?;
        let mut rows = Array2::zeros((cars.instances.len(), STATE));
        for (mut row, instance) in rows.outer_iter_mut().zip(&cars.instances) {
            let truth = instance.vehicle.as_ref().map(Vehicle::truth);
            let truth = truth.unwrap_or_default();
            let values = [
                truth.x,
                truth.y,
                truth.steering,
                truth.speed,
                truth.yaw,
                truth.yaw_rate,
                truth.sideslip,
            ];
            for (cell, value) in row.iter_mut().zip(values) {
                *cell = value;
            }
        }
        Ok(PyArray2::from_owned_array(py, rows))
    }

    /// Position and velocity of the reference at the present of each car: x, y, `v_x`, `v_y`.
    fn reference<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let cars = self.cars()?;
        let mut rows = Array2::zeros((cars.instances.len(), 4));
        for (mut row, instance) in rows.outer_iter_mut().zip(&cars.instances) {
            let at = cars.task.reference.at(cars.task.time(instance));
            let position = at.position.unwrap_or_default();
            let values = [position.x, position.y, at.velocity.x, at.velocity.y];
            for (cell, value) in row.iter_mut().zip(values) {
                *cell = value;
            }
        }
        Ok(PyArray2::from_owned_array(py, rows))
    }

    /// P of each car, as it is seen: x, y.
    fn point<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let cars = self.cars()?;
        let mut rows = Array2::zeros((cars.instances.len(), 2));
        for (mut row, instance) in rows.outer_iter_mut().zip(&cars.instances) {
            let seen = instance.vehicle.as_ref().map(Vehicle::seen);
            let point = cars.task.point(&seen.unwrap_or_default());
            for (cell, value) in row.iter_mut().zip([point.x, point.y]) {
                *cell = value;
            }
        }
        Ok(PyArray2::from_owned_array(py, rows))
    }
}

impl Batch {
    fn cars(&self) -> PyResult<std::sync::MutexGuard<'_, Cars>> {
        self.0
            .lock()
            .map_err(|_| refuse("a simulation has panicked before"))
    }

    fn arrays<'py>(&self, py: Python<'py>) -> PyResult<Arrays<'py>> {
        let cars = self.cars()?;
        let count = cars.instances.len();
        let mut state = Array2::zeros((count, STATE));
        let mut observation = Array2::zeros((count, cars.task.columns()));
        let mut information = Array2::zeros((count, INFORMATION));
        for (index, instance) in cars.instances.iter().enumerate() {
            let outcome = &instance.outcome;
            copy(&mut state, index, &outcome.state);
            copy(&mut observation, index, &outcome.observation);
            copy(&mut information, index, &outcome.information);
        }
        let outcomes = || cars.instances.iter().map(|instance| &instance.outcome);
        Ok((
            PyArray2::from_owned_array(py, state),
            PyArray2::from_owned_array(py, observation),
            PyArray1::from_iter(py, outcomes().map(|outcome| outcome.reward)),
            PyArray1::from_iter(py, outcomes().map(|outcome| outcome.terminated)),
            PyArray1::from_iter(py, outcomes().map(|outcome| outcome.truncated)),
            PyArray2::from_owned_array(py, information),
        ))
    }
}

fn copy<T: Copy>(rows: &mut Array2<T>, index: usize, values: &[T]) {
    for (cell, value) in rows.row_mut(index).iter_mut().zip(values) {
        *cell = *value;
    }
}
