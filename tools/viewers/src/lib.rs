//! What shows a drive to people, beside the daemon: the page for a browser (`page`), and the live
//! view for Foxglove, Lichtblick and PlotJuggler (`live`).
//!
//! Each is a client of the daemon's control socket and a server of its own, which takes no
//! commands. It watches the daemon only while somebody watches it (the page for 5 s more), and
//! connects again when the daemon restarts. The page is bounded in connections, memory and time; the
//! live view listens on loopback only. A viewer that hangs or is killed costs the daemon one place
//! among its watchers, and nothing else.

#![cfg_attr(
    test,
    allow(
        clippy::disallowed_methods,
        reason = "what a test expects is compared within a tolerance"
    )
)]

mod daemon;
#[cfg(feature = "live")]
pub mod live;
#[cfg(feature = "page")]
pub mod page;
