//! The calibration: what only the floor shows.
//!
//! The car drives by itself, at first with 0.3 m/s, for as long as the operator holds the
//! dead-man switch. What a step measures is put into the configuration at once, and every step
//! can be repeated alone. The speed that the car may drive is raised only after it has stopped
//! well from the one below.

mod bends;
mod cover;
mod floor;
mod roll_out;
mod speed;
pub(crate) mod steering_table;
mod straight;

use singletrack_core::Config;

use crate::Step;

/// The steps, in their order.
pub const STEPS: [Step; 5] = [
    straight::STEP,
    bends::STEP,
    speed::STEP,
    roll_out::STEP,
    cover::STEP,
];

/// Why the geofence has no room for the drives, with the size that they need; `None` if it has.
#[must_use]
pub fn lacks_room(config: &Config) -> Option<String> {
    floor::lacks_room(config)
}
