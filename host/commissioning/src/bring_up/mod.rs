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

use crate::Step;

/// The steps, with the ESC watched at neutral for a minute in each order, which finds what
/// only sometimes turns.
#[must_use]
pub fn steps() -> Vec<Step> {
    steps_with::<60>()
}

/// The steps, with the ESC watched at neutral for so many seconds.
#[must_use]
pub fn steps_with<const NEUTRAL_S: u32>() -> Vec<Step> {
    let step = |name, title, essential, run| Step {
        name,
        title,
        essential,
        run,
    };
    vec![
        step(stand::NAME, "The car on its stand", true, stand::run),
        step(kill::NAME, "The kill of the ESC's supply", true, kill::run),
        step(
            neutral::NAME,
            "The ESC at neutral",
            true,
            neutral::run::<NEUTRAL_S>,
        ),
        step(
            steering::DIRECTION,
            "Direction of the servo",
            true,
            steering::direction,
        ),
        step(
            steering::CENTRE,
            "Centre of the servo",
            true,
            steering::centre,
        ),
        step(
            steering::STOPS,
            "End stops of the servo",
            true,
            steering::stops,
        ),
        step(steering::GAIN, "Gain of the servo", true, steering::gain),
        step(
            motor::DIRECTION,
            "Direction of the motor",
            true,
            motor::direction,
        ),
        step(
            motor::MAP,
            "Deadband and speeds of the motor",
            true,
            motor::map,
        ),
        step(
            esc_kind::NAME,
            "What a pulse below neutral does",
            true,
            esc_kind::run,
        ),
        step(stops::SILENCE, "Stop: no more jogs", true, stops::silence),
        step(stops::DISARM, "Stop: disarm", true, stops::disarm),
        step(stops::SWITCH, "Stop: the stop switch", true, stops::switch),
        step(stops::RESET, "Stop: reset of the board", true, stops::reset),
        step(stops::UNPLUG, "Stop: the cable", true, stops::unplug),
        step(
            stops::EMERGENCY,
            "Stop: emergency stop",
            true,
            stops::emergency,
        ),
    ]
}
