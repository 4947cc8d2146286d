//! The serial session with the board, without I/O.
//!
//! [`Session`] greets and configures the board, keeps watch over the line,
//! reads the board's clock in host time, and makes the frames that drive the
//! car. It opens no port, reads no clock and allocates nothing: the owner hands
//! it bytes and the time, and writes the bytes that it hands back.
//!
//! # Safety
//!
//! - The session never arms by itself. A request to arm is sent only after
//!   [`Session::arm`], and never outlives a loss, a restart of the board or a
//!   new configuration.
//! - It queues nothing: there is at most one request of each kind, and a drive
//!   command is made when it is sent, with the ages of that moment.
//! - A stop is repeated until telemetry shows its effect.
//! - What cannot be sent (not finite, beyond the wire's range) is an error, not
//!   a clamped value.
//!
//! # Example
//!
//! One turn of the owner's loop; `port` is a serial port, `now_ns` its clock:
//!
//! ```
//! # use singletrack_link::{Event, Session};
//! # fn turn(session: &mut Session, now_ns: u64, received: &[u8], mut write: impl FnMut(&[u8])) {
//! let mut on_event = |event| match event {
//!     Event::Telemetry(record) => { /* to the control thread */ }
//!     event => { /* to the log */ }
//! };
//! session.handle_bytes(now_ns, received, &mut on_event);
//! session.handle_timeout(now_ns, &mut on_event);
//! while let Some(transmit) = session.poll_transmit(now_ns) {
//!     write(transmit.as_bytes());
//! }
//! let wake_at_ns = session.poll_timeout();
//! # }
//! ```

#![no_std]

mod clock;
mod counters;
mod drive;
mod event;
mod handshake;
mod latency;
mod receive;
mod request;
mod session;
mod transmit;

pub use clock::{BoardClock, Observation, Stamp, WINDOW_NS};
pub use counters::{Counters, LineQuality};
pub use drive::{DriveCommand, DriveError, NotReady, Quantity};
pub use event::{Event, LossCause, RestartEvidence, Side, State, TimedTelemetry, VersionMismatch};
pub use handshake::{HELLO_INTERVAL_NS, SLOW_RETRY_NS};
pub use latency::RoundTrip;
pub use request::{ATTEMPTS, RETRY_INTERVAL_NS};
pub use session::{ConfigureError, Session, SessionConfig};
pub use transmit::Transmit;

/// The board is lost when no good frame has come from it for this long, in
/// nanoseconds.
pub const LINK_TIMEOUT_NS: u64 = 200_000_000;
