//! ESC, motor and gears: the settled speed over the pulse, and how the speed follows its changes.
//!
//! Beyond an edge the settled speed is `v = g x / (1 + x / s)`, with `x` the way of the pulse
//! beyond the edge: a line that bends. Its inverse `x = a v / (1 - w v)` has two parameters that
//! enter linearly, the edge and `a = 1 / g`, and the bend `w`, which is searched.

use nalgebra::Vector3;
use singletrack_control::student_quantile;

use super::{Frames, LeastSquares, gauss_newton, least_squares, statistics::inverted};
use crate::Interval;

/// How the speed follows the ESC's pulse, as one change of the speed shows it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct DriveTrain {
    /// Pulse per speed, µs/(m/s), between the two speeds.
    pub(crate) us_per_m_s: f64,
    /// Pulse at which the wheels begin to turn, µs.
    pub(crate) edge_us: f64,
    /// Time constant, s.
    pub(crate) lag: f64,
    /// Time from the pulse in the telemetry to the first change, s.
    pub(crate) delay: f64,
}

/// The step of the simulated motor, s.
const STEP: f64 = 0.002;

/// Fits the way of the rear axle (times in s and ways in m) through a change from the first of two
/// speeds to the second, m/s. `about` is the pulse per speed and that at zero speed where the
/// search begins. The map is bent as that of most motors is: the two speeds do not show it. A motor that
/// turns faster than its pulse wants does not brake: the car rolls, with `rolling` m/s². None if
/// it is not determined.
pub(crate) fn drive_train(
    ways: &[[f64; 2]],
    pulses: &Frames,
    speeds: [f64; 2],
    about: [f64; 2],
    rolling: f64,
) -> Option<DriveTrain> {
    let [start, first] = *ways.first()?;
    let [late, after] = ways.iter().find(|[time, _]| *time >= start + 0.2)?;
    let speed = (after - first) / (late - start);
    let [us_per_m_s, edge_us] = about;
    let scale = [0.01, 0.5, 0.002, 0.002, 1e-4, 1e-3];
    let begin = [1_000.0 / us_per_m_s, edge_us, 0.08, 0.03, first, speed];
    let bounds = [
        [0.1 * begin[0], 10.0 * begin[0]],
        [edge_us - 100.0, edge_us + 100.0],
        [0.005, 0.6],
        [-0.03, 0.2],
        [first - 0.1, first + 0.1],
        [-0.1, 3.0],
    ];
    let [gain, edge_us, lag, delay, ..] = gauss_newton(
        begin,
        scale,
        bounds,
        |&[gain, edge, lag, delay, at, speed]| {
            let share = 1.0 - (-STEP / lag).exp();
            let (mut now, mut position, mut speed) = (start, at, speed);
            ways.iter()
                .map(|&[time, way]| {
                    while now + STEP <= time {
                        now += STEP;
                        let beyond = (pulses.mean(now - delay, STEP) - edge).max(0.0) * gain * 1e-3;
                        let wanted = beyond / (1.0 + USUAL_BEND * beyond);
                        let change = (share * (wanted - speed)).max(-rolling * STEP);
                        position += (speed + 0.5 * change) * STEP;
                        speed += change;
                    }
                    way - position - speed * (time - now)
                })
                .collect()
        },
    )?;
    let bent: f64 = speeds.map(|v| 1.0 - USUAL_BEND * v).iter().product();
    Some(DriveTrain {
        us_per_m_s: bent.recip() * 1_000.0 / gain,
        edge_us,
        lag,
        delay,
    })
}

/// The deceleration of a roll-out, m/s²: the square of its speed over twice the way. The times in
/// s and the ways in m begin while the car drives at its speed and end when it stands. None
/// without a roll-out from 0.1 m/s or more.
pub(crate) fn roll_out(ways: &[[f64; 2]]) -> Option<f64> {
    /// Poses from which the search takes its first speed.
    const FIRST: usize = 10;
    /// The share of the speed in the deceleration, 1/s: a short roll-out does not show it.
    const VISCOUS: f64 = 0.7;
    /// One that lasts longer does, s.
    const LONG: f64 = 0.6;
    /// A way that it has fallen behind by is no noise, m.
    const FALLEN: f64 = 0.003;
    let ([start, first], [_, last]) = (*ways.first()?, *ways.last()?);
    let [time, way] = ways.get(FIRST)?;
    let speed = (way - first) / (time - start);
    // It has stood for the last part.
    let [_, stood] = ways.get(ways.len().checked_sub(FIRST)?)?;
    if !(speed > 0.1 && last > first && last - stood < 0.002) {
        return None;
    }
    // Where it has fallen behind its first speed, and what the rest of its way says.
    let behind = |[t, x]: &&[f64; 2]| first + speed * (t - start) - x > FALLEN;
    let [begin, at] = ways.iter().find(behind)?;
    let guess = (0..5).fold(1.0, |guess: f64, _| {
        let until = (2.0 * FALLEN / guess).sqrt();
        let rolled = last - at + speed * until - FALLEN;
        speed * speed / (2.0 * rolled.max(1e-3))
    });
    let residuals = |[at, speed, begin, rolling]: [f64; 4], viscous: f64| {
        let level = rolling / viscous;
        let lasts = (speed / level).ln_1p() / viscous;
        let residual = move |&[time, way]: &[f64; 2]| {
            let steady = time.min(begin) - start;
            let slowing = (time - begin).clamp(0.0, lasts);
            let faded = -(-viscous * slowing).exp_m1() / viscous;
            way - at - speed * steady - (speed + level) * faded + level * slowing
        };
        ways.iter().map(residual).collect()
    };
    let scale = [1e-4, 1e-3, 1e-3, 1e-2];
    let bounds = [
        [first - 0.005, first + 0.005],
        [0.9 * speed, 1.1 * speed],
        [begin - 0.25, begin + 0.02],
        [0.05, 20.0],
    ];
    let [at, speed, begin] = if speed < LONG * guess {
        let start = [first, speed, *begin, guess];
        let found = gauss_newton(start, scale, bounds, |four| residuals(*four, VISCOUS));
        found.map(|[at, speed, begin, _]| [at, speed, begin])?
    } else {
        let ([low, high, near, most], [one, two, three, four]) = (bounds, scale);
        let start = [first, speed, *begin, 0.7 * guess, 0.3];
        let scale = [one, two, three, four, 1e-2];
        let bounds = [low, high, near, most, [0.01, 3.0]];
        let found = gauss_newton(start, scale, bounds, |&[four @ .., viscous]| {
            residuals(four, viscous)
        });
        found.map(|[at, speed, begin, ..]| [at, speed, begin])?
    };
    let rolled = last - at - speed * (begin - start);
    let found = speed * speed / (2.0 * rolled);
    // Anything else is no roll-out.
    (0.3 * guess < found && found < 2.0 * guess).then_some(found)
}

/// The deceleration of the rear axle over these times, m/s², by a parabola. None of fewer than
/// four.
pub(crate) fn deceleration(ways: &[[f64; 2]]) -> Option<f64> {
    let [start, _] = *ways.first().filter(|_| ways.len() >= 4)?;
    let fit = least_squares(ways.iter().map(|[time, way]| {
        let t = time - start;
        ([1.0, t, t * t], *way)
    }))?;
    Some(-2.0 * fit.parameters[2])
}

/// Highest bend that is searched, s/m: speeds reach 0.9 m/s, and 1/w is the highest of all.
const MAX_BEND: f64 = 0.8;

/// Steps of the search.
const BENDS: u32 = 160;

/// The bend of drive trains, and its standard deviation, s/m: what is known before. Without it
/// slow speeds alone, or few, say nothing of the edge.
const USUAL_BEND: f64 = 0.25;
const BEND_SPREAD: f64 = 0.2;

/// What a pulse rounds to: the least scatter that is believed, us.
const LEAST_SCATTER_US: f64 = 0.3;

/// A curve of settled speeds.
#[derive(Clone, Copy, Debug)]
pub(crate) struct SpeedCurve {
    /// Pulse beyond neutral up to which the wheels stand, us.
    pub(crate) edge: Interval,
    /// Pulse beyond the edge for each m/s, at the speed that was asked for, us/(m/s).
    pub(crate) feed_forward: Interval,
    /// Standard deviation of the pulses around the curve, us.
    pub(crate) scatter: f64,
    slope: f64,
    bend: f64,
}

impl SpeedCurve {
    /// The pulse beyond neutral that settles at this speed, us.
    pub(crate) fn pulse(&self, speed: f64) -> f64 {
        self.edge.value + self.slope * bent(speed, self.bend)
    }
}

fn bent(speed: f64, bend: f64) -> f64 {
    speed / (1.0 - bend * speed)
}

/// Fits settled speeds, each after its pulse beyond neutral, in us and m/s, both positive.
///
/// `systematic_us` is what all of them may be off by: the wheels of some drive trains begin to
/// turn later than they stop. The feed-forward is that at `at_speed`. `None` of fewer than five
/// readings, or if they show no curve.
pub(crate) fn fit_speed_curve(
    readings: &[[f64; 2]],
    systematic_us: f64,
    at_speed: f64,
) -> Option<SpeedCurve> {
    let freedom = readings.len().checked_sub(3).filter(|left| *left >= 2)?;
    let of_bend = |bend: f64| {
        let rows = readings
            .iter()
            .map(move |[pulse, speed]| ([1.0, bent(*speed, bend)], *pulse));
        least_squares(rows).filter(|fit| fit.parameters[1] > 0.0)
    };
    let unlikely = |(bend, fit): &(f64, LeastSquares<2>)| {
        fit.count as f64 * (fit.residual / LEAST_SCATTER_US).powi(2)
            + ((bend - USUAL_BEND) / BEND_SPREAD).powi(2)
    };
    let (bend, fit) = (0..=BENDS)
        .map(|step| MAX_BEND * f64::from(step) / f64::from(BENDS))
        .filter(|bend| readings.iter().all(|[_, speed]| bend * speed < 0.95))
        .filter_map(|bend| Some((bend, of_bend(bend)?)))
        .min_by(|a, b| unlikely(a).total_cmp(&unlikely(b)))?;
    let [edge, slope] = fit.parameters;
    let scatter = fit.residual * (fit.count as f64 / freedom as f64).sqrt();
    // Linear around the solution, the bend with it.
    let believed = scatter.max(LEAST_SCATTER_US);
    let known = Vector3::new(0.0, 0.0, believed / BEND_SPREAD);
    let mut normal = known * known.transpose();
    for [_, speed] in readings {
        let by = bent(*speed, bend);
        let row = Vector3::new(1.0, by, slope * by * by);
        normal += row * row.transpose();
    }
    let covariance = inverted(&normal)?;
    let error_along = |towards: Vector3<f64>| towards.dot(&(covariance * towards)).max(0.0).sqrt();
    let half = student_quantile(freedom) * believed;
    let at = bent(at_speed, bend);
    let towards = Vector3::new(0.0, at / at_speed, slope * at * at / at_speed);
    Some(SpeedCurve {
        edge: Interval::around(edge, half * error_along(Vector3::x())).widened(systematic_us),
        feed_forward: Interval::around(slope * at / at_speed, half * error_along(towards))
            .widened(systematic_us / at_speed),
        scatter,
        slope,
        bend,
    })
}

#[cfg(test)]
mod tests {
    use singletrack_control::statistics::Random;

    use super::*;

    /// A rise of the speed by a motor with a bent map: its pulses, and the way by the cameras.
    fn rise(seed: u64, truth: &DriveTrain, bend: f64) -> (Frames, Vec<[f64; 2]>) {
        let mut noise = Random::new(seed);
        let phase = 0.02 * noise.uniform();
        let slope = truth.us_per_m_s * (1.0 - 0.15 * bend) * (1.0 - 0.3 * bend);
        let pulse = |speed: f64| truth.edge_us + slope * speed / (1.0 - bend * speed);
        let (from, to) = (pulse(0.15), pulse(0.3));
        // The speed loop: a kick, and a ramp.
        let wanted = |time: f64| {
            let since = (time - 0.5).max(0.0);
            let kick = 4.0 * (-since / 0.2).exp() * since.min(0.05) / 0.05;
            (from + (to - from) * (since / 0.1).min(1.0) + kick).round()
        };
        let pulses = Frames(
            (0..110)
                .map(|index| phase + 0.02 * f64::from(index))
                .map(|time| (time, wanted(time)))
                .collect(),
        );
        let mut ways = Vec::new();
        let step = 1e-4;
        let (mut speed, mut position) = (0.15, 0.0);
        for index in 0..20_000 {
            let now = f64::from(index) * step;
            let acted = now - truth.delay;
            let frame = ((acted - phase) / 0.02).floor() * 0.02 + phase;
            let beyond = (wanted(frame) - truth.edge_us) / slope;
            let target = beyond / (1.0 + bend * beyond);
            speed += step * (target - speed) / truth.lag;
            position += step * speed;
            if index % 100 == 0 && now > 0.1 && now < 1.8 {
                ways.push([now + step, position + 0.000_2 * noise.normal(1.0)]);
            }
        }
        (pulses, ways)
    }

    #[test]
    fn a_roll_out_decelerates_by_the_square_of_its_speed_over_twice_its_way() {
        let mut noise = Random::new(5);
        for (speed, rolling, viscous) in [
            (0.3, 0.4, 0.3),
            (0.3, 2.0, 0.5),
            (0.6, 1.4, 1.2),
            (1.0, 0.3, 0.2),
        ] {
            let mut ways = Vec::new();
            let (mut now, mut position, mut rolled) = (speed, 0.0, 0.0);
            for index in 0..60_000 {
                if index % 100 == 0 {
                    let time = 1e-4 * f64::from(index);
                    ways.push([time, position + 0.000_2 * noise.normal(1.0)]);
                }
                if index > 2_345 {
                    now = f64::max(now - 1e-4 * (rolling + viscous * now), 0.0);
                    rolled += 1e-4 * now;
                }
                position += 1e-4 * now;
            }
            let truth = speed * speed / (2.0 * rolled);
            let found = roll_out(&ways).unwrap();
            // The viscous part is not known.
            assert!((found / truth - 1.0).abs() < 0.08, "{truth}: {found}");
            // Still rolling, and never.
            assert_eq!(roll_out(&ways[..40]), None);
            assert_eq!(roll_out(&ways[500..]), None);
        }
    }

    #[test]
    fn the_means_of_some_rises_are_those_of_the_motor() {
        for (seed, lag, delay, bend) in [
            (1, 0.06, 0.035, 0.25),
            (2, 0.1, 0.02, 0.1),
            (3, 0.14, 0.012, 0.4),
        ] {
            let truth = DriveTrain {
                us_per_m_s: 90.0,
                edge_us: 1_528.0,
                lag,
                delay,
            };
            let found: Vec<DriveTrain> = (0..40)
                .map(|rise_seed| {
                    let (pulses, ways) = rise(seed * 1_000 + rise_seed, &truth, bend);
                    drive_train(&ways, &pulses, [0.15, 0.3], [110.0, 1_525.0], 1.0).unwrap()
                })
                .collect();
            let mean = |of: fn(&DriveTrain) -> f64| found.iter().map(of).sum::<f64>() / 40.0;
            let (found_lag, found_delay) = (mean(|f| f.lag), mean(|f| f.delay));
            assert!(
                (found_lag - lag).abs() < 0.004,
                "{lag}: {found_lag}, {delay}: {found_delay}"
            );
            assert!(
                (found_delay - delay).abs() < 0.004,
                "{delay}: {found_delay}"
            );
            assert!((mean(|f| f.us_per_m_s) - 90.0).abs() < 1.0);
        }
    }

    fn speed(gain: f64, saturation: f64, beyond: f64) -> f64 {
        gain * beyond / (1.0 + beyond / saturation)
    }

    #[test]
    fn the_interval_holds_edge_and_feed_forward_in_19_of_20_sets() {
        let mut noise = Random::new(2);
        let mut held = [0; 2];
        for _ in 0..500 {
            let gain = 0.006 + 0.01 * noise.uniform();
            let saturation = 300.0 + 500.0 * noise.uniform();
            let edge = 20.0 + 30.0 * noise.uniform();
            let mut readings = Vec::new();
            let mut pulse = edge.ceil() + 6.0;
            while speed(gain, saturation, pulse - edge) < 0.75 {
                for _ in 0..2 {
                    let settled = speed(gain, saturation, pulse - edge);
                    readings.push([pulse, settled + 0.004 * noise.normal(1.0)]);
                }
                pulse += 9.0;
            }
            let fit = fit_speed_curve(&readings, 0.0, 0.5).unwrap();
            // Half of the linear speed is reached at a speed of gain times saturation.
            let needed = 0.5 / gain / (1.0 - 0.5 / (gain * saturation));
            held[0] += u32::from(fit.edge.contains(edge));
            held[1] += u32::from(fit.feed_forward.contains(needed / 0.5));
        }
        assert!(held.iter().all(|held| *held >= 460), "{held:?}");
    }

    #[test]
    fn the_pulse_of_a_speed_is_that_of_the_curve() {
        let readings: Vec<_> = (1..9)
            .map(|step| {
                let pulse = 40.0 + 10.0 * f64::from(step);
                [pulse, speed(0.01, 400.0, pulse - 30.0)]
            })
            .collect();
        let fit = fit_speed_curve(&readings, 0.0, 0.5).unwrap();
        assert!((fit.edge.value - 30.0).abs() < 0.5, "{fit:?}");
        assert!((fit.pulse(readings[3][1]) - readings[3][0]).abs() < 0.3);
        assert!(fit.scatter < 0.1);
    }

    #[test]
    fn too_few_readings_or_none_that_rise_give_no_curve() {
        let flat: Vec<_> = (0..8).map(|step| [f64::from(step), 0.3]).collect();
        assert!(fit_speed_curve(&flat, 0.0, 0.5).is_none());
        let falls: Vec<_> = (0..8)
            .map(|step| [50.0 - f64::from(step), 0.1 + 0.05 * f64::from(step)])
            .collect();
        assert!(fit_speed_curve(&falls, 0.0, 0.5).is_none());
        assert!(fit_speed_curve(&[[40.0, 0.1], [50.0, 0.2]], 0.0, 0.5).is_none());
    }
}
