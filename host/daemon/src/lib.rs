//! The daemon that drives the car, as a library: its threads, and the
//! controller that they and the simulations share.
//!
//! ```text
//! serial reader ---ring--\                     /--ring--> collector --> log, figures, watchers
//! motion capture --ring----> control thread --<                   \--> recorder, live view
//! socket, owner ---ring--/     |               \--> the port's write half
//! set-points ------slot--/
//! ```
//!
//! The control thread waits for nothing but its deadline: what comes to it and
//! from it goes through bounded rings; what finds no room is dropped and counted.

pub mod config;
pub mod control_loop;
pub mod controller;
pub mod notify;
pub mod realtime;
pub mod reconfigure;
pub mod serial_port;
pub mod serial_reader;
pub mod setpoint_slot;
pub mod socket;

mod alignment;
mod clock;
mod collector;
mod control_thread;
mod daemon;
mod histogram;
mod live;
mod mocap_receiver;
mod mocap_socket;
mod recording;
mod report;
mod requests;
mod restart_keys;
mod snapshot;
mod summary;
mod system;
mod wake;
mod wall_watch;

pub use clock::monotonic_ns;
pub use config::{Config, ConfigError};
pub use daemon::{Daemon, StartError, StartOptions, StopError};
pub use histogram::Percentiles;
pub use live::{LiveError, LiveStatus};
pub use mocap_socket::MocapSocketError;
pub use realtime::RealTimeStatus;
pub use recording::{RecordingError, record_meta};
pub use report::{LineCounters, Report, link_entry, link_phase};
pub use requests::Stalled;
pub use snapshot::{Snapshot, TickView};
pub use socket::{Command, Question, SOCKET_VERSION, SocketError};
pub use summary::{Dropped, Figures, Frames, MocapFigures, Summary};
