//! The contract of the daemon's control socket: what a client sends and what it is answered, and
//! connections that speak it.
//!
//! A connection blocks and starts no thread. The protocol is on the page `docs/control-socket.md`.
//! Where there are no Unix sockets, as in a browser, there are the messages without the connections.

#[cfg(feature = "server")]
pub mod access;
#[cfg(unix)]
mod connection;
mod error;
mod explain;
#[cfg(unix)]
mod fleet;
#[cfg(feature = "log")]
pub mod log;
#[cfg(unix)]
mod messages;
mod reply;
mod request;
mod status;
#[path = "../../control/src/words.rs"]
mod words;

#[cfg(unix)]
pub use connection::{
    ClockOffset, Connection, HeldDrive, RENEWAL, ask, ask_as, ask_within, connect,
};
pub use error::ClientError;
pub use explain::{explain, is_too_large};
#[cfg(unix)]
pub use fleet::{Fleet, FleetArm, FleetCar, FleetDrive, FleetEnd, FleetFileError, NotObeyed};
#[cfg(unix)]
pub use messages::{Message, MessageStream, Received};
pub use reply::{Answer, Clocks, Code, Drive, Ended, Refused, Reply, Tuning, TuningBounds, Word};
pub use request::{
    Arm, Attendance, EXAMPLES, Gain, Request, RequestError, Setpoint, TrajectoryPoint, Tune,
    has_null,
};
pub use status::{
    Board, Calibration, Cameras, Change, Configuration, Correction, Learned, SetpointInForce,
    State, Status, Tunable, record_trouble,
};

/// The version of the protocol. Client and daemon must have the same one.
pub const SOCKET_VERSION: u32 = 3;
