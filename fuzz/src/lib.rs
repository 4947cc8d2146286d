//! Hostile input: what it must never do, whoever sends it.
//!
//! One function for each way into the two computers. It makes a test of any
//! bytes and panics when a promise is broken; what the promises are is said at
//! each. `README.md` says how to run them under libFuzzer; `tests/` runs them on
//! the corpus and on random bytes with every `cargo test`.
//!
//! Common to all: no panic, no overflow, no loop that the length of the input
//! does not bound, no memory that it does not.

#![allow(
    clippy::panic,
    clippy::unwrap_used,
    clippy::expect_used,
    reason = "a panic is how a target says that a promise is broken"
)]

mod board_bytes;
mod choices;
mod configuration;
mod control_line;
mod frame;
mod host_bytes;
mod natnet_packets;
mod samples;

pub mod seeds;

pub use board_bytes::board_bytes;
pub use configuration::configuration;
pub use control_line::control_line;
pub use host_bytes::host_bytes;
pub use natnet_packets::natnet_packets;

/// A fuzz target: its name, and what it does with some bytes.
#[derive(Clone, Copy, Debug)]
pub struct Target {
    /// The name of its program and of its folder in the corpus.
    pub name: &'static str,
    /// The checks; returns how much of what they are about was tried.
    pub run: fn(&[u8]) -> u64,
}

/// All targets.
pub const TARGETS: [Target; 5] = [
    Target {
        name: "board_bytes",
        run: board_bytes,
    },
    Target {
        name: "host_bytes",
        run: host_bytes,
    },
    Target {
        name: "natnet_packets",
        run: natnet_packets,
    },
    Target {
        name: "configuration",
        run: configuration,
    },
    Target {
        name: "control_line",
        run: control_line,
    },
];
