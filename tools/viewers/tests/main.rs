//! The page and the live view beside a daemon without board and cameras.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    reason = "the helpers of tests may fail as tests do"
)]

#[path = "../../../host/daemon/tests/common/mod.rs"]
mod common;
mod live;
mod page;
