//! The delay between two sensors that see the same motion.

use crate::{
    Interval,
    fit::{jackknife, least_squares},
};

/// Result of [`stamp_delay`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Delay {
    /// By how much the stamps of the angles are too late, in s.
    pub(crate) late: Interval,
    /// Angle of the cameras over angle of the gyro.
    pub(crate) scale: Interval,
}

/// The largest delay that is looked for, in s.
const RANGE: f64 = 0.25;
/// Its steps, in s: shorter than a quarter of a period of a twist.
const STEP: f64 = 0.025;
/// Steps of Gauss and Newton; each squares the error.
const STEPS: usize = 6;
/// Blocks for the interval.
const BLOCKS: usize = 10;

/// By how much the stamps of `angles` (s, rad, unwrapped) are too late, from angular velocities
/// (s, rad/s) of the same motion. A constant bias of the velocities does not matter.
/// `systematic` bounds the error of the stamps of the velocities, in s. None if the motion does
/// not tell.
pub(crate) fn stamp_delay(
    angles: &[(f64, f64)],
    velocities: &[(f64, f64)],
    systematic: f64,
) -> Option<Delay> {
    let turned = Turned::new(velocities)?;
    // All delays are compared on the same angles.
    let usable: Vec<(f64, f64)> = angles
        .iter()
        .copied()
        .filter(|(time, _)| turned.covers(time - RANGE) && turned.covers(time + RANGE))
        .collect();
    if usable.len() < 10 * BLOCKS {
        return None;
    }
    let steps = (RANGE / STEP) as i32;
    let (_, first) = (-steps..=steps)
        .filter_map(|step| {
            let late = f64::from(step) * STEP;
            let fit = least_squares(usable.iter().map(|(time, angle)| {
                let (turned, _) = turned.at(time - late);
                ([1.0, *time, turned], *angle)
            }))?;
            Some((fit.residual, late))
        })
        .min_by(|left, right| left.0.total_cmp(&right.0))?;
    let solve = |blocks: &[&&[(f64, f64)]]| {
        let mut late = first;
        let mut scale = 1.0;
        for _ in 0..STEPS {
            let rows = blocks.iter().flat_map(|block| block.iter());
            let fit = least_squares(rows.map(|(time, angle)| {
                let (turned, velocity) = turned.at(time - late);
                ([1.0, *time, turned, -velocity], *angle)
            }))?;
            scale = fit.parameters[2];
            late = (late + fit.parameters[3] / scale).clamp(-2.0 * RANGE, 2.0 * RANGE);
        }
        Some([late, scale])
    };
    let blocks: Vec<&[(f64, f64)]> = usable.chunks_exact(usable.len() / BLOCKS).collect();
    let [late, scale] = jackknife(&blocks, [systematic, 0.0], solve)?;
    Some(Delay { late, scale })
}

/// The integral of angular velocities.
struct Turned {
    /// Time, velocity and angle.
    points: Vec<(f64, f64, f64)>,
}

impl Turned {
    fn new(velocities: &[(f64, f64)]) -> Option<Self> {
        let mut angle = 0.0;
        let mut before: Option<(f64, f64)> = None;
        let points: Vec<_> = velocities
            .iter()
            .filter_map(|(time, velocity)| {
                if let Some((last, other)) = before {
                    if *time <= last {
                        return None;
                    }
                    angle += (time - last) * f64::midpoint(*velocity, other);
                }
                before = Some((*time, *velocity));
                Some((*time, *velocity, angle))
            })
            .collect();
        (points.len() > 1).then_some(Self { points })
    }

    fn covers(&self, time: f64) -> bool {
        match (self.points.first(), self.points.last()) {
            (Some(first), Some(last)) => (first.0..last.0).contains(&time),
            _ => false,
        }
    }

    /// Angle and velocity at a time.
    fn at(&self, time: f64) -> (f64, f64) {
        let after = self.points.partition_point(|point| point.0 <= time);
        let after = after.clamp(1, self.points.len() - 1);
        let (begin, begin_velocity, begin_angle) = self.points[after - 1];
        let (end, end_velocity, _) = self.points[after];
        let since = time - begin;
        let slope = (end_velocity - begin_velocity) / (end - begin);
        (
            begin_angle + since * (begin_velocity + since * slope / 2.0),
            begin_velocity + since * slope,
        )
    }
}

#[cfg(test)]
mod tests {
    use core::f64::consts::TAU;

    use super::*;
    use singletrack_statistics::Random;

    /// A twist by hand, seen by a gyro and by cameras whose stamps are too late.
    fn twist(seed: u64, late: f64, sign: f64) -> Option<Delay> {
        let mut noise = Random::new(seed);
        let period = 0.9 + 0.4 * noise.uniform();
        let yaw = |time: f64| 0.5 * (TAU * time / period).sin() + 0.2 * (0.7 * time).sin();
        let rate = |time: f64| (yaw(time + 1e-4) - yaw(time - 1e-4)) / 2e-4;
        let bias = 0.01 * noise.normal(1.0);
        let velocities: Vec<_> = (0..1_200)
            .map(|index| {
                let time = 0.01 * f64::from(index) + 0.003;
                // Rounded to the steps of the protocol.
                let read = rate(time) + bias + 0.003 * noise.normal(1.0);
                (time, sign * (read * 1e3).round() / 1e3)
            })
            .collect();
        let angles: Vec<_> = (0..1_200)
            .map(|index| {
                let time = 0.01 * f64::from(index);
                (time, yaw(time - late) + 0.001_7 * noise.normal(1.0))
            })
            .collect();
        stamp_delay(&angles, &velocities, 0.0)
    }

    #[test]
    fn a_gyro_of_the_other_sign_has_a_scale_of_the_other_sign() {
        let delay = twist(1, 0.01, -1.0).unwrap();
        assert!((delay.scale.value + 1.0).abs() < 0.01, "{delay:?}");
    }

    #[test]
    fn a_car_that_stands_tells_no_delay() {
        let still: Vec<_> = (0..1_200)
            .map(|index| (0.01 * f64::from(index), 0.0))
            .collect();
        assert_eq!(stamp_delay(&still, &still, 0.0), None);
        assert_eq!(stamp_delay(&[], &[], 0.0), None);
    }

    /// Left out of `cargo verify`, not of `--all`: they take seconds of processor time each.
    mod thorough {
        use super::*;

        #[test]
        fn delays_of_either_sign_are_inside_their_intervals() {
            let mut held = 0;
            let trials = 200;
            for seed in 0..trials {
                let late = 0.06 * (Random::new(seed + 7_000).uniform() - 0.5);
                let delay = twist(seed, late, 1.0).unwrap();
                assert!(
                    (delay.late.value - late).abs() < 0.002,
                    "{delay:?} for {late}"
                );
                assert!(delay.late.half_width() < 0.002, "{delay:?}");
                assert!((delay.scale.value - 1.0).abs() < 0.01, "{delay:?}");
                held += u64::from(delay.late.contains(late));
            }
            assert!(held * 100 >= trials * 90, "{held} of {trials}");
        }
    }
}
