//! The bring-up of a car whose wheels are clear of the floor: it measures everything that servo
//! and ESC do before the car is put down.
//!
//! The kill switch comes first, then the ESC at rest, the servo, the motor, and every way to stop.
//! All pulses are jogs: the board holds them within its own limits, and ends them when the
//! command line, the daemon or the line is gone. The cameras watch the car in every tick, and an
//! emergency stop ends the step if it leaves its stand.
//!
//! A step that measures puts its result in force, because later steps rely on it. An interrupted
//! bring-up continues after the last step that was completed.

mod car;
mod esc_kind;
mod imu_noise;
mod kill;
mod motor;
mod neutral;
mod place;
mod questions;
mod request;
mod spin;
mod stand;
mod steering;
mod stops;

use crate::Step;

/// The steps. The ESC is watched at neutral for a minute in each order, to find a motor that
/// turns only now and then.
pub const STEPS: &[Step] = &steps_with::<60>();

/// The steps; the ESC is watched at neutral for `NEUTRAL_S` seconds in each order.
#[must_use]
pub const fn steps_with<const NEUTRAL_S: u32>() -> [Step; 16] {
    [
        stand::STEP,
        kill::STEP,
        neutral::step_with::<NEUTRAL_S>(),
        steering::DIRECTION,
        steering::CENTRE,
        steering::STOPS,
        steering::GAIN,
        motor::DIRECTION,
        motor::MAP,
        esc_kind::STEP,
        stops::SILENCE,
        stops::DISARM,
        stops::SWITCH,
        stops::RESET,
        stops::UNPLUG,
        stops::EMERGENCY,
    ]
}

/// The noise of the IMU with the wheels turning: a step of the doctor.
pub(crate) const IMU_NOISE: Step = imu_noise::STEP;
