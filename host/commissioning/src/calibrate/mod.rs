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

use crate::Step;

/// The steps, in their order.
pub const STEPS: [Step; 5] = [
    Step {
        name: "straight",
        title: "A straight metre: signs, pulses, course",
        essential: true,
        run: straight::straight,
    },
    Step {
        name: "bends",
        title: "Bends to both sides: steering, and the body on the car",
        essential: true,
        run: bends::bends,
    },
    Step {
        name: "speed",
        title: "Changes of speed: ESC and motor",
        essential: false,
        run: speed::speed,
    },
    Step {
        name: "roll-out",
        title: "Roll-outs from rising speeds: brakes and top speed",
        essential: true,
        run: roll_out::roll_out,
    },
    Step {
        name: "cover",
        title: "Markers covered while it drives: the stop without poses",
        essential: false,
        run: cover::cover,
    },
];

/// The ids of all questions, in the order in which they come.
pub const QUESTIONS: [&str; 3] = ["place-on-floor", "cover-markers", "uncover-markers"];
