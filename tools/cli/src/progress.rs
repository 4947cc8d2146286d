//! What a long command shows while it runs.

pub use singletrack_figures::output::progress_bar;
