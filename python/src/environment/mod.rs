//! Environments for reinforcement learning: many cars side by side.

mod task;

use std::{
    sync::{Mutex, MutexGuard},
    thread,
};

use numpy::{PyArray1, PyArray2, PyReadonlyArray2, ndarray::Array2};
use pyo3::{prelude::*, types::PyTuple};
use rand_chacha::{ChaCha8Rng, rand_core::SeedableRng};
use singletrack_control::Start;
use singletrack_core::Config;
use singletrack_scenario::laboratory::{Setup, SetupError, TruthRange, reference};

use self::task::{Autoreset, Control, Instance, Lap, Options, Reward, Task, places, state};
use crate::{choice, refuse};

/// Places of the picture of a reference.
const PLACES: usize = 400;

/// Cars side by side, which are stepped together.
#[pyclass(frozen, module = "singletrack._native")]
pub(crate) struct Batch(Mutex<Cars>);

struct Cars {
    task: Task,
    instances: Vec<Instance>,
    threads: usize,
}

impl Cars {
    /// An array with a row for each car.
    fn rows<'py, const N: usize>(
        &self,
        py: Python<'py>,
        row: impl Fn(&Task, &Instance) -> [f64; N],
    ) -> Bound<'py, PyArray2<f64>> {
        let rows = self.instances.iter().map(|one| row(&self.task, one));
        let rows: Vec<[f64; N]> = rows.collect();
        PyArray2::from_owned_array(py, Array2::from(rows))
    }

    /// Calls `each` for every car, on several threads. A car does not depend on the others.
    fn for_each(
        &mut self,
        each: impl Fn(&Task, usize, &mut Instance) -> Result<(), SetupError> + Sync,
    ) -> Result<(), SetupError> {
        let task = &self.task;
        let run = |first: usize, chunk: &mut [Instance]| {
            let mut cars = (first..).zip(chunk);
            cars.try_for_each(|(index, instance)| each(task, index, instance))
        };
        let threads = self.threads.clamp(1, self.instances.len().max(1));
        if threads == 1 {
            return run(0, &mut self.instances);
        }
        let share = self.instances.len().div_ceil(threads);
        thread::scope(|scope| {
            let chunks = self.instances.chunks_mut(share).enumerate();
            let workers = chunks
                .map(|(number, chunk)| scope.spawn(move || run(number * share, chunk)))
                .collect::<Vec<_>>();
            let panicked = |_| Err(SetupError::new("a simulation has panicked"));
            let mut workers = workers.into_iter();
            workers.try_for_each(|worker| worker.join().unwrap_or_else(panicked))
        })
    }
}

/// Index of a car, its state and its observation.
type Last<'py> = (usize, Bound<'py, PyArray1<f64>>, Bound<'py, PyArray1<f32>>);

#[pymethods]
impl Batch {
    #[new]
    fn new(num_envs: usize, options: Options) -> PyResult<Self> {
        let section = reference(&options.reference_toml).map_err(refuse)?;
        let wanted = section.reference().map_err(refuse)?;
        let start = section.start();
        let setup = Setup::new(section, &options.configuration, &options.truth).map_err(refuse)?;
        if wanted.at(0.0).position.is_none() {
            return Err(refuse("the reference must have positions"));
        }
        let randomise = options.randomise.iter().map(range);
        let randomise = randomise.collect::<PyResult<Vec<_>>>()?;
        let lap = Lap::new(&wanted);
        let rewards = [
            ("tracking", Reward::Tracking),
            ("progress", Reward::Progress),
        ];
        let reward = choice("reward", &options.reward, &rewards)?;
        if reward == Reward::Progress && lap.is_none() {
            return Err(refuse(
                "the reward \"progress\" needs a circle, a path or waypoints",
            ));
        }
        let controls = [
            ("steering_angle, speed", Control::SteeringSpeed),
            ("speed, steering_angle", Control::SpeedSteering),
            ("point_velocity", Control::PointVelocity),
        ];
        let autoresets = [
            ("next_step", Autoreset::NextStep),
            ("same_step", Autoreset::SameStep),
            ("disabled", Autoreset::Disabled),
        ];
        let threads = options.threads;
        let task = Task {
            // The progress along a lap is measured wherever a drive begins.
            nearest: reward == Reward::Tracking && start == Start::Nearest,
            lap,
            reward,
            control: choice("control_input", &options.control, &controls)?,
            autoreset: choice("autoreset", &options.autoreset, &autoresets)?,
            reference: wanted,
            randomise,
            setup,
            options,
        };
        task.check().map_err(refuse)?;
        let columns = task.columns();
        Ok(Self(Mutex::new(Cars {
            task,
            instances: (0..num_envs).map(|_| Instance::new(columns)).collect(),
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

    /// Distances from G to the front and to the rear axle, and from the front axle to P.
    #[getter]
    fn geometry(&self) -> PyResult<(f64, f64, f64)> {
        let cars = self.cars()?;
        let Config { law, vehicle, .. } = &cars.task.setup.config;
        let rear = vehicle.rear_axle_distance_m;
        Ok((law.front_axle_distance_m, rear, law.point_distance_m))
    }

    /// Places of a lap of the reference, or of its whole way: x, y.
    fn path<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let cars = self.cars()?;
        let reference = &cars.task.reference;
        let lap = reference.lap_time();
        let duration = lap.or_else(|| reference.duration()).unwrap_or_default();
        // The first lap of a path begins at rest.
        let begin = lap.unwrap_or_default();
        let places = places(reference, begin, duration, PLACES);
        Ok(PyArray2::from_owned_array(py, Array2::from(places)))
    }

    /// Resets the cars in `mask`, all without one. A seed of a car restarts its random numbers.
    #[pyo3(signature = (seeds, mask = None))]
    fn reset<'py>(
        &self,
        py: Python<'py>,
        seeds: Vec<Option<u64>>,
        mask: Option<Vec<bool>>,
    ) -> PyResult<Bound<'py, PyTuple>> {
        self.for_each(py, |task, index, instance| {
            if mask
                .as_ref()
                .is_some_and(|mask| mask.get(index) != Some(&true))
            {
                return Ok(());
            }
            if let Some(Some(seed)) = seeds.get(index) {
                instance.generator = ChaCha8Rng::seed_from_u64(*seed);
            }
            task.reset(instance)
        })?;
        self.arrays(py)
    }

    /// Steps all cars; `actions` has a row for each.
    fn step<'py>(
        &self,
        py: Python<'py>,
        actions: PyReadonlyArray2<'py, f64>,
    ) -> PyResult<Bound<'py, PyTuple>> {
        let rows = actions.as_array();
        let rows = rows.rows().into_iter();
        let actions: Vec<[f64; 2]> = rows
            .filter_map(|row| Some([*row.first()?, *row.get(1)?]))
            .collect();
        py.detach(|| {
            let mut cars = self.cars()?;
            let (given, needed) = (actions.len(), cars.instances.len());
            if given != needed {
                return Err(refuse(format!(
                    "the actions have {given} rows of two numbers: {needed} are needed"
                )));
            }
            let step = |task: &Task, index: usize, instance: &mut Instance| {
                task.step(instance, actions.get(index).copied().unwrap_or_default())
            };
            cars.for_each(step).map_err(refuse)
        })?;
        self.arrays(py)
    }

    /// Steps the only car: `(state, observation, reward, terminated, truncated, information, reason)`,
    /// without arrays for many.
    fn step_one<'py>(
        &self,
        py: Python<'py>,
        first: f64,
        second: f64,
    ) -> PyResult<Bound<'py, PyTuple>> {
        self.for_each(py, |task, _, instance| task.step(instance, [first, second]))?;
        let cars = self.cars()?;
        let [instance] = cars.instances.as_slice() else {
            return Err(refuse("there is not one car"));
        };
        let outcome = &instance.outcome;
        let one = (
            PyArray1::from_slice(py, &outcome.state),
            PyArray1::from_slice(py, &outcome.observation),
            outcome.reward,
            outcome.terminated,
            outcome.truncated,
            outcome.information,
            outcome.reason,
        );
        one.into_pyobject(py)
    }

    /// The last state and observation of the episodes that ended in the last step and have
    /// been reset in it, by the index of the car.
    fn last<'py>(&self, py: Python<'py>) -> PyResult<Vec<Last<'py>>> {
        self.each(|index, instance| {
            let (state, observation) = instance.outcome.last.as_ref()?;
            let state = PyArray1::from_slice(py, state);
            Some((index, state, PyArray1::from_slice(py, observation)))
        })
    }

    /// Why the episodes have ended, by the index of the car.
    fn reasons(&self) -> PyResult<Vec<(usize, &'static str)>> {
        self.each(|index, instance| {
            let reason = instance.outcome.reason;
            (!reason.is_empty()).then_some((index, reason))
        })
    }

    /// Steps of each episode so far.
    fn steps(&self) -> PyResult<Vec<u32>> {
        self.each(|_, instance| Some(instance.steps))
    }

    /// Ground truth: `pose_x, pose_y, delta, linear_vel_x, pose_theta, ang_vel_z, beta` of each.
    fn truth<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let cars = self.cars()?;
        Ok(cars.rows(py, |_, instance| state(&instance.truth())))
    }

    /// Position and velocity of the reference at the present of each car: x, y, `v_x`, `v_y`.
    fn reference<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        Ok(self.cars()?.rows(py, |task, instance| {
            let at = task.at(instance);
            let position = at.position.unwrap_or_default();
            [position.x, position.y, at.velocity.x, at.velocity.y]
        }))
    }

    /// P of each car, as it is seen: x, y.
    fn point<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        Ok(self.cars()?.rows(py, |task, instance| {
            let point = task.point(&instance.seen());
            [point.x, point.y]
        }))
    }
}

impl Batch {
    fn cars(&self) -> PyResult<MutexGuard<'_, Cars>> {
        self.0
            .lock()
            .map_err(|_| refuse("a simulation has panicked before"))
    }

    /// Calls `each` for every car, with its index, while other threads of Python run.
    fn for_each(
        &self,
        py: Python<'_>,
        each: impl Fn(&Task, usize, &mut Instance) -> Result<(), SetupError> + Send + Sync,
    ) -> PyResult<()> {
        py.detach(|| self.cars()?.for_each(each).map_err(refuse))
    }

    /// What `of` finds of each car, with its index.
    fn each<T>(&self, mut of: impl FnMut(usize, &Instance) -> Option<T>) -> PyResult<Vec<T>> {
        let cars = self.cars()?;
        let instances = cars.instances.iter().enumerate();
        let found = instances.filter_map(|(index, instance)| of(index, instance));
        Ok(found.collect())
    }

    /// `(state, observation, reward, terminated, truncated, information)` of all cars.
    fn arrays<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyTuple>> {
        let cars = self.cars()?;
        let outcomes = || cars.instances.iter().map(|instance| &instance.outcome);
        let seen: Vec<f32> = outcomes()
            .flat_map(|one| &one.observation)
            .copied()
            .collect();
        let shape = (cars.instances.len(), cars.task.columns());
        let observation = Array2::from_shape_vec(shape, seen).map_err(refuse)?;
        let arrays = (
            cars.rows(py, |_, instance| instance.outcome.state),
            PyArray2::from_owned_array(py, observation),
            PyArray1::from_iter(py, outcomes().map(|outcome| outcome.reward)),
            PyArray1::from_iter(py, outcomes().map(|outcome| outcome.terminated)),
            PyArray1::from_iter(py, outcomes().map(|outcome| outcome.truncated)),
            cars.rows(py, |_, instance| instance.outcome.information),
        );
        arrays.into_pyobject(py)
    }
}

/// A range of the randomisation, checked.
fn range((name, low, high): &(String, f64, f64)) -> PyResult<TruthRange> {
    let (section, key) = name
        .split_once('.')
        .ok_or_else(|| refuse(format!("randomise: write {name:?} as section.key")))?;
    if !(low.is_finite() && high.is_finite() && low <= high) {
        return Err(refuse(format!(
            "randomise: {name} is between {low} and {high}: give two finite numbers in order"
        )));
    }
    Ok(TruthRange {
        section: section.to_owned(),
        key: key.to_owned(),
        low: *low,
        high: *high,
    })
}
