//! The bring-up of a car whose wheels are clear of the floor: everything that servo and ESC do
//! is found before the car is put down.
//!
//! The kill comes first, then the ESC at rest, the servo, the motor, and every way to stop.
//! All pulses are jogs: the board holds them within its own limits, and ends them when the
//! command line, the daemon or the line is gone. In every tick the cameras are asked whether
//! the car is still on its stand; one that moves is stopped by an emergency stop.
//!
//! A step that measures puts its result in force: a bring-up that was interrupted goes on
//! after the last step that came to its end. The last steps of one run rest on the values of
//! the first.

mod car;
mod esc_kind;
mod kill;
mod motor;
mod neutral;
mod questions;
mod stand;
mod steering;
mod stops;

use crate::{Bench, Finding, Interrupted, Step};

/// The steps, with the ESC watched at neutral for a minute in each order, which finds what
/// only sometimes turns.
pub const STEPS: &[Step] = &steps_with::<60>();

/// [`STEPS`].
#[must_use]
pub const fn steps() -> &'static [Step] {
    STEPS
}

/// The steps, with the ESC watched at neutral for so many seconds.
#[must_use]
pub const fn steps_with<const NEUTRAL_S: u32>() -> [Step; 16] {
    [
        step(stand::NAME, "The car on its stand", stand::run),
        step(kill::NAME, "The kill of the ESC's supply", kill::run),
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
        // Nothing is worth trying on a car on which this failed.
        essential: true,
        run,
    }
}
