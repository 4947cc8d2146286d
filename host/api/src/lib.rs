//! The contract of the daemon's control socket: what a client sends and what it is answered, and
//! connections that speak it.
//!
//! A connection blocks and starts no thread. The protocol is on the page `docs/control-socket.md`.

#[cfg(feature = "server")]
pub mod access;
mod clock;
mod connection;
mod error;
mod explain;
mod fleet;
mod held;
mod messages;
mod reply;
mod request;
mod state;
mod status;

pub use clock::ClockOffset;
pub use connection::{Connection, ask, ask_for_line, ask_within, connect};
pub use error::ClientError;
pub use explain::explain;
pub use fleet::{Fleet, FleetArm, FleetCar, FleetDrive, FleetEnd, FleetFileError, NotObeyed};
pub use held::{HeldDrive, RENEWAL};
pub use messages::{Clocks, Message, MessageStream, Received};
pub use reply::{Answer, Code, Drive, Ended, Refused, Reply, Tuning, TuningBounds, Word};
pub use request::{
    Arm, Attendance, EXAMPLES, Gain, Request, RequestError, Setpoint, TrajectoryPoint, Tune,
};
pub use state::{SetpointInForce, State};
pub use status::{
    Board, Calibration, Cameras, Change, Configuration, Correction, Learned, Status, Tunable,
    record_trouble,
};

/// The version of the protocol. Client and daemon must have the same one.
pub const SOCKET_VERSION: u32 = 3;
