//! A learner that tells the pilot anything: what is true, its opposite, by turns, or no number.

use singletrack_pilot::Learned;

/// What it says in this second of a schedule with this seed; `None` if it is silent.
pub(crate) fn learned(seed: u64, second: u64) -> Option<Learned> {
    let kind = seed / 3 % 5;
    // A pattern of signs, one for each schedule.
    let signs = seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 58;
    let sign = |bit: u64| if signs >> bit & 1 == 0 { 1.0 } else { -1.0 };
    let factor = match kind {
        0 => 1.0,
        1 => 0.3,
        2 if second.is_multiple_of(2) => 1e9,
        2 => -1e9,
        3 if second.is_multiple_of(3) => f64::NAN,
        3 => f64::INFINITY,
        _ if second.is_multiple_of(4) => return None,
        _ => -1.0,
    };
    let most = Learned::MOST;
    Some(Learned {
        steering_gain: sign(0) * factor * most.steering_gain,
        steering_trim: sign(1) * factor * most.steering_trim,
        stamp_offset: sign(2) * factor * most.stamp_offset,
        body_yaw: sign(3) * factor * most.body_yaw,
        pivot_forward: sign(4) * factor * most.pivot_forward,
        pivot_left: sign(5) * factor * most.pivot_left,
    })
}
