//! The sampled loop with irregular poses: a switched linear system, and a Markov jump system.
//!
//! From one pose to the next the loop has the map `A_k` of an interval of k ticks. If poses come
//! in any order of intervals up to the longest one, the motion is a product of such maps. It is
//! exponentially stable under **every** such order if a [`LyapunovFunction`] falls over every
//! interval (sufficient, not necessary). A [witness](SampledLoop::unstable_pattern) is an order that
//! repeats itself and whose product grows.
//!
//! If poses are lost at random, in bursts, the tick is a Markov chain: the motion is stable in the mean
//! square if and only if a function falls on average over the steps from each node (Costa, Fragoso,
//! Marques: Discrete-Time Markov Jump Linear Systems, 2005).

use nalgebra::{DMatrix, DVector};

use super::{SampledLoop, spectral_radius};

/// A step of a switched system, from a node to another: some ticks, of which the first has a pose; or
/// a tick with or without one, if steps are random.
#[derive(Clone, Debug)]
struct Step {
    from: usize,
    to: usize,
    /// One, unless steps are random.
    probability: f64,
    ticks: u32,
    map: DMatrix<f64>,
}

/// Linear maps among nodes. A node is what decides which steps are possible.
#[derive(Clone, Debug)]
pub struct Switched {
    /// The names of the coordinates of the state.
    pub coordinates: Vec<String>,
    nodes: usize,
    steps: Vec<Step>,
}

/// A positive definite matrix `P` for each node of a [`Switched`] system: xᵀ P x falls with every step,
/// or, if steps are random, on average.
#[derive(Clone, Debug)]
pub struct LyapunovFunction(pub Vec<DMatrix<f64>>);

/// Losses of poses that come in bursts: the chain of Gilbert.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RandomLosses {
    /// The share of ticks without a pose, in the long run.
    pub share: f64,
    /// The mean length of a burst without poses, in ticks; at least one.
    pub mean_ticks: f64,
}

/// How often a pattern has each of its intervals, at most.
const MOST_SHORT: u32 = 8;
const MOST_LONG: u32 = 3;

/// Intervals between poses, in ticks, that make the motion grow if they are repeated.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct UnstablePattern {
    /// The short interval.
    pub short: u32,
    /// How often it comes.
    pub shorts: u32,
    /// The long interval.
    pub long: u32,
    /// How often it comes then.
    pub longs: u32,
    /// The factor by which the motion grows over the pattern, in the long run.
    pub growth: f64,
}

impl UnstablePattern {
    /// Its intervals.
    pub fn intervals(&self) -> Vec<u32> {
        let times = |interval, count: u32| (0..count).map(move |_| interval);
        times(self.short, self.shorts)
            .chain(times(self.long, self.longs))
            .collect()
    }
}

/// What irregular intervals between poses a motion survives.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct IrregularLimits {
    /// The longest interval up to which every pattern is proved to be stable, in ticks.
    pub proved: u32,
    /// A pattern with the shortest long interval with which one is known that is unstable.
    pub unstable: Option<UnstablePattern>,
}

/// The first number above `no`, up to `yes`, with a property that holds from some number on.
fn first(mut no: u32, mut yes: u32, holds: impl Fn(u32) -> bool) -> u32 {
    while yes - no > 1 {
        let middle = no + (yes - no) / 2;
        if holds(middle) {
            yes = middle;
        } else {
            no = middle;
        }
    }
    yes
}

impl SampledLoop {
    /// The loop over intervals between poses of one to `longest` ticks, in every order.
    pub fn irregular(&self, longest: u32) -> Switched {
        let frame = self.timing.servo_frame;
        let maps = self.tick_maps();
        let mut steps = Vec::new();
        for phase in 0..frame {
            let mut map = DMatrix::identity(maps[0][0].nrows(), maps[0][0].nrows());
            for ticks in 1..=longest {
                let takes = (phase + ticks - 1).is_multiple_of(frame);
                let is_known = ticks <= 1 + self.timing.predicted_pose;
                let [taken, kept] = &maps[usize::from(!is_known)];
                map = if takes { taken } else { kept } * map;
                steps.push(Step {
                    from: phase as usize,
                    to: ((phase + ticks) % frame) as usize,
                    probability: 1.0,
                    ticks,
                    map: map.clone(),
                });
            }
        }
        Switched {
            coordinates: self.names(),
            nodes: frame as usize,
            steps,
        }
        .reduced()
    }

    /// The loop, tick by tick, with random losses of poses.
    pub fn with_random_losses(&self, losses: RandomLosses) -> Switched {
        let RandomLosses { share, mean_ticks } = losses;
        let found = 1.0 / mean_ticks.max(1.0);
        let lost = (found * share / (1.0 - share)).min(1.0);
        // How long the pose is lost: 0 if it is measured, up to the ticks of prediction, then held.
        let (frame, last) = (self.timing.servo_frame, self.timing.predicted_pose + 1);
        let maps = self.tick_maps();
        let node = |missing: u32, phase: u32| (missing * frame + phase) as usize;
        let mut steps = Vec::new();
        for missing in 0..=last {
            let chances = match missing {
                0 => [(0, 1.0 - lost), (1, lost)],
                _ => [(0, found), ((missing + 1).min(last), 1.0 - found)],
            };
            for phase in 0..frame {
                let is_known = missing < last;
                let [taken, kept] = &maps[usize::from(!is_known)];
                for (next, probability) in chances {
                    steps.push(Step {
                        from: node(missing, phase),
                        to: node(next, (phase + 1) % frame),
                        probability,
                        ticks: 1,
                        map: if phase == 0 { taken } else { kept }.clone(),
                    });
                }
            }
        }
        Switched {
            coordinates: self.names(),
            nodes: node(last + 1, 0),
            steps,
        }
        .reduced()
    }

    /// Up to which interval, in ticks, every pattern of intervals is proved to be stable, and from which
    /// one on some pattern is known that is not; both at most `limit`.
    pub fn irregular_limits(&self, limit: u32) -> IrregularLimits {
        let is_unstable = |longest: u32| self.unstable_pattern(longest).is_some();
        let witness = Some(limit)
            .filter(|limit| is_unstable(*limit))
            .map(|limit| first(0, limit, is_unstable));
        let unproved = |longest: u32| self.irregular(longest).common_function().is_none();
        let above = witness.unwrap_or(limit + 1);
        // The two are near each other, as a rule.
        let near = above - above / 5;
        let first_unproved = if above <= 1 {
            above
        } else if near < above && !unproved(near) {
            first(near, above, unproved)
        } else {
            first(0, near, unproved)
        };
        IrregularLimits {
            proved: first_unproved - 1,
            unstable: witness.and_then(|longest| self.unstable_pattern(longest)),
        }
    }

    /// A pattern of intervals, some of them of `longest` ticks and none longer, that makes the motion
    /// grow if it is repeated: some short intervals and some long ones.
    pub fn unstable_pattern(&self, longest: u32) -> Option<UnstablePattern> {
        let switched = self.irregular(longest);
        let constant = [(longest, 0)].into_iter();
        let shorts =
            (1..longest).flat_map(|short| (1..=MOST_SHORT).map(move |times| (short, times)));
        let patterns = constant.chain(shorts).flat_map(|(short, shorts)| {
            (1..=MOST_LONG).map(move |longs| UnstablePattern {
                short,
                shorts,
                long: longest,
                longs,
                growth: 0.0,
            })
        });
        let grown = patterns.map(|pattern| UnstablePattern {
            growth: switched.growth(&pattern.intervals()),
            ..pattern
        });
        grown
            .filter(|pattern| pattern.growth >= 1.0)
            .max_by(|one, other| one.growth.total_cmp(&other.growth))
    }

    fn tick_maps(&self) -> [[DMatrix<f64>; 2]; 2] {
        [true, false].map(|known| [true, false].map(|takes| self.tick(known, takes)))
    }
}

impl Switched {
    /// Without the coordinates that no step looks at.
    fn reduced(mut self) -> Self {
        loop {
            let unused = (0..self.coordinates.len()).find(|at| {
                let is_zero = |step: &Step| step.map.column(*at).iter().all(|value| *value == 0.0);
                self.steps.iter().all(is_zero)
            });
            let Some(unused) = unused else { return self };
            self.coordinates.remove(unused);
            for step in &mut self.steps {
                let map = core::mem::take(&mut step.map);
                step.map = map.remove_row(unused).remove_column(unused);
            }
        }
    }

    /// The factor by which the motion grows over a repetition of intervals (in ticks) in the long run.
    fn growth(&self, intervals: &[u32]) -> f64 {
        let size = self.coordinates.len();
        let (mut map, mut node) = (DMatrix::identity(size, size), 0);
        let mut times = 0;
        while times == 0 || node != 0 {
            for interval in intervals {
                let mut steps = self.steps.iter();
                let step = steps.find(|step| step.from == node && step.ticks == *interval);
                let Some(step) = step else { return f64::NAN };
                map = &step.map * map;
                node = step.to;
            }
            times += 1;
        }
        libm::pow(spectral_radius(map), 1.0 / f64::from(times))
    }

    /// A function that falls on average with every step, if steps are random and the motion is stable in
    /// the mean square: `P = 1 + Σ probability Aᵀ P_to A` over the steps from its node.
    pub fn mean_square_function(&self) -> Option<LyapunovFunction> {
        let size = self.coordinates.len();
        let count = size * (size + 1) / 2;
        let unknowns = count * self.nodes;
        let mut equations = DMatrix::<f64>::identity(unknowns, unknowns);
        for step in &self.steps {
            for (unknown, (row, column)) in pairs(size).enumerate() {
                // What the coefficient of P_to at (row, column) contributes to P_from.
                let product = step.map.row(row).transpose() * step.map.row(column);
                let part = match row == column {
                    true => product,
                    false => &product + product.transpose(),
                };
                for (equation, place) in pairs(size).enumerate() {
                    equations[(step.from * count + equation, step.to * count + unknown)] -=
                        step.probability * part[place];
                }
            }
        }
        let ones = (0..unknowns).map(|index| {
            let pair = pairs(size).nth(index % count);
            f64::from(u8::from(pair.is_some_and(|(row, column)| row == column)))
        });
        let solution = equations
            .lu()
            .solve(&DVector::from_iterator(unknowns, ones))?;
        let functions = (0..self.nodes).map(|node| {
            let mut function = DMatrix::zeros(size, size);
            for (index, (row, column)) in pairs(size).enumerate() {
                function[(row, column)] = solution[node * count + index];
                function[(column, row)] = solution[node * count + index];
            }
            // A motion that is not stable has a function that is not positive definite.
            function.clone().cholesky().map(|_| function)
        });
        functions.collect::<Option<_>>().map(LyapunovFunction)
    }

    /// A function that falls with every step, if one is found.
    ///
    /// The largest t with `Aᵀ P_to A + t < P_from` for all steps and `0 < P < 1` is approached by the
    /// barrier method (Boyd, Vandenberghe: Convex Optimization, 2004, section 11.6), until it is above
    /// zero, or until it can't be.
    pub fn common_function(&self) -> Option<LyapunovFunction> {
        let root = self.round_coordinates()?;
        let inverse = root.clone().try_inverse()?;
        let mut steps = self.steps.clone();
        for step in &mut steps {
            step.map = &root * &step.map * &inverse;
        }
        let mut centre = Centre::new(&steps, self.nodes, self.coordinates.len());
        while centre.weight < HEAVIEST {
            centre.approach()?;
            if worst(&steps, &centre.functions)? < 1.0 - MARGIN {
                let back = centre.functions.iter().map(|p| {
                    let p = root.transpose() * p * &root;
                    (&p + p.transpose()) * 0.5
                });
                return Some(LyapunovFunction(back.collect()));
            }
            if centre.end() < 0.0 {
                return None;
            }
            centre.weight *= HEAVIER;
        }
        None
    }

    /// A root `R` of the sum of all later squares of the loop with a pose at every tick: `Rᵀ R`.
    fn round_coordinates(&self) -> Option<DMatrix<f64>> {
        let size = self.coordinates.len();
        let short = self.steps.iter().filter(|step| step.ticks == 1);
        let maps: Vec<&DMatrix<f64>> = short.map(|step| &step.map).collect();
        let frame = maps
            .iter()
            .fold(DMatrix::identity(size, size), |all, map| *map * all);
        let radius = spectral_radius(frame.clone());
        let scaled = &frame / (0.5 * (1.0 + radius)).max(radius * 1.01);
        let mut sum = DMatrix::identity(size, size);
        let mut power = scaled;
        // The sum of 2^k squares by doubling.
        for _ in 0..30 {
            sum = &sum + power.transpose() * &sum * &power;
            power = &power * &power;
        }
        sum.cholesky().map(|cholesky| cholesky.l().transpose())
    }
}

/// How far below one the ratio of a Lyapunov function must be, for its matrices to be rounded.
const MARGIN: f64 = 1e-6;
/// The factor from one weight of the room to the next, and the weight at which the search ends.
const HEAVIER: f64 = 10.0;
const HEAVIEST: f64 = 1e10;
/// The most Newton steps to a centre.
const MOST_NEWTON: usize = 100;

/// The largest ratio of the function after a step to that before it.
fn worst(steps: &[Step], functions: &[DMatrix<f64>]) -> Option<f64> {
    let mut worst: f64 = 0.0;
    for step in steps {
        let factor = functions[step.from].clone().cholesky()?.l();
        // The columns of L⁻¹ Aᵀ.
        let after = factor.solve_lower_triangular(&step.map.transpose())?;
        let ratio = &after * &functions[step.to] * after.transpose();
        worst = worst.max(ratio.symmetric_eigenvalues().max());
    }
    Some(worst)
}

/// The coefficients of symmetric matrices: the pairs of row and column.
fn pairs(size: usize) -> impl Iterator<Item = (usize, usize)> + Clone {
    (0..size).flat_map(move |row| (row..size).map(move |column| (row, column)))
}

/// The search for a function: a point near the centre of the matrices that are allowed.
struct Centre<'a> {
    steps: &'a [Step],
    functions: Vec<DMatrix<f64>>,
    /// The room t that every step leaves: below zero if the function rises over one.
    room: f64,
    /// How much the room counts against the barrier.
    weight: f64,
}

/// Gradient and Hessian of the barrier `-log det` of all conditions.
struct Barrier {
    gradient: DVector<f64>,
    hessian: DMatrix<f64>,
}

impl Barrier {
    /// Adds a condition. `columns` has its derivatives by the unknowns of `indices`, in coordinates in which
    /// it is the unit matrix.
    fn add(&mut self, indices: &[usize], columns: &[DMatrix<f64>]) {
        for (at, (row, one)) in indices.iter().zip(columns).enumerate() {
            self.gradient[*row] -= one.trace();
            for (column, other) in indices.iter().zip(columns).skip(at) {
                let product = one.dot(other);
                self.hessian[(*row, *column)] += product;
                if row != column {
                    self.hessian[(*column, *row)] += product;
                }
            }
        }
    }
}

impl<'a> Centre<'a> {
    fn new(steps: &'a [Step], nodes: usize, size: usize) -> Self {
        let functions = vec![DMatrix::<f64>::identity(size, size) * 0.5; nodes];
        let rise = |step: &Step| libm::pow(step.map.norm(), 2.0);
        Self {
            steps,
            functions,
            room: -1.0 - steps.iter().map(rise).fold(0.0, f64::max),
            weight: 1.0,
        }
    }

    /// What the room can be at most.
    fn end(&self) -> f64 {
        let size = self.functions.first().map_or(0, DMatrix::nrows);
        let conditions = self.steps.len() + 2 * self.functions.len();
        self.room + 2.0 * (conditions * size) as f64 / self.weight
    }

    /// Newton's method to the minimum of the barrier less the weighted room.
    fn approach(&mut self) -> Option<()> {
        let size = self.functions.first()?.nrows();
        let unit = DMatrix::<f64>::identity(size, size);
        let count = size * (size + 1) / 2;
        let unknowns = count * self.functions.len() + 1;
        let inverse_factor = |matrix: DMatrix<f64>| {
            let factor = matrix.cholesky()?.l();
            factor.solve_lower_triangular(&unit)
        };
        // The derivatives of `sign Z P Zᵀ` by the coefficients of P.
        let derivatives = |z: &DMatrix<f64>, sign: f64| {
            let by = |(row, column): (usize, usize)| {
                let product = z.column(row) * z.column(column).transpose() * sign;
                if row == column {
                    product
                } else {
                    &product + product.transpose()
                }
            };
            pairs(size).map(by).collect::<Vec<_>>()
        };
        for _ in 0..MOST_NEWTON {
            let mut barrier = Barrier {
                gradient: DVector::zeros(unknowns),
                hessian: DMatrix::zeros(unknowns, unknowns),
            };
            let indices = |node: usize| node * count..(node + 1) * count;
            for (node, p) in self.functions.iter().enumerate() {
                let indices: Vec<usize> = indices(node).collect();
                let z = inverse_factor(p.clone())?;
                barrier.add(&indices, &derivatives(&z, 1.0));
                let z = inverse_factor(&unit - p)?;
                barrier.add(&indices, &derivatives(&z, -1.0));
            }
            for step in self.steps {
                let after = step.map.transpose() * &self.functions[step.to] * &step.map;
                let condition = &self.functions[step.from] - after - &unit * self.room;
                let z = inverse_factor(condition)?;
                let after = &z * step.map.transpose();
                let mut own: Vec<usize> = indices(step.from).collect();
                let mut columns = derivatives(&z, 1.0);
                if step.from == step.to {
                    for (column, after) in columns.iter_mut().zip(derivatives(&after, -1.0)) {
                        *column += after;
                    }
                } else {
                    own.extend(indices(step.to));
                    columns.extend(derivatives(&after, -1.0));
                }
                own.push(unknowns - 1);
                columns.push(-&z * z.transpose());
                barrier.add(&own, &columns);
            }
            barrier.gradient[unknowns - 1] -= self.weight;
            let direction = barrier.hessian.cholesky()?.solve(&barrier.gradient);
            let decrement = libm::sqrt(barrier.gradient.dot(&direction).max(0.0));
            let length = 1.0 / (1.0 + decrement);
            for (node, p) in self.functions.iter_mut().enumerate() {
                for (index, (row, column)) in pairs(size).enumerate() {
                    let change = length * direction[node * count + index];
                    p[(row, column)] -= change;
                    if row != column {
                        p[(column, row)] -= change;
                    }
                }
            }
            self.room -= length * direction[unknowns - 1];
            if decrement < 0.5 {
                break;
            }
        }
        Some(())
    }
}
