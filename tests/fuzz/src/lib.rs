//! Invariants for hostile input.
//!
//! One function for each input of the two computers. It derives a test from
//! arbitrary bytes and panics when an invariant is violated; each function
//! documents its invariants. `README.md` describes how to run them with libFuzzer;
//! `tests/` runs them on the corpus and on random bytes with every `cargo test`.
//!
//! Common invariants: no panic, no overflow, and no loop or memory that is not
//! bounded by the length of the input.

#![allow(
    clippy::panic,
    clippy::unwrap_used,
    clippy::expect_used,
    reason = "a target panics when an invariant is violated"
)]

mod board_bytes;
mod choices;
mod configuration;
mod control_line;
mod host_bytes;
mod natnet_packets;
pub mod seeds;
mod stream_messages;

pub use board_bytes::board_bytes;
pub use configuration::configuration;
pub use control_line::{control_line, page_head};
pub use host_bytes::host_bytes;
pub use natnet_packets::natnet_packets;
pub use stream_messages::stream_messages;

/// A fuzz target.
#[derive(Clone, Copy, Debug)]
pub struct Target {
    /// Name of its program and of its folder in the corpus.
    pub name: &'static str,
    /// Runs the checks on some bytes; returns the amount of input that was processed.
    pub run: fn(&[u8]) -> u64,
}

/// All targets.
pub const TARGETS: [Target; 7] = [
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
    Target {
        name: "page_head",
        run: page_head,
    },
    Target {
        name: "stream_messages",
        run: stream_messages,
    },
];
