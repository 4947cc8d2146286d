//! Steering that is no straight line: the table in its place.

use singletrack_control::{SteeringTable, VehicleParameters};
use singletrack_core::config::ServoSection;

use super::floor::round;
use crate::{
    Interval,
    fit::{self, Body, Frames, Motion, Wheels},
};

/// Angles that are off the line by less in all passes are left to the line, rad.
const STRAIGHT: f64 = 0.01;
/// The least room for two straight parts to a side, µs.
const ROOM_US: f64 = 80.0;

/// The steering as pairs, and how far it is from a straight line.
pub(super) struct Bent {
    pub(super) table: SteeringTable,
    /// Of the angle that is farthest from the line, rad.
    pub(super) off: Interval,
}

impl Bent {
    /// Whether the line is worse than its tolerance.
    pub(super) fn is_bent(&self) -> bool {
        self.off.low.abs().min(self.off.high.abs()) > STRAIGHT
            && self.off.low.signum() == self.off.high.signum()
    }

    /// The pairs as TOML.
    pub(super) fn value(&self) -> toml_edit::Value {
        pairs(self.table.pairs().iter().copied())
    }
}

/// The table of a straight line with this centre in µs and gain in µs/rad, between two pulses: it takes
/// the place of one that holds no more.
pub(crate) fn straight_line(
    centre_us: f64,
    gain_us_per_rad: f64,
    [min_us, max_us]: [f64; 2],
) -> toml_edit::Value {
    let angle = |pulse_us: f64| round((pulse_us - centre_us) / gain_us_per_rad, 4);
    pairs([min_us, max_us].map(|pulse_us| [pulse_us, angle(pulse_us)]))
}

/// Pairs of pulse and angle as TOML.
fn pairs(pairs: impl IntoIterator<Item = [f64; 2]>) -> toml_edit::Value {
    toml_edit::Value::from_iter(pairs.into_iter().map(toml_edit::Value::from_iter))
}

/// Fits two straight parts to either side to every pass. None if the passes don't determine them,
/// or if what they give is no table.
pub(super) fn bent(
    motions: &[Motion],
    pulses: &Frames,
    vehicle: &VehicleParameters,
    passes: &[(Body, Wheels)],
    servo: &ServoSection,
) -> Option<Bent> {
    let centre_us = fit::mean(passes.iter().map(|(_, wheels)| wheels.centre_us))?;
    let gain_us_per_rad = fit::mean(passes.iter().map(|(_, wheels)| wheels.gain_us_per_rad))?;
    let begin = *motions.first()?.time.first()?;
    let end = *motions.last()?.time.last()?;
    let driven = pulses
        .0
        .iter()
        .filter(|(time, _)| (begin..end).contains(time));
    let [least, most] = driven.fold([f64::INFINITY, 0.0_f64], |[least, most], &(_, pulse)| {
        [least.min(pulse), most.max(pulse)]
    });
    let fitted = |middle: f64| {
        if middle - least < ROOM_US || most - middle < ROOM_US {
            return None;
        }
        let at_us = [
            least,
            f64::midpoint(least, middle),
            middle,
            f64::midpoint(middle, most),
            most,
        ]
        .map(f64::round);
        let angles: Vec<[f64; 5]> = motions
            .iter()
            .zip(passes)
            .map(|(motion, (body, wheels))| {
                let speed = motion.rear_speed(body.yaw, body.left, 2);
                fit::wheel_angles(motion, pulses, &speed, vehicle, wheels, &at_us)
            })
            .collect::<Option<_>>()?;
        let mut pairs = Vec::with_capacity(at_us.len() + 2);
        for (index, pulse) in at_us.into_iter().enumerate() {
            pairs.push([pulse, fit::mean(angles.iter().map(|angles| angles[index]))?]);
        }
        Some((pairs, angles))
    };
    // Where the wheels are straight the steering has its corner, if it has one. That is not where the
    // straight line has its zero.
    let (first, _) = fitted(centre_us)?;
    let (mut pairs, angles) = fitted(SteeringTable::new(&first).ok()?.pulse(0.0))?;
    let mut off: Option<Interval> = None;
    for (index, [pulse, _]) in pairs.iter().enumerate() {
        let line = (pulse - centre_us) / gain_us_per_rad;
        let this = fit::mean_interval(angles.iter().map(|angles| angles[index] - line), 0.0)?;
        if off.is_none_or(|off| this.value.abs() > off.value.abs()) {
            off = Some(this);
        }
    }
    // To the ends of the servo, as at the last pulses that were driven.
    let onward = |[from, angle]: [f64; 2], [to, next]: [f64; 2], end: u16| {
        let end = f64::from(end);
        [end, next + (end - to) * (next - angle) / (to - from)]
    };
    if f64::from(servo.min_us) < least {
        pairs.insert(0, onward(pairs[1], pairs[0], servo.min_us));
    }
    if f64::from(servo.max_us) > most {
        let last = pairs.len() - 1;
        pairs.push(onward(pairs[last - 1], pairs[last], servo.max_us));
    }
    for pair in &mut pairs {
        pair[1] = round(pair[1], 4);
    }
    Some(Bent {
        table: SteeringTable::new(&pairs).ok()?,
        off: off?,
    })
}
