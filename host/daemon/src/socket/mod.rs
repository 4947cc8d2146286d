//! The control socket: one JSON object per line, in both directions. Version 2.
//!
//! | to the daemon | from the daemon |
//! |---|---|
//! | `{"version":2,"command":"status"}` | `{"version":2,"ok":true,"status":{...}}` |
//! | `{"version":2,"command":"arm","attendance":"hold"}` | when the car drives, or why it does not; then how the drive goes on, and how it ended |
//! | `{"version":2,"command":"hold"}` | nothing: it renews the drive that the connection holds |
//! | `{"version":2,"command":"arm","attendance":"hold","jog":true}` | when the board takes pulses, or why it does not; then as for a drive |
//! | `{"version":2,"command":"jog","servo_us":1500,"esc_us":1500}` | nothing: pulses, which renew the jog that the connection holds |
//! | `{"version":2,"command":"disarm"}` | at once; the car slows down and stops. After an emergency stop the board stays stopped until it is reset: the answer has a `note` that says so |
//! | `{"version":2,"command":"stop"}` | at once; neutral until the board is reset |
//! | `{"version":2,"command":"set-reference","reference":{"kind":"circle",...}}` | when it is in force, as `{"version":2,"ok":true,"configuration":2}`, with `warnings` if there are any, or why it is not |
//! | `{"version":2,"command":"reload"}` | when the file of the configuration is in force again, as for `set-reference`, or why it is not |
//! | `{"version":2,"command":"commissioned","procedure":"doctor","result":"passed"}` | when the state of the procedure is kept |
//! | `{"version":2,"command":"setpoint","velocity_m_s":[0.4,0.0]}` | nothing, unless the set-point is rejected |
//! | `{"version":2,"command":"tune","gain_per_s":2.0,"point_distance_m":0.4}` | when the pilot has taken the values, as `{"version":2,"ok":true,"tuning":{...}}`, or why it has not |
//! | `{"version":2,"command":"watch","topics":["tick"]}` | `{"version":2,"ok":true}`, then every entry of the record as it is made, with a `topic` |
//! | `{"version":2,"command":"watch","topics":["state"]}` | `{"version":2,"ok":true}`, then the state of every tick |
//!
//! With `socket.tcp_port` the same is served on that port of 127.0.0.1 too. There the first line
//! is `{"version":2,"command":"token","token":"..."}`, answered with `{"version":2,"ok":true}`;
//! the token is in the file `<socket.path>.token`, new at every start. A connection that begins
//! with anything else is answered once, and closed.
//!
//! A failure is answered with `{"version":2,"ok":false,"error":"..."}`. A watcher that is
//! too slow gets `{"version":2,"missed":N}`. Within version 2, commands and keys are added
//! and never changed or removed.
//!
//! **Attendance.** An `arm` says who attends the drive. With `"hold"` it is the client: it
//! sends `{"version":2,"command":"hold"}` every 100 ms on the same connection. The drive ends
//! after 0.5 s without one, and at once when the connection ends. The daemon reports
//! `{"version":2,"drive":{...}}` every 0.2 s, and at last `{"version":2,"ended":{...}}`. With
//! `"timed"` and `"for_s":60` the drive ends by itself after that time; with `"unattended"` it
//! does not. Without an attendance, `arm` is refused. So it is if the car can't drive its
//! reference from where it stands.
//!
//! **References.** `reference` has the keys of `[reference]` in the configuration; `file`
//! is an absolute path in `socket.reference_folder`. A reference is refused while the car
//! drives. It is in force until the configuration is reloaded.
//!
//! **Tuning.** `tune` changes the gains of the position loop, p, or both, also while the car
//! drives, within the bounds of `[tuning]`. A connection that holds a drive may tune.
//!
//! **Set-points** are followed while `reference.kind` is `"external"`. A client sends many
//! per second on one connection. A set-point is a velocity of P, in m/s in the cameras' frame,
//! with a position or without; or `steering_rad` or `steering_rate_rad_s` with `speed_m_s` or
//! `acceleration_m_s2`; or a `trajectory`, points with a time. Its age
//! counts from when the daemon read it, or from `"time_ns"` of `CLOCK_MONOTONIC` if given:
//! a set-point that was delayed on its way is then old when it arrives. Only the newest one
//! counts. When it is older than `reference.setpoint_timeout_ms`, the car stops. A rejected
//! one is answered with a word, `"rejected":"old"`, and counted. A client
//! that sends invalid set-points without reading the answers is not read any more once the
//! answers fill its connection.

mod arm;
mod attend;
mod bind;
mod command;
mod drives;
mod progress;
mod serve;
mod setpoint;
mod stream;
mod tcp;
#[cfg(test)]
mod tests;
mod thread;
mod token;
mod tune;
mod waiting;

pub(crate) use bind::BoundSocket;
pub use bind::SocketError;
pub use command::{Arm, Attendance, Command, ParseError, Question, SOCKET_VERSION};
pub(crate) use drives::Drives;
pub use setpoint::{Rejection, SetpointCommand, SetpointFigures};
pub(crate) use setpoint::{SetpointCounters, SetpointSource};
pub(crate) use thread::SocketThread;
#[cfg(feature = "page")]
pub(crate) use {
    stream::linger,
    token::{Token, TokenFile},
};
