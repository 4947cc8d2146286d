//! Whether the sensors of a drive agree at all: wrong signs, units and mountings, before anything is fitted.

use singletrack_control::wrap;

use super::{
    data::{DriveData, Pose, Span},
    error::IdentificationError,
    gyro_scale::GyroScale,
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
pub(super) fn check_unit(data: &DriveData) -> Result<(), IdentificationError> {
    let speeds = (0..data.poses.len()).filter_map(|index| data.speed_at(index));
    let mut speeds: Vec<f64> = speeds.collect();
    speeds.sort_by(f64::total_cmp);
    match speeds.get(speeds.len() / 2) {
        Some(median) if *median > FASTEST => Err(IdentificationError::TooFast { median: *median }),
        _ => Ok(()),
    }
}

/// Whether the sensors agree in the stretches.
pub(super) fn check_sensors(data: &DriveData, spans: &[Span]) -> Result<(), IdentificationError> {
    let within = |time: f64| spans.iter().any(|span| span.contains(time));
    type Value = fn(&super::data::Inertial) -> f64;
    let channels: [(&'static str, Value); 3] = [
        ("yaw rate", |sample| sample.yaw_rate_rad_s),
        ("acceleration forward", |sample| sample.forward_m_s2),
        ("acceleration to the left", |sample| sample.left_m_s2),
    ];
    for (what, value) in channels {
        let mut values = data
            .inertial
            .iter()
            .filter(|sample| within(sample.time_s))
            .map(value);
        if let Some(first) = values.next()
            && values.all(|value| value.to_bits() == first.to_bits())
        {
            return Err(IdentificationError::Dead { what, value: first });
        }
    }
    let travelled: Vec<Travel> = (0..data.poses.len())
        .filter_map(|index| Travel::at(data, index))
        .filter(|travel| within(travel.time_s))
        .collect();
    let count = travelled.len() as f64;
    let sum = |value: fn(f64) -> f64| {
        travelled
            .iter()
            .map(|travel| value(travel.beside))
            .sum::<f64>()
    };
    let (sine, cosine) = (sum(f64::sin) / count, sum(f64::cos) / count);
    if cosine < ALONG {
        let off = sine.atan2(cosine);
        return Err(IdentificationError::YawDiffers { off });
    }
    if let Some(scale) = GyroScale::of(data, spans)
        && !SCALE.contains(&scale.value)
        && scale.turning > TURNING
    {
        return Err(IdentificationError::GyroDiffers { ratio: scale.value });
    }
    let pairs = travelled.iter().filter_map(|travel| {
        let after = data
            .servo
            .partition_point(|target| target.time_s <= travel.time_s);
        let target = data.servo.get(after.checked_sub(1)?)?;
        Some([target.angle_rad, travel.curvature])
    });
    let correlation = correlation(&pairs.collect::<Vec<_>>());
    if correlation < OPPOSES {
        return Err(IdentificationError::SteeringOpposes { correlation });
    }
    Ok(())
}

/// How the car moved around a pose.
struct Travel {
    time_s: f64,
    /// Course less yaw, in rad.
    beside: f64,
    /// Of the path that the yaw shows, in 1/m.
    curvature: f64,
}

impl Travel {
    fn at(data: &DriveData, index: usize) -> Option<Self> {
        const REACH: usize = 6;
        let from: &Pose = data.poses.get(index.checked_sub(REACH)?)?;
        let to = data.poses.get(index + REACH)?;
        let pose = data.poses.get(index)?;
        let way = (to.x_m - from.x_m).hypot(to.y_m - from.y_m);
        (way > 0.0).then(|| Self {
            time_s: pose.time_s,
            beside: wrap((to.y_m - from.y_m).atan2(to.x_m - from.x_m) - pose.yaw_rad),
            curvature: wrap(to.yaw_rad - from.yaw_rad) / way,
        })
    }
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
