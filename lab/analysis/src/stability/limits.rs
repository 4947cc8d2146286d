//! The limits of the sampled loop: the first unstable speed, and the least distance p.
//!
//! In continuous time both follow from a quadratic (see
//! [`critical_speed`](super::critical_speed)). With sampling, delay and a servo they are
//! searched for.

use super::{
    closed_loop::{ClosedLoop, StabilityError},
    sampled::SampledLoop,
};

/// The ratio of two values of the search: narrower regions are not found.
const RATIO: f64 = 1.05;
/// The relative resolution of the result.
const RESOLUTION: f64 = 1e-6;

/// The lowest speed in m/s from which the motion is unstable with one of `deviations` (dl, m),
/// between the ends of a range above zero. None if it is stable throughout; the
/// first speed if it is unstable there.
///
/// # Errors
///
/// A speed or a deviation without a steady motion.
pub fn first_unstable_speed(
    sampled: &SampledLoop,
    deviations: &[f64],
    [from, to]: [f64; 2],
) -> Result<Option<f64>, StabilityError> {
    boundary(from, to, |speed| {
        let at = sampled.closed_loop.with_speed(speed)?;
        is_stable(sampled, at, deviations)
    })
}

/// The least distance p in m from which on the motion is stable with each of `deviations` (dl,
/// m), between the ends of a range above zero. None if it is unstable at the last
/// one; the first one if it is stable throughout.
///
/// # Errors
///
/// A distance or a deviation without a steady motion.
pub fn least_point_distance(
    sampled: &SampledLoop,
    deviations: &[f64],
    [from, to]: [f64; 2],
) -> Result<Option<f64>, StabilityError> {
    let is_stable = |p: f64| {
        let at = sampled.closed_loop.with_point_distance(p)?;
        is_stable(sampled, at, deviations)
    };
    if !is_stable(to)? {
        return Ok(None);
    }
    // From the largest distance down.
    Ok(Some(boundary(to, from, is_stable)?.unwrap_or(from)))
}

fn is_stable(
    sampled: &SampledLoop,
    at: ClosedLoop,
    deviations: &[f64],
) -> Result<bool, StabilityError> {
    for deviation in deviations {
        if !sampled.around(at.with_deviation(*deviation)?).is_stable() {
            return Ok(false);
        }
    }
    Ok(true)
}

/// Where, on the way from `from` to `to`, the motion is no longer stable.
fn boundary(
    from: f64,
    to: f64,
    is_stable: impl Fn(f64) -> Result<bool, StabilityError>,
) -> Result<Option<f64>, StabilityError> {
    if !is_stable(from)? {
        return Ok(Some(from));
    }
    let steps = (libm::fabs(libm::log(to / from)) / libm::log(RATIO))
        .ceil()
        .max(1.0) as u32;
    let at = |step: u32| from * libm::pow(to / from, f64::from(step) / f64::from(steps));
    let mut stable = from;
    for step in 1..=steps {
        let mut unstable = at(step);
        if is_stable(unstable)? {
            stable = unstable;
            continue;
        }
        while libm::fabs(unstable - stable) > RESOLUTION * stable {
            let middle = 0.5 * (stable + unstable);
            if is_stable(middle)? {
                stable = middle;
            } else {
                unstable = middle;
            }
        }
        return Ok(Some(0.5 * (stable + unstable)));
    }
    Ok(None)
}
