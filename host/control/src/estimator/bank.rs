//! The three filters: what each believes of the steering, and how likely each is. The front wheels
//! follow the steering that was sent after a dead time, with a lag of first order.

use heapless::Deque;
use libm::{exp, fabs, tan};

use super::{
    CarPose, EstimatorConfig,
    filter::{Filter, Navigation, Prior, Reading, Wheels},
};
use crate::{
    compensation::lagged,
    measurement::{InertialSample, Time},
};

/// A sample that is older than the filter's state by more than this no longer counts, s.
const OLDEST_SAMPLE: f64 = 0.05;

/// The longest step of a filter, s.
const LONGEST_STEP: f64 = 0.0101;

/// The period of the inertial samples for which the times are meant, s.
pub(super) const SAMPLE_PERIOD: f64 = 0.01;

/// The filters: what each believes of the steering.
const PRIORS: [Prior; 3] = [
    Prior {
        steering: true,
        turn: [0.01, 0.015, 0.08],
        slip: [0.005, 0.01],
        forward: 0.5,
    },
    Prior {
        steering: true,
        turn: [0.04, 0.04, 0.15],
        slip: [0.02, 0.04],
        forward: 1.5,
    },
    Prior {
        steering: false,
        turn: [0.0; 3],
        slip: [0.1, 0.15],
        forward: 3.0,
    },
];
/// The one that believes the steering little, and the one without it.
const LOOSE: usize = 1;
const FREE: usize = 2;
/// What was likely is forgotten with this time constant, s.
const FORGETTING: f64 = 0.3;
/// The poses in a row after which a filter that refuses them alone has lost the car.
const LOST: u32 = 10;
/// The least weight of a filter.
const LEAST_WEIGHT: f64 = 1e-6;

/// The noise of gyro and accelerometer is learned with this time constant, s...
const LEARNING: f64 = 1.0;
/// ...apart for a car at rest and for one that moves faster than this, m/s...
const MOVES_FROM: f64 = 0.1;
/// ...the gyro's down to this deviation of a sample, rad/s, and the accelerometer's down to this part
/// of the configured one.
const QUIETEST_GYRO: f64 = 1e-3;
const QUIETEST_ACCELEROMETER: f64 = 0.25;
/// A sample counts at most by this share in what is learned, and as this multiple of what is known.
const MOST_AT_ONCE: f64 = 0.2;
const OUTLYING: f64 = 9.0;

/// The time constant of the accelerometer's mean error, s.
const BIAS_TIME: f64 = 20.0;

/// The commands kept: more than the largest lag of the filter at the shortest period.
const COMMANDS: usize = 128;

/// From when on the wheels go to an angle, and from where.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Command {
    from: Time,
    angle: f64,
    target: f64,
}

/// The steering that was sent.
#[derive(Clone, Debug)]
pub(super) struct Sent {
    dead_time: f64,
    lag: f64,
    commands: Deque<Command, COMMANDS>,
}

impl Sent {
    /// Straight wheels. Both times are in s.
    pub(super) const fn new(dead_time: f64, lag: f64) -> Self {
        Self {
            dead_time,
            lag,
            commands: Deque::new(),
        }
    }

    /// The steering angle `steering` (rad) is sent at `now`.
    pub(super) fn send(&mut self, now: Time, steering: f64) {
        let from = now.after(self.dead_time);
        let angle = match self.commands.back() {
            Some(last) if last.target == steering || last.from >= from => return,
            Some(last) => self.angle(last, from),
            None => steering,
        };
        if self.commands.is_full() {
            self.commands.pop_front();
        }
        // There is room.
        let _ = self.commands.push_back(Command {
            from,
            angle,
            target: steering,
        });
    }

    /// The angle of the wheels at a time, rad.
    pub(super) fn at(&self, time: Time) -> f64 {
        let command = self.commands.iter().rev().find(|it| it.from <= time);
        match (command, self.commands.front()) {
            (Some(command), _) => self.angle(command, time),
            (None, Some(first)) => first.angle,
            (None, None) => 0.0,
        }
    }

    fn angle(&self, command: &Command, time: Time) -> f64 {
        let since = time.seconds_since(command.from);
        lagged(command.angle, command.target, self.lag, since)
    }

    /// The wheels from a time to another.
    fn between(&self, from: Time, to: Time) -> Wheels {
        let [before, after] = [from, to].map(|time| tan(self.at(time)));
        let elapsed = to.seconds_since(from);
        Wheels {
            tangent: 0.5 * (before + after),
            change: if elapsed > 0.0 {
                (after - before) / elapsed
            } else {
                0.0
            },
        }
    }
}

/// An inertial sample and the motor speed of the same telemetry.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Sample {
    pub(super) inertial: InertialSample,
    pub(super) motor_speed: Option<f64>,
}

/// Variances of a sample: of the gyro, rad²/s², and of the forward accelerometer, m²/s⁴.
type Variances = [f64; 2];

/// The filters at one time.
#[derive(Clone, Debug)]
pub(super) struct Bank {
    pub(super) config: EstimatorConfig,
    filters: [Filter; 3],
    /// How likely each made the last measurements, as a logarithm.
    likelihoods: [f64; 3],
    /// The poses in a row that each refused and the best one accepted.
    refused: [u32; 3],
    /// The noise of the IMU at rest, and of a car that moves.
    noise: [Variances; 2],
    /// Mean error of the accelerometer to the left, m/s², and the number of samples.
    pub(super) left_bias: f64,
    accelerations: u32,
    /// The time of the filters' state.
    pub(super) time: Time,
}

impl Bank {
    pub(super) fn at_pose(pose: &CarPose, time: Time, config: &EstimatorConfig) -> Self {
        Self {
            config: *config,
            filters: PRIORS.map(|prior| Filter::at_pose(prior, pose, config)),
            likelihoods: [0.0; 3],
            refused: [0; 3],
            noise: [0.0, 1.0].map(|speed| configured_noise(speed, config)),
            left_bias: 0.0,
            accelerations: 0,
            time,
        }
    }

    /// The most likely filter.
    pub(super) fn best(&self) -> &Filter {
        &self.filters[self.most_likely()]
    }

    /// Whether the filters, and what they were found likely by, are finite.
    pub(super) fn is_finite(&self) -> bool {
        self.filters.iter().all(Filter::is_finite)
            && self.likelihoods.iter().all(|likely| likely.is_finite())
    }

    /// The weights of the filters, whose sum is 1.
    pub(super) fn weights(&self) -> [f64; 3] {
        let likelihoods = self.likelihoods;
        let most = likelihoods.into_iter().fold(f64::NEG_INFINITY, f64::max);
        let weights = likelihoods.map(|likely| exp(likely - most) + LEAST_WEIGHT);
        let sum: f64 = weights.iter().sum();
        weights.map(|weight| weight / sum)
    }

    /// The number of the most likely filter.
    fn most_likely(&self) -> usize {
        let [tight, loose, free] = self.likelihoods;
        match () {
            () if tight >= loose && tight >= free => 0,
            () if loose >= free => 1,
            () => FREE,
        }
    }

    /// Goes on to a time.
    pub(super) fn go(&mut self, end: Time, sent: &Sent) {
        while end > self.time {
            let next = end.min(self.time.after(LONGEST_STEP));
            let dt = next.seconds_since(self.time);
            let wheels = sent.between(self.time, next);
            for filter in &mut self.filters {
                filter.predict(dt, &wheels, &self.config);
            }
            let kept = exp(-dt / FORGETTING);
            self.likelihoods = self.likelihoods.map(|likely| likely * kept);
            self.time = next;
        }
    }

    /// Takes in a sample at its time. `learns` is the time since the one before, s; it is `None` where
    /// the filters are only a forecast.
    pub(super) fn take(&mut self, sample: &Sample, sent: &Sent, learns: Option<f64>) {
        let config = &self.config;
        let inertial = &sample.inertial;
        let age = self.time.seconds_since(inertial.time).max(0.0);
        if age > OLDEST_SAMPLE {
            return;
        }
        let tangent = tan(sent.at(inertial.time));
        let speed = self.filters[FREE].speed();
        let regime = usize::from(fabs(speed) > MOVES_FROM);
        let variances = self.noise[regime];
        let reading = |value: f64, variance: f64| {
            (!value.is_nan()).then_some(Reading {
                value,
                variance,
                age,
                tangent,
            })
        };
        let gyro = reading(inertial.yaw_rate, variances[0]);
        let acceleration = reading(inertial.forward_acceleration, variances[1]);
        let excesses = self.filters.each_mut().map(|filter| {
            let acceleration = acceleration.map(|it| filter.correct_acceleration(&it, config));
            let gyro = gyro.map(|it| filter.correct_gyro(&it, config));
            if let Some(motor_speed) = sample.motor_speed {
                filter.correct_motor(motor_speed, age, config);
            }
            [gyro, acceleration]
        });
        let Some(elapsed) = learns else { return };
        self.compare_accelerations(inertial, tangent);
        let share = (elapsed / LEARNING).min(MOST_AT_ONCE);
        let accelerometer = configured_noise(speed, &self.config)[1];
        let least = [
            square(QUIETEST_GYRO),
            square(QUIETEST_ACCELEROMETER) * accelerometer,
        ];
        for (sensor, known) in self.noise[regime].iter_mut().enumerate() {
            let Some(excess) = excesses[LOOSE][sensor] else {
                continue;
            };
            let excess = excess.clamp(0.0, OUTLYING * *known);
            *known = (*known + share * (excess - *known)).max(least[sensor]);
        }
        self.take_likelihoods();
    }

    /// Corrects with a pose at the time of the filters. Returns its normalised innovation squared by
    /// the filter that was the most likely one before, and whether that accepted it.
    pub(super) fn correct_pose(&mut self, pose: &CarPose) -> (f64, bool) {
        let best = self.most_likely();
        let filters = self.filters.each_mut();
        let results = filters.map(|filter| filter.correct_pose(pose, &self.config));
        self.take_likelihoods();
        self.find_lost(&results, best, pose);
        results[best]
    }

    /// What the accelerometer measures to the left beyond the motion, as a mean.
    fn compare_accelerations(&mut self, inertial: &InertialSample, tangent: f64) {
        if inertial.left_acceleration.is_nan() {
            return;
        }
        let left = self.best().left_acceleration(tangent, &self.config);
        self.accelerations = self.accelerations.saturating_add(1);
        let share = (SAMPLE_PERIOD / BIAS_TIME).max(1.0 / f64::from(self.accelerations));
        self.left_bias += share * (inertial.left_acceleration - left - self.left_bias);
    }

    /// Filters that go on refusing the poses that the best one accepts have lost the car, and start
    /// again. All count their turns alike, so that the mean of their yaws is one.
    fn find_lost(&mut self, results: &[(f64, bool); 3], best: usize, pose: &CarPose) {
        let known = self.filters[best];
        for (index, filter) in self.filters.iter_mut().enumerate() {
            let is_lost = results[best].1 && !results[index].1;
            let refused = &mut self.refused[index];
            *refused = if is_lost { *refused + 1 } else { 0 };
            if *refused >= LOST {
                *filter = filter.found_by(&known, pose, &self.config);
                *refused = 0;
            }
            filter.count_turns_as(known.yaw());
        }
    }

    fn take_likelihoods(&mut self) {
        for (sum, filter) in self.likelihoods.iter_mut().zip(&mut self.filters) {
            *sum += core::mem::take(&mut filter.likelihood);
        }
    }

    /// The weighted mean of the filters' motions.
    pub(super) fn navigation(&self, weights: [f64; 3], sent: &Sent) -> Navigation {
        let tangent = tan(sent.at(self.time));
        let all = (self.filters).map(|filter| filter.navigation(tangent, &self.config));
        Navigation::mean(&all, weights)
    }
}

/// The variances of a sample by the configuration, at a speed (m/s).
fn configured_noise(speed: f64, config: &EstimatorConfig) -> Variances {
    let acceleration = config.acceleration_variance(speed * speed);
    [square(config.gyro_noise_density), acceleration].map(|density| density / SAMPLE_PERIOD)
}

fn square(value: f64) -> f64 {
    value * value
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test may fail")]
mod tests {
    use super::*;
    use crate::{
        estimator::{Estimator, PoseVerdict},
        measurement::{PoseSample, Position},
        single_track::VehicleParameters,
    };

    /// An estimator of a car that stands, and its time.
    fn standing(frames: i32, mut each: impl FnMut(i32, &mut Estimator)) -> (Estimator, Time) {
        let config = EstimatorConfig::for_vehicle(&VehicleParameters::paper());
        let mut estimator = Estimator::new(config);
        let mut now = Time(1_000_000_000);
        for frame in 0..frames {
            now = now.after(0.01);
            let inertial = InertialSample {
                time: now,
                yaw_rate: 0.0,
                forward_acceleration: 0.0,
                left_acceleration: 0.0,
            };
            estimator.handle_inertial(inertial, Some(0.0));
            each(frame, &mut estimator);
            let pose = PoseSample {
                capture: now.before(0.005),
                receive: now,
                frame,
                position: Position::new(1.0, 2.0),
                yaw: 0.3,
            };
            assert_eq!(estimator.handle_pose(&pose), PoseVerdict::Accepted);
        }
        (estimator, now)
    }

    #[test]
    fn filters_that_count_their_turns_otherwise_have_one_yaw() {
        let (mut estimator, now) = standing(50, |frame, estimator| {
            if frame == 30 {
                let bank = &mut estimator.track.as_mut().unwrap().bank;
                bank.filters[1].count_turns_as(0.3 + core::f64::consts::TAU);
                bank.likelihoods = [0.0; 3];
            }
        });
        let estimate = estimator.estimate(now).unwrap();
        assert!(fabs(estimate.yaw - 0.3) < 0.01, "{}", estimate.yaw);
    }

    #[test]
    fn a_filter_that_alone_has_lost_the_car_finds_it_again() {
        let config = EstimatorConfig::for_vehicle(&VehicleParameters::paper());
        let elsewhere = CarPose {
            position: Position::new(4.0, -3.0),
            yaw: 2.0,
        };
        let (estimator, _) = standing(80, |frame, estimator| {
            if frame == 30 {
                let bank = &mut estimator.track.as_mut().unwrap().bank;
                bank.filters[FREE] = Filter::at_pose(PRIORS[FREE], &elsewhere, &config);
            }
        });
        let bank = estimator.track.unwrap().bank;
        assert!(fabs(bank.filters[FREE].yaw() - 0.3) < 0.05);
    }

    #[test]
    fn an_estimate_that_is_no_number_starts_again_at_the_next_pose() {
        let (mut estimator, now) = standing(50, |_, _| {});
        assert!(estimator.estimate(now).is_some());
        estimator.track.as_mut().unwrap().bank.likelihoods[LOOSE] = f64::NAN;
        assert!(estimator.estimate(now).is_none());
        let pose = PoseSample {
            capture: now.after(0.005),
            receive: now.after(0.01),
            frame: 51,
            position: Position::new(1.0, 2.0),
            yaw: 0.3,
        };
        assert_eq!(estimator.handle_pose(&pose), PoseVerdict::Accepted);
        let estimate = estimator.estimate(now.after(0.01)).unwrap();
        assert!(estimate.position.x.is_finite() && estimate.yaw_rate.is_finite());
    }
}
