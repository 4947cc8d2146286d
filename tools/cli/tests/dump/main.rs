//! What `singletrack dump` prints, case by case, against committed text in
//! `tests/dump_cases/`; and what it says when it can't.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test may fail")]

mod filters;
mod fixture;
mod line;
mod live;
mod record;
mod stats;
