//! How far a command is, on standard error.

use indicatif::{ProgressBar, ProgressStyle};

/// A bar of this length that shows what `template` says. It is hidden when standard error is no
/// terminal.
pub fn progress_bar(length: u64, template: &str) -> ProgressBar {
    let bar = ProgressBar::new(length);
    match ProgressStyle::with_template(template) {
        Ok(style) => bar.with_style(style),
        Err(_) => bar,
    }
}
