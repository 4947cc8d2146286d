//! Every source of poses keeps the same promises, whatever its server speaks.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    clippy::indexing_slicing,
    reason = "the helpers of tests may fail as tests do"
)]

mod bench;
mod golden;
mod promises;
mod server;
