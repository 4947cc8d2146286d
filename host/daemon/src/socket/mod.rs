//! The control socket: one JSON object per line, in both directions. Version 1.
//!
//! | to the daemon | from the daemon |
//! |---|---|
//! | `{"version":1,"command":"status"}` | `{"version":1,"ok":true,"status":{...}}` |
//! | `{"version":1,"command":"arm"}` | when the car drives, or why it does not |
//! | `{"version":1,"command":"disarm"}` | at once; the car slows down and stops. After an emergency stop the board stays stopped until it is reset: the answer has a `note` that says so |
//! | `{"version":1,"command":"stop"}` | at once; neutral until the board is reset |
//! | `{"version":1,"command":"set-reference","reference":{"kind":"circle",...}}` | when it is in force, as `{"version":1,"ok":true,"configuration":2}`, or why it is not |
//! | `{"version":1,"command":"setpoint","velocity_m_s":[0.4,0.0]}` | nothing, unless the set-point is invalid or not in use |
//! | `{"version":1,"command":"watch","topics":["tick"]}` | `{"version":1,"ok":true}`, then every entry of the record as it is made, with a `topic` |
//!
//! A failure is answered with `{"version":1,"ok":false,"error":"..."}`. A watcher that is
//! too slow gets `{"version":1,"missed":N}`. Within version 1, commands and keys are added
//! and never changed or removed.
//!
//! **References.** `reference` has the keys of `[reference]` in the configuration; `file`
//! is an absolute path that the daemon may read. A reference is refused while the car
//! drives. It is in force until the configuration is reloaded.
//!
//! **Set-points** are followed while `reference.kind` is `"external"`. A client sends many
//! per second on one connection. A set-point has the wanted velocity of P, in m/s in the
//! cameras' frame, and may have a wanted position, in m: `"position_m":[0.5,0.0]`. Its age
//! counts from when the daemon read it, or from `"time_ns"` of `CLOCK_MONOTONIC` if given:
//! a set-point that was delayed on its way is then old when it arrives. Only the newest one
//! counts. When it is older than `reference.setpoint_timeout_ms`, the car stops. A client
//! that sends invalid set-points without reading the answers is not read any more once the
//! answers fill its connection.

mod bind;
mod command;
mod serve;
mod thread;

pub(crate) use bind::BoundSocket;
pub use bind::SocketError;
pub use command::{Command, Question, SOCKET_VERSION};
pub(crate) use thread::SocketThread;
