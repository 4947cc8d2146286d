//! The daemon that drives the car, as a library: the threads, the sockets, the serial port
//! and the service around the host loop of [`singletrack_core`].
//!
//! ```text
//! serial reader ---ring--\                     /--ring--> collector --> log, figures, watchers
//! motion capture --ring----> control thread --<                   \--> recorder
//! socket, owner ---ring--/     |               \--> the port's write half     \--> files
//! set-points ------slot--/
//! ```
//!
//! The control thread waits only for its deadline. Its inputs and outputs go through
//! bounded rings; what finds no room in a ring is dropped and counted.

#![cfg_attr(
    test,
    allow(
        clippy::disallowed_methods,
        reason = "what a test expects is compared within a tolerance"
    )
)]

pub mod notify;
pub mod program;
pub mod realtime;
pub mod reconfigure;
pub mod serial_port;
pub mod socket;

mod arguments;
mod clock;
mod collector;
mod commissioned_file;
mod control_thread;
mod daemon;
mod drive_findings;
mod files;
mod handle;
mod log;
mod messages;
mod mocap_receiver;
mod recording;
mod service;
mod shared_status;
mod state_file;
mod summary;
mod system;
mod threads;

pub use arguments::{Arguments, LogFormat};
pub use clock::monotonic_ns;
pub use commissioned_file::not_commissioned;
pub use daemon::{Daemon, StartOptions, StopError};
pub use handle::Snapshot;
pub use mocap_receiver::MocapSockets;
pub use realtime::RealTimeStatus;
pub use shared_status::Latest;
pub use socket::{Arm, Attendance, Command, ParseError, SetpointFigures};
pub use summary::{Dropped, Figures, Frames, MocapFigures, Percentiles, Summary};
