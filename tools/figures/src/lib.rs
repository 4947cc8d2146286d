//! Figures and offline reports of recorded drives.

#![allow(clippy::disallowed_methods, reason = "figures")]

pub mod figure;
pub mod output;
pub mod plot;
