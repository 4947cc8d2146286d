//! The shipped `singletrackd` against a board, in real time.
//!
//! The harness builds the daemon, starts it as the process that it is on the
//! car, speaks to it over its control socket, and watches what comes out of the
//! board. The suite in `hil/` says what must happen.
//!
//! # Against the simulator
//!
//! ```text
//! cargo test -p singletrack-hil
//! cargo test -p singletrack-hil -- kill          only tests with "kill" in their name
//! cargo test -p singletrack-hil -- --list
//! ```
//!
//! Board and car are simulated in this process, behind a pseudo-terminal; the
//! cameras behind UDP on the loopback interface. Four tests run at a time, since
//! each waits for most of its time; those that load the machine run alone. A test
//! that fails while its rig (simulator or pseudo-terminal) was late is repeated,
//! because it has shown nothing: let nothing else compile meanwhile. The suite
//! prints how late the rigs were.
//!
//! # Against a physical UNO
//!
//! ```text
//! cargo test -p singletrack-hil -- --port /dev/ttyACM0
//! ```
//!
//! **The servo steers and the motor turns, up to the speed of the circle
//! (0.4 m/s): put the car on a stand, wheels off the ground, and keep the
//! battery's plug at hand.** The motor must be connected, because the board
//! stops a motor that gives no pulses.
//!
//! The harness then stands between daemon and UNO: a pseudo-terminal for the
//! daemon, the real port behind it, with the same faults in between. The servo
//! and ESC pulses that the board reports move a simulated car, which the
//! simulated cameras see; since the car on the stand does not turn, its
//! inertial measurements are replaced by the simulated car's. Tests of what a
//! stand does not have (a motor that can be silenced, a reset line, a stop
//! switch that the harness opens) are reported as ignored, with the reason.
//!
//! # Another daemon
//!
//! `--daemon PATH` tests a binary that is already there, such as one unpacked
//! from the package, instead of building one.

pub mod bench;
pub mod client;
pub mod daemon;
mod failure;
mod measured;
pub mod program;
pub mod rig;
pub mod settings;
mod trace;
pub mod wait;

pub use failure::{Failure, Outcome};
pub use measured::Measurements;
pub use trace::{Pulses, Trace};
