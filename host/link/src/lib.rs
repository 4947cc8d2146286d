//! The serial session with the board, without I/O.
//!
//! [`Session`] greets and configures the board, watches the line, maps the board's
//! clock to host time, and makes the frames that drive the car. It opens no port,
//! reads no clock and allocates nothing.
//!
//! # Safety
//!
//! - The session never arms by itself. A request to arm is sent only after
//!   [`Session::arm`], and never outlives a loss, a restart of the board or a
//!   new configuration.
//! - There is no queue of requests: at most one of each kind is pending, and a drive
//!   command is made when it is sent, with the ages of that moment.
//! - A stop is repeated until telemetry shows its effect.
//! - A value that can't be sent (not finite, beyond the wire's range) is an error. It
//!   is not clamped.
//!
//! # Order of the calls
//!
//! The session is sans-IO: its owner has the serial port and the clock. At every
//! wake-up the owner calls, in this order, with the time `now`:
//!
//! 1. `handle_*(now, ...)` for every input that has arrived, oldest first;
//! 2. `handle_timeout(now)`, which acts on what did not arrive;
//! 3. `poll_transmit(now)` until it returns `None`, and sends each result;
//! 4. `poll_timeout()`, the time of the next wake-up if no input arrives before.
//!
//! The order matters: without step 1 first, an owner that is late takes its own
//! delay for silence of the other side. Nothing happens before the time of step 4.
//! The handlers pass what happened to the callback `on_event`, in order and before
//! they return. Nothing waits in a queue, so no burst of input can lose an event.
//!
//! Requests ([`Session::arm`], [`Session::disarm`], [`Session::emergency_stop`],
//! [`Session::configure`], [`Session::drive`]) belong between steps 2 and 3. Getters
//! may be called at any time.
//!
//! # Example
//!
//! One wake-up of the owner; `received` and `write` are the serial port's:
//!
//! ```
//! # use singletrack_link::{Event, Session};
//! # fn wake_up(session: &mut Session, now_ns: u64, received: &[u8], mut write: impl FnMut(&[u8])) {
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
mod drive;
mod event;
mod handshake;
mod receive;
mod session;

pub use clock::{BoardClock, Stamp, StampOutcome, WINDOW_NS};
pub use drive::{DriveCommand, DriveError, JogCommand, NotReady, Quantity, RoundTrip};
pub use event::{
    Counters, Event, LineQuality, LossCause, RestartEvidence, Side, State, TimedTelemetry,
    VersionMismatch,
};
pub use handshake::{ATTEMPTS, HELLO_INTERVAL_NS, RETRY_INTERVAL_NS, SLOW_RETRY_NS};
pub use session::{ConfigureError, LINK_TIMEOUT_NS, Session, SessionConfig, Transmit};
