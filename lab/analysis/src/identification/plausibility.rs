//! Whether the sensors of a drive agree at all: wrong signs, units and mountings, before anything is fitted.

use super::{
    data::{DriveData, GyroScale, Inertial, Seen, Span, are_at, median, seen},
    error::{IdentificationError, Result},
};

/// A car with a faster median speed is not a small car, in m/s: the unit of its positions is wrong.
const FASTEST: f64 = 50.0;
/// The mean cosine of the angle between yaw and course, below which the yaw is not that of the car.
const ALONG: f64 = 0.5;
/// The gyro's scale beyond which its unit or sign is wrong.
const SCALE: core::ops::RangeInclusive<f64> = 0.7..=1.4;
/// The standard deviation of the yaw rate, above which the cameras' noise does not hide it, in rad/s.
const TURNING: f64 = 0.3;
/// The correlation of steering and curvature below which the steering's sign is wrong.
const OPPOSES: f64 = -0.5;

/// Whether the positions have a possible unit.
pub(super) fn check_unit(data: &DriveData) -> Result<()> {
    match median(data.speeds().collect()) {
        Some(median) if median > FASTEST => Err(IdentificationError::TooFast(median)),
        _ => Ok(()),
    }
}

/// Whether the sensors agree in the stretches.
pub(super) fn check_sensors(data: &DriveData, spans: &[Span]) -> Result<()> {
    let within = |time: f64| are_at(spans, time);
    type Value = fn(&Inertial) -> f64;
    let channels: [(&'static str, Value); 3] = [
        ("yaw rate", |sample| sample.yaw_rate_rad_s),
        ("acceleration forward", |sample| sample.forward_m_s2),
        ("acceleration to the left", |sample| sample.left_m_s2),
    ];
    for (what, value) in channels {
        let inertial = data.inertial.iter();
        let mut values = inertial.filter(|sample| within(sample.time_s)).map(value);
        if let Some(first) = values.next()
            && !first.is_nan()
            && values.all(|value| value.to_bits() == first.to_bits())
        {
            return Err(IdentificationError::Dead(what, first));
        }
    }
    let times = data.poses.iter().map(|pose| pose.time_s);
    let moved = times.filter(|time| within(*time));
    let moved: Vec<(f64, Seen)> = moved
        .filter_map(|time| Some((time, seen(&data.poses, time)?)))
        .collect();
    let count = moved.len() as f64;
    let sum = |value: fn(f64) -> f64| {
        let values = moved.iter().map(|(_, seen)| value(seen.sideslip));
        values.sum::<f64>()
    };
    let (sine, cosine) = (sum(f64::sin) / count, sum(f64::cos) / count);
    if cosine < ALONG {
        let off = sine.atan2(cosine);
        return Err(IdentificationError::YawDiffers(off));
    }
    if let Some(scale) = GyroScale::of(data, spans)
        && !SCALE.contains(&scale.value)
        && scale.turning > TURNING
    {
        return Err(IdentificationError::GyroDiffers(scale.value));
    }
    let pairs = moved.iter().filter_map(|(time, seen)| {
        let after = data.servo.partition_point(|target| target.time_s <= *time);
        let target = data.servo.get(after.checked_sub(1)?)?;
        Some([target.angle_rad, seen.yaw_rate / seen.speed])
    });
    let correlation = correlation(&pairs.collect::<Vec<_>>());
    if correlation < OPPOSES {
        return Err(IdentificationError::SteeringOpposes(correlation));
    }
    Ok(())
}

/// The correlation of pairs of numbers; 0 if one of them does not change.
fn correlation(pairs: &[[f64; 2]]) -> f64 {
    let count = pairs.len() as f64;
    let mean = |index: usize| pairs.iter().map(|pair| pair[index]).sum::<f64>() / count;
    let (one, other) = (mean(0), mean(1));
    let sum = |value: &dyn Fn(&[f64; 2]) -> f64| pairs.iter().map(value).sum::<f64>();
    let product = sum(&|pair| (pair[0] - one) * (pair[1] - other));
    let squares = sum(&|pair| (pair[0] - one).powi(2)) * sum(&|pair| (pair[1] - other).powi(2));
    if squares > 0.0 {
        product / squares.sqrt()
    } else {
        0.0
    }
}
