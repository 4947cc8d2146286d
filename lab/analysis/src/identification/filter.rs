//! An extended Kalman filter along a drive: the innovations, their predicted variance, the gains for
//! the predictor, and the most likely noise levels.

use nalgebra::{SMatrix, SVector};
use num_dual::DualSVec64;
use singletrack_control::wrap;

use super::{
    data::{Channel, Drive, DriveData},
    model::Model,
    parameter::Values,
    settings::{LEAST_FORCE, NoiseLevels, Settings},
    timeline::{EventHandler, STATES, StateEstimate},
};

/// The Kalman gain of an innovation and its standard deviation, which is zero for a sample
/// that was not used.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Gain {
    pub(super) gain: [f64; STATES],
    pub(super) deviation: f64,
}

/// The gains along a drive.
#[derive(Clone, Debug)]
pub(super) struct Gains {
    /// The values whose delays order the measurements.
    pub(super) order: Values,
    /// For yaw rate and left acceleration, by inertial sample.
    pub(super) inertial: Vec<[Gain; 2]>,
    /// For x, y and yaw, by pose.
    pub(super) poses: Vec<[Gain; 3]>,
}

/// A measurement minus its prediction.
#[derive(Clone, Copy, Debug)]
pub(super) struct Innovation {
    pub(super) channel: Channel,
    pub(super) time_s: f64,
    pub(super) value: f64,
    /// The predicted variance.
    pub(super) variance: f64,
}

/// The prediction errors of a channel.
#[derive(Clone, Debug, PartialEq)]
pub struct Residuals {
    /// The channel.
    pub channel: Channel,
    /// Time of each error, in s.
    pub times_s: Vec<f64>,
    /// Each error over its predicted standard deviation.
    pub values: Vec<f64>,
    /// Autocorrelation at lags of one sample and more.
    pub autocorrelation: Vec<f64>,
}

/// The estimate of the filter after an inertial sample.
#[derive(Clone, Copy, Debug)]
pub struct TrackPoint {
    /// Index of the inertial sample.
    pub(super) inertial: usize,
    pub(super) estimate: StateEstimate<f64>,
}

impl TrackPoint {
    /// Speed of G, in m/s.
    pub const fn speed_m_s(&self) -> f64 {
        self.estimate.motion.speed
    }
}

/// The result of a run of the filter along a drive.
#[derive(Clone, Debug)]
pub(super) struct FilterRun {
    pub(super) innovations: Vec<Innovation>,
    pub(super) gains: Gains,
    pub(super) track: Vec<TrackPoint>,
}

/// Number of lags of the autocorrelation.
const LAGS: usize = 20;

impl FilterRun {
    /// Logarithm of the likelihood up to a constant.
    pub(super) fn likelihood(&self) -> f64 {
        let terms = self.innovations.iter();
        let terms = terms.map(|one| one.variance.ln() + one.value * one.value / one.variance);
        -0.5 * terms.sum::<f64>()
    }

    /// The prediction errors, by channel.
    pub(super) fn residuals(&self) -> Vec<Residuals> {
        let residuals = Channel::ALL.map(|channel| {
            let of_channel = self.innovations.iter();
            let of_channel = of_channel.filter(|innovation| innovation.channel == channel);
            let (times_s, values): (Vec<f64>, Vec<f64>) = of_channel
                .map(|one| (one.time_s, one.value / one.variance.sqrt()))
                .unzip();
            Residuals {
                channel,
                autocorrelation: autocorrelation(&values),
                times_s,
                values,
            }
        });
        residuals.into()
    }
}

fn autocorrelation(values: &[f64]) -> Vec<f64> {
    let count = values.len().max(1) as f64;
    let mean = values.iter().sum::<f64>() / count;
    let product = |lag: usize| -> f64 {
        let later = values.iter().skip(lag);
        values
            .iter()
            .zip(later)
            .map(|(one, other)| (one - mean) * (other - mean))
            .sum()
    };
    let all = product(0);
    (1..=LAGS.min(values.len().saturating_sub(1)))
        .map(|lag| if all > 0.0 { product(lag) / all } else { 0.0 })
        .collect()
}

/// Runs the filter along the stretches of a drive. None where the model is not defined.
pub(super) fn run_filter(
    drive: Drive<'_>,
    values: &Values,
    settings: &Settings,
    noise: &NoiseLevels,
) -> Option<FilterRun> {
    let data = drive.data;
    let model = Model::new(values, *values.all(), settings);
    let mut filter = Filter {
        data,
        values,
        noise,
        model: Model::new(values, values.all().map(Dual::from), settings),
        state: SVector::zeros(),
        steering: 0.0,
        covariance: SMatrix::zeros(),
        time: 0.0,
        run: FilterRun {
            innovations: Vec::new(),
            gains: Gains {
                order: *values,
                inertial: vec![[Gain::default(); 2]; data.inertial.len()],
                poses: vec![[Gain::default(); 3]; data.poses.len()],
            },
            track: Vec::new(),
        },
    };
    drive.replay(&model, values, &mut filter)?;
    Some(filter.run)
}

/// The states that the rates of the states depend on: yaw, yaw rate, sideslip, speed and the bias of the
/// forward acceleration. By the others, a state has the derivative 1 or 0.
const SEEDS: [usize; 5] = [2, 3, 4, 5, 7];
/// The state that the gyro measures beside the yaw rate.
const GYRO_BIAS: usize = 6;

type Dual = DualSVec64<{ SEEDS.len() }>;

struct Filter<'a> {
    data: &'a DriveData,
    values: &'a Values,
    noise: &'a NoiseLevels,
    model: Model<Dual>,
    state: SVector<f64, STATES>,
    steering: f64,
    covariance: SMatrix<f64, STATES, STATES>,
    time: f64,
    run: FilterRun,
}

/// Standard deviations of the states at the start of a stretch.
const START: [f64; STATES] = [1e-3, 1e-3, 0.01, 0.3, 0.1, 0.1, 0.03, 0.3];

impl Filter<'_> {
    /// The state, with its derivatives by itself.
    fn seeded(&self) -> StateEstimate<Dual> {
        let seed = |index: usize| {
            let state = Dual::from(self.state[index]);
            let seed = SEEDS.iter().position(|seed| *seed == index);
            seed.map_or(state, |seed| state.derivative(seed))
        };
        StateEstimate::of(core::array::from_fn(seed), Dual::from(self.steering))
    }

    /// Corrects the state with a measurement. `row` are the derivatives of its prediction by the states,
    /// and `difference` is the innovation.
    fn correct(&mut self, channel: Channel, row: Row, difference: f64) -> Gain {
        // Not measured.
        if difference.is_nan() {
            return Gain::default();
        }
        let column = self.covariance * row.transpose();
        let deviation = self.noise.of(channel);
        let variance = (row * column).x + deviation * deviation;
        let gain = column / variance;
        self.state += gain * difference;
        self.covariance -= gain * column.transpose();
        self.run.innovations.push(Innovation {
            channel,
            time_s: self.time,
            value: difference,
            variance,
        });
        Gain {
            gain: gain.into(),
            deviation: variance.sqrt(),
        }
    }
}

/// The derivatives of a value by the states.
type Row = SMatrix<f64, 1, STATES>;

/// The derivatives of a value; `plain` is the state that it is a sum with, if that is none of [`SEEDS`].
fn gradient(value: &Dual, plain: Option<usize>) -> Row {
    let mut row = Row::zeros();
    for (seed, derivative) in SEEDS.into_iter().zip(value.eps.0.iter().flatten()) {
        row[seed] = *derivative;
    }
    if let Some(plain) = plain {
        row[plain] = 1.0;
    }
    row
}

impl EventHandler<f64> for Filter<'_> {
    fn begin(&mut self, time: f64, estimate: StateEstimate<f64>) {
        self.time = time;
        self.state = SVector::from(estimate.states());
        self.steering = estimate.motion.steering;
        self.covariance = SMatrix::from_diagonal(&SVector::from(START).map(|x| x * x));
    }

    fn advance(&mut self, step: f64, target: f64, forward: [f64; 2]) -> Option<()> {
        let estimate = self.seeded();
        let forward = forward.map(|forward| -estimate.forward_bias + forward);
        let before = estimate.motion;
        let motion = (self.model).advance(before, Dual::from(step), target, forward)?;
        let rows = StateEstimate { motion, ..estimate }.states();
        let derivatives = core::array::from_fn::<_, STATES, _>(|state| {
            let plain = Some(state).filter(|state| !SEEDS.contains(state));
            gradient(&rows[state], plain)
        });
        let transition = SMatrix::<f64, STATES, STATES>::from_rows(&derivatives);
        self.state = SVector::from(rows.map(|row| row.re));
        self.steering = motion.steering.re;
        self.covariance = transition * self.covariance * transition.transpose();
        let noise = self.noise;
        let vehicle = self.values.vehicle();
        let speed = motion.speed.re;
        let mut add = |row: usize, column: usize, density: f64| {
            self.covariance[(row, column)] += density * step;
        };
        // Independent forces on the two axles.
        let force = noise.force_density * noise.force_density;
        let arms = [
            vehicle.front_axle_distance_m / vehicle.yaw_inertia_kg_m2,
            -vehicle.rear_axle_distance_m / vehicle.yaw_inertia_kg_m2,
        ];
        let side = 1.0 / (vehicle.mass_kg * speed);
        add(3, 3, force * (arms[0] * arms[0] + arms[1] * arms[1]));
        add(3, 4, force * side * (arms[0] + arms[1]));
        add(4, 3, force * side * (arms[0] + arms[1]));
        add(4, 4, force * 2.0 * side * side);
        add(5, 5, noise.forward_density * noise.forward_density);
        add(6, 6, noise.gyro_walk * noise.gyro_walk);
        add(7, 7, noise.forward_walk * noise.forward_walk);
        self.time += step;
        Some(())
    }

    fn inertial(&mut self, index: usize, forward: f64) {
        let sample = self.data.inertial[index];
        let expected = self.seeded().gyro(&self.model);
        let row = gradient(&expected, Some(GYRO_BIAS));
        let difference = sample.yaw_rate_rad_s - expected.re;
        let yaw_rate = self.correct(Channel::YawRate, row, difference);
        let expected = self.seeded().left(&self.model, Dual::from(forward));
        let row = gradient(&expected, None);
        let left = self.correct(Channel::Left, row, sample.left_m_s2 - expected.re);
        self.run.gains.inertial[index] = [yaw_rate, left];
        self.run.track.push(TrackPoint {
            inertial: index,
            estimate: StateEstimate::of(self.state.into(), self.steering),
        });
    }

    fn pose(&mut self, index: usize) {
        let pose = self.data.poses[index];
        let row = |state: usize| Row::from_fn(|_, column| f64::from(u8::from(column == state)));
        let x = self.correct(Channel::X, row(0), pose.x_m - self.state[0]);
        let y = self.correct(Channel::Y, row(1), pose.y_m - self.state[1]);
        let yaw = self.correct(Channel::Yaw, row(2), wrap(pose.yaw_rad - self.state[2]));
        self.run.gains.poses[index] = [x, y, yaw];
    }
}

impl NoiseLevels {
    /// These levels, scaled so that the innovations of `run` have their predicted variance, with those of
    /// the sensors within a factor of those [from the samples](Self::with_measured_sensors): a wrong model
    /// must make a sensor neither perfect nor useless.
    fn rescaled(self, run: &FilterRun, sampled: &Self) -> Self {
        self.with_sensors(|channels, level| {
            let (mut sum, mut count) = (0.0, 0.0);
            for innovation in &run.innovations {
                if channels.contains(&innovation.channel) {
                    sum += innovation.value * innovation.value / innovation.variance;
                    count += 1.0;
                }
            }
            let factor = if count > 0.0 {
                f64::clamp(sum / count, 0.01, 100.0).sqrt()
            } else {
                1.0
            };
            let sampled = sampled.of(channels[0]);
            (level * factor).clamp(0.6 * sampled, 2.0 * sampled)
        })
    }

    /// The levels with the largest likelihood, from these as a start.
    ///
    /// The sensors' levels stay near `sampled`. `run` runs the filter with given levels.
    pub(super) fn most_likely(
        self,
        sampled: &Self,
        rounds: u32,
        mut run: impl FnMut(&Self) -> Option<FilterRun>,
    ) -> Option<Self> {
        type Density = fn(&mut NoiseLevels) -> &mut f64;
        let densities: [(Density, f64); 2] = [
            (|levels| &mut levels.forward_density, 0.0),
            (|levels| &mut levels.force_density, LEAST_FORCE),
        ];
        let mut levels = self;
        for round in 0..rounds {
            for _ in 0..2 {
                levels = levels.rescaled(&run(&levels)?, sampled);
            }
            let spread = if round == 0 { 6.0 } else { 2.0 };
            for (density, least) in densities {
                let scaled = |power: f64| {
                    let mut tried = levels;
                    let level = density(&mut tried);
                    *level = (*level * f64::powf(spread, power)).max(least);
                    tried
                };
                let mut at = |power: f64| run(&scaled(power)).map(|run| run.likelihood());
                let (less, same, more) = (at(-1.0)?, at(0.0)?, at(1.0)?);
                // The maximum of the parabola through the three, limited to twice their distance.
                let bend = less - 2.0 * same + more;
                let power = if bend < 0.0 {
                    (0.5 * (less - more) / bend).clamp(-2.0, 2.0)
                } else if more > less {
                    2.0
                } else {
                    -2.0
                };
                levels = scaled(power);
            }
        }
        Some(levels.rescaled(&run(&levels)?, sampled))
    }
}
