//! The steering servo, from angles that a person has read or from a drive with bends.

use singletrack_control::statistics::Line;
use singletrack_control::{VehicleParameters, interpolate, student_quantile};

use super::{Frames, Motion, gauss_newton};
use crate::Interval;

/// The steering servo, as one pass shows it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Wheels {
    /// Pulse for straight wheels, µs.
    pub(crate) centre_us: f64,
    /// Pulse per angle to the left, µs/rad.
    pub(crate) gain_us_per_rad: f64,
    /// Time constant, s.
    pub(crate) lag: f64,
    /// Time from the pulse in the telemetry to the first movement, s.
    pub(crate) delay: f64,
    /// Play, µs.
    pub(crate) play_us: f64,
    /// How much more the car turns than the fit in bends to the left and to the right, as a
    /// fraction.
    pub(crate) excess: [f64; 2],
}

/// The step of the simulated servo, s.
const STEP: f64 = 0.002;

/// The most play that is searched, and how fine, µs.
const MOST_PLAY_US: f64 = 24.0;
const PLAY_STEP_US: f64 = 0.5;

/// Bounds of the time constant and of the dead time, s.
const SERVO_BOUNDS: [[f64; 2]; 2] = [[0.002, 0.3], [-0.03, 0.2]];

/// Pulses between which the angles of [`wheel_angles`] are straight lines.
const PULSES: usize = 5;

/// The model moves for so long before the pass: it forgets how it began, s.
const AHEAD: f64 = 0.3;

/// Slower poses tell nothing of the steering, m/s.
const SLOWEST: f64 = 0.05;

/// A drive with bends.
pub(crate) struct Driven<'a> {
    pub(crate) motion: Motion,
    /// The pulses of the servo.
    pub(crate) pulses: &'a Frames,
    /// The speed of the rear axle at every pose, m/s.
    pub(crate) speed: Vec<f64>,
    pub(crate) vehicle: &'a VehicleParameters,
}

impl Driven<'_> {
    /// Fits the servo to the yaw rate. The search begins at this centre and gain. None if the drive
    /// does not determine it.
    pub(crate) fn wheels(&self, [centre_us, gain_us_per_rad]: [f64; 2]) -> Option<Wheels> {
        let residuals = |&[centre_us, inverse, lag, delay, play_us]: &[f64; 5]| {
            let angle = |pulse: f64| 1e-3 * (pulse - centre_us) * inverse;
            self.residuals(&angle, [lag, delay, play_us])
        };
        let start = [centre_us, 1_000.0 / gain_us_per_rad, 0.04, 0.01];
        let reach = 1_000.0 / gain_us_per_rad.abs();
        let bounds = [
            [centre_us - 200.0, centre_us + 200.0],
            // Its sign is known.
            [0.3 * reach, 3.0 * reach].map(|gain| gain * gain_us_per_rad.signum()),
            SERVO_BOUNDS[0],
            SERVO_BOUNDS[1],
        ]
        .map(|[one, other]: [f64; 2]| [one.min(other), one.max(other)]);
        let scale = [0.5, 0.01, 0.001, 0.001];
        // Play has corners: together with it the search for the others would end at one of them.
        let mut near = start;
        let mut with_play = |play_us: f64| {
            let whole = |&[centre, inverse, lag, delay]: &[f64; 4]| {
                residuals(&[centre, inverse, lag, delay, play_us])
            };
            let found = gauss_newton(near, scale, bounds, whole)?;
            near = found;
            Some((whole(&found).iter().map(|r| r * r).sum::<f64>(), found))
        };
        // Golden section: one of the two inner points stays.
        const GOLDEN: f64 = 0.618_034;
        let [mut low, mut high] = [0.0, MOST_PLAY_US];
        let [mut one, mut other] = [high - GOLDEN * high, GOLDEN * high];
        let [mut at_one, mut at_other] = [with_play(one)?.0, with_play(other)?.0];
        while high - low > PLAY_STEP_US {
            if at_one < at_other {
                high = other;
                (other, at_other) = (one, at_one);
                one = high - GOLDEN * (high - low);
                at_one = with_play(one)?.0;
            } else {
                low = one;
                (one, at_one) = (other, at_other);
                other = low + GOLDEN * (high - low);
                at_other = with_play(other)?.0;
            }
        }
        let play_us = f64::midpoint(low, high);
        let (_, [centre_us, inverse, lag, delay]) = with_play(play_us)?;
        let found = [centre_us, inverse, lag, delay, play_us];
        let mut sums = [[0.0; 2]; 2];
        for (residual, moment) in residuals(&found).iter().zip(&self.motion.0[1..]) {
            let rate = moment.yaw_rate;
            let side = usize::from(rate < 0.0);
            sums[side][0] += residual * rate.signum();
            sums[side][1] += rate.abs();
        }
        Some(Wheels {
            centre_us,
            gain_us_per_rad: 1_000.0 / inverse,
            lag,
            delay,
            play_us,
            excess: sums.map(|[excess, turned]| if turned > 0.0 { excess / turned } else { 0.0 }),
        })
    }

    /// The angles of the wheels at these pulses, in rad, with straight lines between them, for a servo
    /// that is otherwise as `found`; every pulse of the pass should lie between them. None if the
    /// drive does not determine them.
    pub(crate) fn wheel_angles(
        &self,
        found: &Wheels,
        at_us: &[f64; PULSES],
    ) -> Option<[f64; PULSES]> {
        // The lag and the dead time that fitted a straight line are not quite those of this servo.
        let whole = |&[angles @ .., lag, delay]: &[f64; PULSES + 2]| {
            let pairs: [[f64; 2]; PULSES] = std::array::from_fn(|i| [at_us[i], angles[i]]);
            let angle = |pulse: f64| interpolate(&pairs, pulse);
            self.residuals(&angle, [lag, delay, found.play_us])
        };
        let [a, b, c, d, e] = at_us.map(|pulse| (pulse - found.centre_us) / found.gain_us_per_rad);
        let start = [a, b, c, d, e, found.lag, found.delay];
        let (wide, [lag, delay]) = ([-1.5, 1.5], SERVO_BOUNDS);
        let bounds = [wide, wide, wide, wide, wide, lag, delay];
        let [angles @ .., _, _] = gauss_newton(start, [1e-3; PULSES + 2], bounds, whole)?;
        Some(angles)
    }

    /// The measured yaw rate and that of the model from pose to pose: s, rad/s, rad/s.
    pub(crate) fn yaw_rates(&self, found: &Wheels) -> Vec<[f64; 3]> {
        let angle = |pulse: f64| (pulse - found.centre_us) / found.gain_us_per_rad;
        let residuals = self.residuals(&angle, [found.lag, found.delay, found.play_us]);
        let steps = self.motion.0.windows(2);
        let rates = steps.zip(residuals).map(|(pair, residual)| {
            let (begin, end) = (pair[0], pair[1]);
            let rate = (end.yaw - begin.yaw) / (end.time - begin.time);
            [f64::midpoint(begin.time, end.time), rate, rate - residual]
        });
        rates.collect()
    }

    /// The differences of the measured yaw rate from that of the model, from pose to pose, rad/s.
    fn residuals(&self, angle: &dyn Fn(f64) -> f64, [lag, delay, play_us]: [f64; 3]) -> Vec<f64> {
        let (pulses, speed, vehicle) = (self.pulses, &self.speed, self.vehicle);
        let Some(first) = self.motion.0.first() else {
            return Vec::new();
        };
        let mut now = first.time - AHEAD;
        let mut held = pulses.at(now - delay);
        let mut turned = angle(held);
        let bend = turned / vehicle.wheelbase_m();
        let beta = bend * vehicle.rear_axle_distance_m;
        let mut state = [bend * speed.first().unwrap_or(&0.0), beta];
        let share = 1.0 - (-STEP / lag).exp();
        let steps = self.motion.0.windows(2).zip(speed.windows(2));
        steps
            .map(|(pair, speed)| {
                let (begin, end) = (pair[0], pair[1]);
                let middle = f64::midpoint(begin.time, end.time);
                let speed = f64::midpoint(speed[0], speed[1]);
                while now + STEP <= middle {
                    now += STEP;
                    let pulse = pulses.mean(now - delay, STEP);
                    held = held.clamp(pulse - 0.5 * play_us, pulse + 0.5 * play_us);
                    let before = turned;
                    turned += share * (angle(held) - turned);
                    let steered = f64::midpoint(before, turned);
                    state = step(vehicle, state, speed.max(SLOWEST), steered, STEP);
                }
                if speed < SLOWEST || end.time <= begin.time {
                    return 0.0;
                }
                let rate = (end.yaw - begin.yaw) / (end.time - begin.time);
                // The remaining part of a step, as if the motion changed evenly.
                let next = step(vehicle, state, speed, turned, STEP)[0];
                let rest = (middle - now) / STEP;
                rate - state[0] - rest * (next - state[0])
            })
            .collect()
    }
}

/// Yaw rate and sideslip after a step with the rear axle's speed and the steering angle, of the
/// single-track model in small angles, with linear tyres.
fn step(
    vehicle: &VehicleParameters,
    [rate, sideslip]: [f64; 2],
    speed: f64,
    steered: f64,
    step: f64,
) -> [f64; 2] {
    let (mass, inertia) = (vehicle.mass_kg, vehicle.yaw_inertia_kg_m2);
    let (front, rear) = (vehicle.front_axle_distance_m, vehicle.rear_axle_distance_m);
    let c_f = vehicle.front_cornering_stiffness_n_rad;
    let c_r = vehicle.rear_cornering_stiffness_n_rad;
    // Of the centre of mass.
    let v = speed / sideslip.cos();
    let matrix = [
        [
            -(front * front * c_f + rear * rear * c_r) / (inertia * v),
            (rear * c_r - front * c_f) / inertia,
        ],
        [
            (rear * c_r - front * c_f) / (mass * v * v) - 1.0,
            -(c_f + c_r) / (mass * v),
        ],
    ];
    let input = [front * c_f / inertia * steered, c_f / (mass * v) * steered];
    // The trapezoidal rule: it is stable, however fast the tyres are.
    let half = 0.5 * step;
    let old = [rate, sideslip];
    let right: [f64; 2] = std::array::from_fn(|i| {
        old[i] + half * (matrix[i][0] * rate + matrix[i][1] * sideslip) + step * input[i]
    });
    let left = [
        [1.0 - half * matrix[0][0], -half * matrix[0][1]],
        [-half * matrix[1][0], 1.0 - half * matrix[1][1]],
    ];
    let determinant = left[0][0] * left[1][1] - left[0][1] * left[1][0];
    [
        (right[0] * left[1][1] - left[0][1] * right[1]) / determinant,
        (left[0][0] * right[1] - left[1][0] * right[0]) / determinant,
    ]
}

/// What the readings say.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Steering {
    /// Pulse for one radian to the left, us/rad.
    pub(crate) gain: Interval,
    /// Pulse that reads zero, us. The error that all readings share is not in it.
    pub(crate) straight: Interval,
    /// Standard deviation of the readings, rad.
    pub(crate) scatter: f64,
}

/// Fits a line through readings, each a pulse in us and an angle in rad.
///
/// A reading scatters by `least_scatter` at least, whatever these say, and all of them share
/// a relative error of `scale` (95 %). `None` if they show no slope.
pub(crate) fn fit_steering(
    readings: &[[f64; 2]],
    least_scatter: f64,
    scale: f64,
) -> Option<Steering> {
    let count = readings.len() as f64;
    if readings.len() < 3 {
        return None;
    }
    let line = Line::through(readings.iter().copied());
    let slope = line.slope;
    let squares: f64 = readings
        .iter()
        .map(|[pulse, angle]| (angle - line.at(*pulse)).powi(2))
        .sum();
    let freedom = readings.len() - 2;
    let scatter = (squares / freedom as f64).sqrt();
    let believed = scatter.max(least_scatter);
    let t = student_quantile(freedom);
    let random = t * believed / line.spread.sqrt();
    let half = random.hypot(scale * slope);
    if line.spread == 0.0 || slope.abs() <= half {
        return None;
    }
    let ends = [1.0 / (slope - half), 1.0 / (slope + half)];
    let zero = line.middle[0] - line.middle[1] / slope;
    let at_zero = believed * (1.0 / count + (zero - line.middle[0]).powi(2) / line.spread).sqrt();
    Some(Steering {
        gain: Interval::between(1.0 / slope, ends),
        straight: Interval::around(zero, t * at_zero / slope.abs()),
        scatter,
    })
}

#[cfg(test)]
mod tests {
    use singletrack_control::statistics::Random;

    use super::*;
    use crate::fit::track::Moment;

    const CAR: VehicleParameters = VehicleParameters {
        mass_kg: 1.9,
        yaw_inertia_kg_m2: 0.0251,
        front_axle_distance_m: 0.1368,
        rear_axle_distance_m: 0.1232,
        friction: 1.0,
        front_cornering_stiffness_n_rad: 58.0,
        rear_cornering_stiffness_n_rad: 131.0,
    };

    /// A pass over both circles with a weave, by a servo with these parameters.
    fn pass(seed: u64, truth: &Wheels) -> (Motion, Frames) {
        pass_of(seed, truth, &|pulse| {
            (pulse - truth.centre_us) / truth.gain_us_per_rad
        })
    }

    /// A pass with the angle that the wheels have at a pulse; `truth` has the one that the driver
    /// believes.
    fn pass_of(seed: u64, truth: &Wheels, turned_by: &dyn Fn(f64) -> f64) -> (Motion, Frames) {
        let mut noise = Random::new(seed);
        let phase = 0.02 * noise.uniform();
        let command = 0.01 * noise.uniform();
        let wanted = |time: f64| {
            // Commands come every 10 ms.
            let time = ((time - command) / 0.01).floor() * 0.01 + command;
            let side = if (time / 18.0).floor() as i64 % 2 == 0 {
                0.3
            } else {
                -0.3
            };
            // In no fixed relation to the frames.
            let weave = (time / 0.8137).rem_euclid(1.0);
            let triangle = if weave < 0.5 {
                4.0 * weave - 1.0
            } else {
                3.0 - 4.0 * weave
            };
            // Play shows as a delay that depends on the rate.
            let strong = (time / (3.0 * 0.8137)).floor() as i64 % 2 == 0;
            let angle = side + if strong { 0.12 } else { 0.03 } * triangle;
            (truth.centre_us + truth.gain_us_per_rad * angle).round()
        };
        let pulses = Frames(
            (0..1_900)
                .map(|index| phase + 0.02 * f64::from(index) - 0.5)
                .map(|time| (time, wanted(time)))
                .collect(),
        );
        let mut motion = Vec::new();
        let step = 2e-4;
        let (mut held, mut turned, mut yaw) = (wanted(0.0), 0.3, 0.0);
        let mut state = [0.3, 0.14];
        for index in 0..180_000 {
            let now = f64::from(index) * step;
            let acted = now - truth.delay;
            let pulse = wanted(((acted - phase) / 0.02 + 1e-9).floor() * 0.02 + phase);
            held = held.clamp(pulse - 0.5 * truth.play_us, pulse + 0.5 * truth.play_us);
            turned += step * (turned_by(held) - turned) / truth.lag;
            state = super::step(&CAR, state, 0.28, turned, step);
            yaw += step * state[0];
            if index % 50 == 0 && now > 0.3 {
                // White noise of the gyro's rate.
                yaw += 1e-4 * noise.normal(1.0);
                motion.push(Moment {
                    time: now + step,
                    position: [0.0; 2],
                    yaw,
                    yaw_rate: state[0],
                });
            }
        }
        (Motion(motion), pulses)
    }

    fn driven((motion, pulses): &(Motion, Frames)) -> Driven<'_> {
        Driven {
            speed: vec![0.28; motion.0.len()],
            motion: motion.clone(),
            pulses,
            vehicle: &CAR,
        }
    }

    #[test]
    fn steering_that_is_no_straight_line_is_found() {
        let believed = Wheels {
            centre_us: 1_500.0,
            gain_us_per_rad: -800.0,
            lag: 0.05,
            delay: 0.008,
            play_us: 2.0,
            excess: [0.0; 2],
        };
        let table = [
            [1_080.0, 0.50],
            [1_250.0, 0.38],
            [1_500.0, 0.0],
            [1_750.0, -0.26],
            [1_920.0, -0.36],
        ];
        let at_us = table.map(|[pulse, _]| pulse);
        let found: Vec<[f64; 5]> = (0..4)
            .map(|seed| {
                let turned_by = |pulse| interpolate(&table, pulse);
                let pass = pass_of(seed, &believed, &turned_by);
                let driven = driven(&pass);
                let line = driven.wheels([1_500.0, -800.0]).unwrap();
                driven.wheel_angles(&line, &at_us).unwrap()
            })
            .collect();
        for (index, [pulse, angle]) in table.into_iter().enumerate() {
            let mean = found.iter().map(|angles| angles[index]).sum::<f64>() / 4.0;
            println!("{pulse}: {mean:.4}, {angle}");
            assert!((mean - angle).abs() < 0.006, "{pulse}: {mean}, {angle}");
        }
    }

    /// Left out of `cargo verify`, not of `--all`: they take seconds of processor time each.
    mod thorough {
        use super::*;

        #[test]
        fn the_means_of_some_passes_are_those_of_the_servo() {
            for (seed, lag, delay, play_us) in [(1, 0.03, 0.01, 5.0), (2, 0.065, 0.004, 2.0)] {
                let truth = Wheels {
                    centre_us: 1_475.0,
                    gain_us_per_rad: -720.0,
                    lag,
                    delay,
                    play_us,
                    excess: [0.0; 2],
                };
                let found: Vec<Wheels> = (0..6)
                    .map(|index| {
                        let pass = pass(100 * seed + index, &truth);
                        driven(&pass).wheels([1_490.0, -750.0]).unwrap()
                    })
                    .collect();
                println!("{found:?}");
                let mean = |of: fn(&Wheels) -> f64| found.iter().map(of).sum::<f64>() / 6.0;
                assert!((mean(|f| f.centre_us) - 1_475.0).abs() < 0.3);
                assert!((mean(|f| f.gain_us_per_rad) + 720.0).abs() < 2.0);
                assert!((mean(|f| f.lag) - lag).abs() < 0.004);
                assert!((mean(|f| f.delay) - delay).abs() < 0.004);
            }
        }
    }

    #[test]
    fn the_interval_holds_the_gain_in_19_of_20_sets_of_readings() {
        let mut noise = Random::new(1);
        let mut held = [0; 2];
        for _ in 0..1_000 {
            let gain = (600.0 + 500.0 * noise.uniform()) * (1.0_f64).copysign(noise.normal(1.0));
            let centre = 1_450.0 + 100.0 * noise.uniform();
            let scale = 1.0 + 0.01 * noise.normal(1.0);
            let readings: Vec<_> = (0..12)
                .map(|index| {
                    let pulse = 1_200.0 + 50.0 * f64::from(index);
                    let angle = scale * (pulse - centre) / gain;
                    [pulse, angle + 0.0175 * noise.normal(1.0)]
                })
                .collect();
            let fit = fit_steering(&readings, 0.01, 0.02).unwrap();
            held[0] += u32::from(fit.gain.low <= gain && gain <= fit.gain.high);
            held[1] += u32::from((fit.straight.low..=fit.straight.high).contains(&centre));
        }
        assert!(
            held.iter().all(|held| (930..=990).contains(held)),
            "{held:?}"
        );
    }

    #[test]
    fn readings_without_a_slope_give_no_gain() {
        let level = [[1_400.0, 0.1], [1_500.0, 0.11], [1_600.0, 0.09]];
        assert!(fit_steering(&level, 0.0175, 0.02).is_none());
        let same = [[1_500.0, 0.1]; 5];
        assert!(fit_steering(&same, 0.0175, 0.02).is_none());
    }

    #[test]
    fn readings_without_scatter_are_believed_to_the_least_scatter_only() {
        let readings = [-300.0, -150.0, 0.0, 150.0, 300.0].map(|way| [1_500.0 + way, way / 800.0]);
        let fit = fit_steering(&readings, 0.0175, 0.0).unwrap();
        assert!((fit.gain.value - 800.0).abs() < 1e-9);
        assert!(fit.gain.high - fit.gain.low > 50.0, "{:?}", fit.gain);
    }
}
