//! From the parts to the first drive: the checks and measurements of a new car, in their order.
//!
//! Three procedures follow each other: the *doctor*, which moves nothing; the *bring-up*, with
//! the wheels off the floor; the *calibration*, on the floor. Each is a list of [`Step`]s that
//! see a car and its operator through [`Bench`]. The command line implements it with the control
//! socket of the daemon and a terminal, the tests with a simulated car and scripted hands: a
//! procedure cannot tell which. Time passes only in [`Bench::wait`] and [`Bench::ask`].
//!
//! The result of a step is a [`Finding`], with the [`Parameter`]s that it measured. A [`Journal`]
//! keeps the findings, so that a procedure can be resumed.

#![allow(
    clippy::disallowed_methods,
    reason = "what is fitted here is rounded and written into a file, which the pilot then reads"
)]

mod bench;
pub mod bring_up;
pub mod calibrate;
pub mod doctor;
pub mod edit;
mod finding;
mod fit;
mod imu_noise;
mod observed;
mod procedure;
pub mod report;
pub mod seen;
pub mod sensors;

pub use bench::{
    Answer, Answers, Attendance, Bench, BoardReading, Inertial, Interrupted, Observation,
    PoseReading, Question, Refused, TickReading,
};
pub use finding::{Finding, Interval, Parameter, Plot, PlotKind, PlotLine, Trouble, Verdict};
pub use procedure::{Journal, Step, run};
pub use singletrack_pilot::Jog;
