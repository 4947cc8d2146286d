//! The doctor: what can be found about a car without moving it.
//!
//! The car stays disarmed. Where something must move, a hand moves it: the operator presses,
//! plugs, tilts, turns and rolls, and board and cameras are compared. What is measured is put
//! into the configuration at once, because the next steps need it.

mod questions;

/// The ids of all questions, in the order in which they come.
pub const QUESTIONS: [&str; 16] = [
    "press-reset",
    "voltmeter",
    "unplug-battery",
    "plug-battery",
    "open-stop-switch",
    "close-stop-switch",
    "push-wheels",
    "stand-still",
    "nose-up",
    "left-side-up",
    "turn-left",
    "push-forward",
    "twist",
    "turn-left-about-rear-axle",
    "turn-right-about-rear-axle",
    "roll-forward",
];
