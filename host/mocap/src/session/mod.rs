//! The session of one client with one server.
//!
//! The files build on each other in this order: what a session reports
//! ([`event`], [`frame`]), when messages are due ([`schedule`]), what a session
//! knows ([`state`]), how it reaches a server ([`handshake`]), what it makes of
//! datagrams ([`receive`]), and what it sends ([`transmit`]).

mod event;
mod frame;
mod handshake;
mod receive;
mod schedule;
mod state;
mod transmit;

pub use event::{Connected, Phase, RestartReason, SessionEvent};
pub use frame::{DatagramOutcome, PoseFrame};
pub use state::Session;
pub(crate) use transmit::MAX_LEN;
pub use transmit::Transmit;
