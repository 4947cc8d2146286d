//! The shipped `singletrackd` against a board, in real time.
//!
//! The harness builds the daemon, starts it as a separate process, uses its control
//! socket, and observes the outputs of the board. The suite in `hil/` contains the
//! requirements.
//!
//! # Against the simulator
//!
//! ```text
//! cargo test -p singletrack-hil --test hil
//! cargo test -p singletrack-hil --test hil -- kill          only tests with "kill" in their name
//! cargo test -p singletrack-hil --test hil -- --list
//! ```
//!
//! Board and car are simulated in this process, behind a pseudo-terminal, and the
//! cameras behind UDP on the loopback interface. Four tests run in parallel,
//! because each mostly waits; tests that load the machine run alone. A test that
//! fails while its rig (simulator or pseudo-terminal) was late, or the processors
//! were busy, is repeated alone, because it has no valid result. If none of four
//! runs has one, the suite names the test and ends with status 75.
//!
//! # Against a physical UNO
//!
//! ```text
//! cargo test -p singletrack-hil --test hil -- --port /dev/ttyACM0
//! ```
//!
//! **The servo steers and the motor turns, up to the speed of the circle (0.4 m/s):
//! put the car on a stand, wheels off the ground, and keep the battery's plug at
//! hand.** The motor must be connected, because the board stops if the motor gives
//! no pulses.
//!
//! The harness then sits between daemon and UNO: a pseudo-terminal for the daemon,
//! the real port behind it, with the same faults in between. The servo and ESC
//! pulses reported by the board move a simulated car, which the simulated cameras
//! track. The car on the stand does not move, so its inertial measurements are
//! replaced by the simulated car's. Tests that need what a stand does not have (a
//! motor sensor that can be cut, a reset line, a stop switch that the harness
//! opens) are reported as ignored, with the reason.
//!
//! # Testing an existing binary
//!
//! `--daemon PATH` tests an existing binary, such as one from the package, instead
//! of building one.

#![allow(
    clippy::disallowed_methods,
    reason = "drives in real time repeat no bits"
)]

pub mod bench;
pub mod client;
pub mod controller;
pub mod daemon;
mod measured;
pub mod newcomer;
pub mod rig;
pub mod settings;
mod trace;
pub mod viewer;
pub mod wait;

pub use measured::{Failure, Load, Measurements, Outcome, Shares, percentile};
pub use trace::{Pulses, Trace};
