//! Decides at every tick whether the car drives, and with which command.
//!
//! | module | holds |
//! |---|---|
//! | `event` | the inputs of a tick |
//! | `watch` | monitors of sensors and timing |
//! | `fence` | the geofence |
//! | `supervisor` | the modes, and the checks that refuse or end a drive |
//! | `learned` | corrections that are learned while the car drives |
//! | `tuning` | gains and p of a pilot that runs: values, bounds |
//! | `pilot` | the [`Pilot`]: all of these with the estimator, the outer loop and the law of [`singletrack_control`] |
//!
//! The crate reads no clock, allocates nothing, and calls no mathematics of the
//! platform: the same configuration and the same events at the same ticks give the
//! same outputs, bit for bit, in every build and on every machine.

#![no_std]

#[cfg(test)]
extern crate std;

/// The number of the controller's arithmetic. It changes with whatever changes a bit of an output, and a
/// record names the one that made it: only the same one repeats it. Records before it was counted are
/// of controller 1.
pub const CONTROLLER: u32 = 16;

mod event;
mod fence;
mod learned;
mod pilot;
mod supervisor;
mod tuning;
mod watch;

pub use event::{
    Arming, AttitudeSample, BoardHealth, BoardSample, BoardState, Event, Jog, LineHealth,
    LinkState, PilotRequest, PoseMissing, RealTimeState, Tilt,
};
pub use fence::{Fence, FenceError, MAX_FENCE_CORNERS};
pub use learned::Learned;
pub use pilot::{
    Commanded, Compensation, DriveCommand, Filtering, Imu, Observed, Output, Pilot, PilotConfig,
    SetpointRefusal, Underway,
};
pub use supervisor::{
    BoardRequest, Conditions, JOG_TIMEOUT, Mode, REST, Reason, Supervisor, SupervisorConfig,
};
pub use tuning::{POINT_DISTANCE_RATE, Tuned, Tuning, TuningBounds};
pub use watch::{FIRST_METRE, FirstMetre, ImuVerdict, WatchConfig};
