//! Every interleaving of board, link session and supervisor.
//!
//! The machines that decide whether a car drives are values without a clock. Here they run over
//! their real code, with everything that can happen between them: frames lost, late and twice,
//! either side restarted, poses lost and found, and whatever an operator asks, in any order.

mod action;
mod canonical;
mod claim;
mod explore;
mod host;
mod world;

pub use action::{Action, Event, Passage, Theme, Trace};
pub use claim::{Planted, Violation};
pub use explore::{Counterexample, Explored, Explorer, Limits, Stopped};
pub use world::Setting;
