//! Whether and when the car drives: the events of a tick, the supervisor with its
//! modes, the watches over sensors and timing, the geofence, and the [`Pilot`] that
//! joins them with the estimator, the outer loop and the law of
//! [`singletrack_control`].
//!
//! Nothing here reads a clock, allocates, or calls the platform's mathematics
//! library: the same configuration and the same events at the same ticks give the
//! same outputs, bit for bit, in every build and on every machine.

#![no_std]

#[cfg(test)]
extern crate std;

mod event;
mod fence;
mod pilot;
mod supervisor;
mod watch;
mod words;

pub use event::{
    BoardHealth, BoardSample, BoardState, Event, LineHealth, LinkState, PoseMissing, RealTimeState,
    Request,
};
pub use fence::{Fence, FenceError, MAX_FENCE_CORNERS};
pub use pilot::{DriveCommand, Output, Pilot, PilotConfig, Underway};
pub use supervisor::{BoardRequest, Conditions, Mode, Reason, Supervisor, SupervisorConfig};
pub use watch::{ImuVerdict, WatchConfig};
