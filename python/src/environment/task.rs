//! The task of an environment: what is seen, rewarded and ends an episode of one car; a lap of its
//! reference, for the progress along it.

use std::{f64::consts::TAU, mem::swap};

use pyo3::FromPyObject;
use rand_chacha::{
    ChaCha8Rng,
    rand_core::{Rng, SeedableRng},
};
use singletrack_control::{Position, Reference, ReferencePoint, Start, front_point};
use singletrack_scenario::laboratory::{Setup, SetupError, TruthRange};
use singletrack_sim::Truth;

use crate::vehicle::{Command, Plant, System, Vehicle};

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
pub(super) enum Reward {
    /// P is where the reference is.
    Tracking,
    /// P goes on along the path of the reference, at any time.
    Progress,
}

/// The columns of the action.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Control {
    SteeringSpeed,
    SpeedSteering,
    PointVelocity,
}

/// What happens after the end of an episode, with gymnasium's words.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Autoreset {
    NextStep,
    SameStep,
    Disabled,
}

/// What Python asks for.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub(super) struct Options {
    pub(super) whole_system: bool,
    pub(super) reference_toml: String,
    pub(super) configuration: String,
    pub(super) truth: String,
    /// Keys of the truth with their ranges.
    pub(super) randomise: Vec<(String, f64, f64)>,
    pub(super) reward: String,
    pub(super) control: String,
    pub(super) autoreset: String,
    /// Control periods in a step.
    pub(super) periods: u32,
    pub(super) max_steps: u32,
    /// Times ahead of the present at which the reference is seen, in s.
    pub(super) preview: Vec<f64>,
    /// The distance between P and the reference that ends an episode, in m.
    pub(super) lost_m: f64,
    /// Largest errors of the start, in m and rad.
    pub(super) start_error: [f64; 2],
    pub(super) threads: usize,
}

/// What all cars have in common.
pub(super) struct Task {
    pub(super) options: Options,
    pub(super) setup: Setup,
    pub(super) reference: Reference,
    /// Whether an episode begins at the nearest place of the reference.
    pub(super) nearest: bool,
    pub(super) lap: Option<Lap>,
    pub(super) reward: Reward,
    pub(super) control: Control,
    pub(super) autoreset: Autoreset,
    pub(super) randomise: Vec<TruthRange>,
}

/// One car.
pub(super) struct Instance {
    pub(super) vehicle: Option<Box<dyn Vehicle>>,
    /// The reference of an episode that began at its nearest place.
    pub(super) reference: Option<Box<Reference>>,
    pub(super) generator: ChaCha8Rng,
    pub(super) steps: u32,
    action: [f64; 2],
    pub(super) place: usize,
    pub(super) ended: bool,
    pub(super) outcome: Outcome,
}

/// The result of a step.
#[derive(Clone, Debug, Default)]
pub(super) struct Outcome {
    pub(super) state: [f64; STATE],
    pub(super) observation: Vec<f32>,
    pub(super) reward: f64,
    pub(super) terminated: bool,
    pub(super) truncated: bool,
    /// Distance from P to the reference (m), way along the lap (m), true speed (m/s).
    pub(super) information: [f64; INFORMATION],
    pub(super) reason: &'static str,
    /// The last state and observation of an episode that ended in this step.
    pub(super) last: Option<([f64; STATE], Vec<f32>)>,
}

impl Instance {
    /// A car before its first reset.
    pub(super) fn new(columns: usize) -> Self {
        Self {
            vehicle: None,
            reference: None,
            generator: ChaCha8Rng::seed_from_u64(0),
            steps: 0,
            action: [0.0; 2],
            place: 0,
            ended: false,
            outcome: Outcome {
                observation: vec![0.0; columns],
                ..Outcome::default()
            },
        }
    }

    /// The state as it is seen.
    pub(super) fn seen(&self) -> Truth {
        let vehicle = self.vehicle.as_ref();
        vehicle.map_or_else(Truth::default, |vehicle| vehicle.seen())
    }

    /// The ground truth.
    pub(super) fn truth(&self) -> Truth {
        let vehicle = self.vehicle.as_ref();
        vehicle.map_or_else(Truth::default, |vehicle| vehicle.truth())
    }
}

/// The columns of a state.
pub(super) fn state(seen: &Truth) -> [f64; STATE] {
    [
        seen.x,
        seen.y,
        seen.steering,
        seen.speed,
        seen.yaw,
        seen.yaw_rate,
        seen.sideslip,
    ]
}

impl Task {
    /// Finds mistakes in the ranges, at both of their ends.
    pub(super) fn check(&self) -> Result<(), SetupError> {
        for share in [0.0, 1.0] {
            let start = self.setup.start([0.0; 2], 0.0);
            let drawn = self.drawn(|| share);
            self.setup.simulation(0, start, &drawn)?;
        }
        Ok(())
    }

    /// A number of each range, at a share of the way from its lower to its upper end.
    fn drawn(&self, mut share: impl FnMut() -> f64) -> Vec<(&TruthRange, f64)> {
        let ranges = self.randomise.iter();
        ranges
            .map(|range| (range, range.low + share() * (range.high - range.low)))
            .collect()
    }

    pub(super) fn columns(&self) -> usize {
        HEAD + PREVIEW * self.options.preview.len()
    }

    pub(super) fn point(&self, seen: &Truth) -> Position {
        let law = &self.setup.config.law;
        front_point(
            Position::new(seen.x, seen.y),
            seen.yaw,
            seen.steering,
            law.front_axle_distance_m,
            law.point_distance_m,
        )
    }

    /// The time on the reference that counts: that of the episode or that of the place.
    pub(super) fn time(&self, instance: &Instance) -> f64 {
        match (&self.lap, self.reward) {
            (Some(lap), Reward::Progress) => lap.time(instance.place),
            _ => f64::from(instance.steps) * f64::from(self.options.periods) * 0.01,
        }
    }

    /// The reference of a car.
    pub(super) fn at(&self, instance: &Instance) -> ReferencePoint {
        let reference = instance.reference.as_deref().unwrap_or(&self.reference);
        reference.at(self.time(instance))
    }

    pub(super) fn reset(&self, instance: &mut Instance) -> Result<(), SetupError> {
        let at = self.reference.at(0.0);
        let soon = self.reference.at(0.05);
        let begin = at.position.unwrap_or_default();
        // At rest the direction is that of the way.
        let way = soon.position.unwrap_or_default() - begin;
        let course = if way.norm() > 0.0 { way } else { at.velocity };
        let mut draw = |most: f64| most * (2.0 * uniform(&mut instance.generator) - 1.0);
        let [position_error, yaw_error] = self.options.start_error;
        let point = [begin.x, begin.y].map(|value| value + draw(position_error));
        let yaw = libm::atan2(course.y, course.x) + draw(yaw_error);
        let drawn = self.drawn(|| uniform(&mut instance.generator));
        let seed = instance.generator.next_u64();
        let start = self.setup.start(point, yaw);
        let simulation = self.setup.simulation(seed, start, &drawn)?;
        instance.vehicle = Some(match self.options.whole_system {
            true => Box::new(System::new(&self.setup, simulation, seed)?),
            false => Box::new(Plant::new(&self.setup, &simulation)?),
        });
        instance.reference = self.nearest.then(|| {
            let mut reference = Box::new(self.reference.clone());
            reference.begin(Start::Nearest, &Position::from(point), yaw);
            reference
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

    pub(super) fn step(&self, instance: &mut Instance, action: [f64; 2]) -> Result<(), SetupError> {
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
            Control::SteeringSpeed | Control::SpeedSteering => {
                let [mut steering, mut speed] = action;
                if self.control == Control::SpeedSteering {
                    swap(&mut steering, &mut speed);
                }
                let most = limits.max_steering_rad;
                Command::Actuate([
                    steering.clamp(-most, most),
                    speed.clamp(-limits.max_reverse_speed_m_s, limits.max_speed_m_s),
                ])
            }
            Control::PointVelocity => Command::PointVelocity(action),
        };
        let unset = || SetupError::new("reset the environment before the first step");
        let vehicle = instance.vehicle.as_mut().ok_or_else(unset)?;
        let drives = (0..self.options.periods).all(|_| vehicle.step(command));
        let reason = vehicle.reason();
        let truth = vehicle.truth();
        instance.steps += 1;
        let before = instance.place;
        let point = self.point(&truth);
        let place = [point.x, point.y];
        let (mut distance, mut progress) = (0.0, 0.0);
        if let Some(lap) = &self.lap {
            let (nearest, off) = lap.nearest(place, before);
            instance.place = nearest;
            progress = lap.between(before, nearest);
            distance = off;
        }
        let time = self.time(instance);
        if self.reward == Reward::Tracking
            && let Some(wanted) = self.at(instance).position
        {
            distance = (wanted - point).norm();
        }
        let change = |index: usize| action[index] - instance.action[index];
        let effort = 0.05 * (change(0) * change(0) + change(1) * change(1));
        let reward = match self.reward {
            Reward::Tracking => libm::exp(-distance / 0.1) - effort,
            Reward::Progress => {
                let step = f64::from(self.options.periods) * 0.01;
                progress / (step * limits.max_speed_m_s) - distance - effort
            }
        };
        let ended_way = self.reference.duration().is_some_and(|end| time >= end);
        instance.action = action;
        self.observe(instance);
        let outcome = &mut instance.outcome;
        outcome.terminated = !drives || distance > self.options.lost_m;
        outcome.truncated =
            !outcome.terminated && (instance.steps >= self.options.max_steps || ended_way);
        outcome.reward = if outcome.terminated { -10.0 } else { reward };
        outcome.information = [distance, progress, truth.speed];
        let is_lost = drives && outcome.terminated;
        outcome.reason = if is_lost { "lost" } else { reason };
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
        let seen = instance.seen();
        let time = self.time(instance);
        let reference = instance.reference.as_deref().unwrap_or(&self.reference);
        let outcome = &mut instance.outcome;
        outcome.state = state(&seen);
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
        for ahead in &self.options.preview {
            let wanted = reference.at(time + ahead);
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

/// The places of a reference from a time on, for a duration that is cut into such a number of parts.
pub(super) fn places(
    reference: &Reference,
    start: f64,
    duration: f64,
    parts: usize,
) -> Vec<[f64; 2]> {
    let times = (0..=parts).map(|index| start + duration * index as f64 / parts as f64);
    let places = times.filter_map(|time| reference.at(time).position);
    places.map(|place| [place.x, place.y]).collect()
}

/// Points of a lap.
const LAP_POINTS: usize = 1_000;
/// How far ahead of the last place on the lap the next one is searched, in points.
const SEARCH: usize = 40;

/// A lap of the reference, or its whole way.
pub(super) struct Lap {
    points: Vec<[f64; 2]>,
    /// Way to each point, in m.
    way: Vec<f64>,
    duration: f64,
    closed: bool,
}

impl Lap {
    pub(super) fn new(reference: &Reference) -> Option<Self> {
        let (start, duration, closed) = match reference {
            Reference::Circle(circle) => (0.0, TAU / circle.angular_velocity().abs(), true),
            Reference::FigureOfEight(_) => return None,
            Reference::Path(path) if path.is_closed() => {
                // The first lap begins at rest.
                (path.lap_time(), path.lap_time(), true)
            }
            other => (0.0, other.duration()?, false),
        };
        let points = places(reference, start, duration, LAP_POINTS);
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

    /// The time on the reference at a place.
    pub(super) fn time(&self, place: usize) -> f64 {
        self.duration * place as f64 / LAP_POINTS as f64
    }

    /// The place nearest to `point` near `from`, and the distance to it.
    pub(super) fn nearest(&self, [x, y]: [f64; 2], from: usize) -> (usize, f64) {
        let near = || {
            (0..=2 * SEARCH).filter_map(|offset| {
                let at = from + offset + LAP_POINTS - SEARCH / 2;
                let index = if self.closed {
                    at % LAP_POINTS
                } else {
                    (at - LAP_POINTS.min(at)).min(LAP_POINTS)
                };
                let [px, py] = self.points.get(index)?;
                Some((index, [px - x, py - y]))
            })
        };
        let square = |[x, y]: [f64; 2]| x * x + y * y;
        let least = near()
            .map(|(_, way)| square(way))
            .fold(f64::INFINITY, f64::min);
        let mut best = (from, f64::INFINITY);
        for (index, way) in near() {
            // The square is rounded otherwise than the distance, and cheaper.
            if square(way) <= least * (1.0 + 1e-12) {
                let distance = libm::hypot(way[0], way[1]);
                if distance < best.1 {
                    best = (index, distance);
                }
            }
        }
        best
    }

    /// The way from one place to another, in m; at most half of a closed lap.
    pub(super) fn between(&self, from: usize, to: usize) -> f64 {
        let at = |index: usize| self.way.get(index).copied().unwrap_or_default();
        let way = at(to) - at(from);
        let length = self.way.last().copied().unwrap_or_default();
        match self.closed {
            true if way > length / 2.0 => way - length,
            true if way < -length / 2.0 => way + length,
            _ => way,
        }
    }
}
