//! The bring-up of a car whose wheels are clear of the floor: it measures everything that servo
//! and ESC do before the car is put down.
//!
//! The kill switch comes first, then the ESC at rest, the servo, the motor, and every way to stop.
//! All pulses are jogs: the board holds them within its own limits, and ends them when the
//! command line, the daemon or the line is gone. While pulses are given, the cameras watch the
//! car in every tick, and an emergency stop ends the step if it leaves its stand.
//!
//! A step that measures puts its result in force, because later steps rely on it. An interrupted
//! bring-up continues after the last step that was completed.

mod car;
mod esc_kind;
mod kill;
mod motor;
mod neutral;
mod outcome;
mod place;
mod questions;
mod spin;
mod stand;
mod steering;
mod stops;

use crate::{Bench, Finding, Interrupted, Step};

/// The steps. The ESC is watched at neutral for a minute in each order, to find a motor that
/// turns only now and then.
pub const STEPS: &[Step] = &steps_with::<60>();

/// [`STEPS`].
#[must_use]
pub const fn steps() -> &'static [Step] {
    STEPS
}

/// The steps; the ESC is watched at neutral for `NEUTRAL_S` seconds in each order.
#[must_use]
pub const fn steps_with<const NEUTRAL_S: u32>() -> [Step; 16] {
    [
        step(stand::NAME, "The car on its stand", stand::run),
        step(kill::NAME, "The kill switch of the ESC's supply", kill::run),
        step(
            neutral::NAME,
            "The ESC at neutral",
            neutral::run::<NEUTRAL_S>,
        ),
        step(
            steering::DIRECTION,
            "Direction of the servo",
            steering::direction,
        ),
        step(steering::CENTRE, "Centre of the servo", steering::centre),
        step(steering::STOPS, "End stops of the servo", steering::stops),
        step(steering::GAIN, "Gain of the servo", steering::gain),
        step(motor::DIRECTION, "Direction of the motor", motor::direction),
        step(motor::MAP, "Deadband and speeds of the motor", motor::map),
        step(
            esc_kind::NAME,
            "What a pulse below neutral does",
            esc_kind::run,
        ),
        step(stops::SILENCE, "Stop: no more jogs", stops::silence),
        step(stops::DISARM, "Stop: disarm", stops::disarm),
        step(stops::SWITCH, "Stop: the stop switch", stops::switch),
        step(stops::RESET, "Stop: reset of the board", stops::reset),
        step(stops::UNPLUG, "Stop: the cable", stops::unplug),
        step(stops::EMERGENCY, "Stop: emergency stop", stops::emergency),
    ]
}

const fn step(
    name: &'static str,
    title: &'static str,
    run: fn(&mut dyn Bench) -> Result<Finding, Interrupted>,
) -> Step {
    Step {
        name,
        title,
        // Each step relies on the ones before it.
        essential: true,
        run,
    }
}
