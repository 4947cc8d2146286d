//! The steering servo, from a drive with bends.

use super::{Motion, Signal, gauss_newton};

/// The steering servo, as one pass shows it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Wheels {
    /// Pulse for straight wheels, µs.
    pub centre_us: f64,
    /// Pulse per angle to the left, µs/rad.
    pub gain_us_per_rad: f64,
    /// Time constant, s.
    pub lag: f64,
    /// Time from the pulse in the telemetry to the first movement, s.
    pub delay: f64,
    /// Play, µs.
    pub play_us: f64,
    /// How much more the car turns than the fit in bends to the left and to the right, as a
    /// fraction.
    pub excess: [f64; 2],
}

/// What is known of the car: the single-track model in small angles, with linear tyres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Turning {
    /// Mass, kg, and yaw inertia, kg m².
    pub inertia: [f64; 2],
    /// Distance of the front and the rear axle from the centre of mass, m.
    pub axles: [f64; 2],
    /// Cornering stiffness of the front and the rear axle, N/rad.
    pub stiffness: [f64; 2],
}

/// The step of the simulated servo, s.
const STEP: f64 = 0.002;

/// Slower poses tell nothing of the steering, m/s.
const SLOWEST: f64 = 0.05;

/// Fits the servo to the yaw rate: `speed` is that of the rear axle at every pose. `about` is
/// where the search begins. None if the drive does not determine it.
#[must_use]
pub fn wheels(
    motion: &Motion,
    pulses: &Signal,
    speed: &[f64],
    turning: &Turning,
    about: [f64; 2],
) -> Option<Wheels> {
    let [centre_us, gain_us_per_rad] = about;
    let pulses = &pulses.in_frames();
    let residuals = |parameters: &[f64; 5]| residuals(motion, pulses, speed, turning, parameters);
    let start = [centre_us, 1_000.0 / gain_us_per_rad, 0.04, 0.02, 3.0];
    let reach = 1_000.0 / gain_us_per_rad.abs();
    let bounds = [
        [centre_us - 200.0, centre_us + 200.0],
        // Its sign is known.
        [0.3 * reach, 3.0 * reach].map(|gain| gain * gain_us_per_rad.signum()),
        [0.002, 0.3],
        [0.0, 0.2],
        [0.0, 40.0],
    ]
    .map(|[one, other]: [f64; 2]| [one.min(other), one.max(other)]);
    let scale = [0.5, 0.01, 0.001, 0.001, 0.5];
    let found = gauss_newton(start, scale, bounds, residuals)?;
    let [centre_us, inverse, lag, delay, play_us] = found;
    let mut sums = [[0.0; 2]; 2];
    for (residual, rate) in residuals(&found).iter().zip(&motion.yaw_rate[1..]) {
        let side = usize::from(*rate < 0.0);
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

/// The differences of the measured yaw rate from that of the model, from pose to pose, rad/s.
fn residuals(
    motion: &Motion,
    pulses: &Signal,
    speed: &[f64],
    turning: &Turning,
    &[centre_us, inverse, lag, delay, play_us]: &[f64; 5],
) -> Vec<f64> {
    let Some(&start) = motion.time.first() else {
        return Vec::new();
    };
    let mut motion_state = [0.0; 2];
    let mut held = pulses.at(start - delay);
    let angle = |pulse: f64| (pulse - centre_us) * inverse * 1e-3;
    let mut turned = angle(held);
    let mut now = start;
    let share = 1.0 - (-STEP / lag).exp();
    (1..motion.time.len())
        .map(|index| {
            let [t0, t1] = [motion.time[index - 1], motion.time[index]];
            let middle = f64::midpoint(t0, t1);
            let speed = f64::midpoint(speed[index - 1], speed[index]);
            while now + STEP <= middle {
                now += STEP;
                let pulse = pulses.at(now - delay);
                held = held.clamp(pulse - 0.5 * play_us, pulse + 0.5 * play_us);
                let before = turned;
                turned += share * (angle(held) - turned);
                let steered = f64::midpoint(before, turned);
                motion_state = turning.step(motion_state, speed.max(SLOWEST), steered);
            }
            if speed < SLOWEST || t1 <= t0 {
                return 0.0;
            }
            let rate = (motion.yaw[index] - motion.yaw[index - 1]) / (t1 - t0);
            // The remaining part of a step, as if the motion changed evenly.
            let next = turning.step(motion_state, speed, turned)[0];
            let rest = (middle - now) / STEP;
            rate - motion_state[0] - rest * (next - motion_state[0])
        })
        .collect()
}

impl Turning {
    /// Yaw rate and sideslip after a step with the rear axle's speed and the steering angle.
    fn step(&self, [rate, sideslip]: [f64; 2], speed: f64, steered: f64) -> [f64; 2] {
        let [mass, inertia] = self.inertia;
        let [front, rear] = self.axles;
        let [c_f, c_r] = self.stiffness;
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
        let half = 0.5 * STEP;
        let old = [rate, sideslip];
        let right: [f64; 2] = std::array::from_fn(|i| {
            old[i] + half * (matrix[i][0] * rate + matrix[i][1] * sideslip) + STEP * input[i]
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
}
