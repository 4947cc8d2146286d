//! The daemon that drives the car, as a library: threads, sockets, serial port and
//! service around the host loop of [`singletrack_core`].
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

pub mod notify;
pub mod realtime;
pub mod reconfigure;
pub mod serial_port;
pub mod socket;

mod clock;
mod collector;
mod control_thread;
mod daemon;
mod live;
mod mocap_receiver;
mod mocap_socket;
mod recording;
mod serial_reader;
mod snapshot;
mod summary;
mod system;
mod wake;
mod wall_watch;

pub use clock::monotonic_ns;
pub use daemon::{Daemon, StartError, StartOptions, StopError};
pub use live::{LiveError, LiveStatus};
pub use mocap_socket::MocapSocketError;
pub use realtime::RealTimeStatus;
pub use recording::RecordingError;
pub use singletrack_statistics::Percentiles;
pub use snapshot::{Snapshot, TickView};
pub use socket::{Command, Question, SOCKET_VERSION, SocketError};
pub use summary::{Dropped, Figures, Frames, MocapFigures, Summary};
