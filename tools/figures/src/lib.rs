//! Figures and offline reports of recorded drives.

pub mod figure;
pub mod output;
pub mod plot;
pub mod template;
