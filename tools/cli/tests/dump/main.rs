//! What `singletrack dump` prints, case by case, against committed text in
//! `tests/dump_cases/`; and what it says when it can't.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test may fail")]

mod filters;
mod fixture;
mod line;
mod live;
#[path = "../pty/mod.rs"]
#[allow(dead_code, reason = "status is tried with keys as well")]
mod pty;
mod record;
mod stats;
