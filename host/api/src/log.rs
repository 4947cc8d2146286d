//! The log of a program that serves beside the daemon.

use std::io::{self, IsTerminal as _};

pub use tracing_subscriber::filter::LevelFilter;
use tracing_subscriber::{
    filter::Targets, layer::SubscriberExt as _, util::SubscriberInitExt as _,
};

/// Starts the log on standard error, without times. The variable `RUST_LOG` says what it has; by
/// default the notes of the crate `own`, and what is of the level `others` in all others. A terminal
/// shows colours, unless `NO_COLOR` is set.
pub fn start(own: &str, others: LevelFilter) {
    let wanted = std::env::var("RUST_LOG").ok();
    let filter = wanted.and_then(|wanted| wanted.parse::<Targets>().ok());
    let filter = filter.unwrap_or_else(|| {
        let targets = Targets::new().with_default(others);
        targets.with_target(own, LevelFilter::INFO)
    });
    let no_colour = std::env::var_os("NO_COLOR").is_some_and(|value| !value.is_empty());
    tracing_subscriber::fmt()
        .with_max_level(LevelFilter::TRACE)
        .with_writer(io::stderr)
        .with_ansi(io::stderr().is_terminal() && !no_colour)
        .without_time()
        .with_target(false)
        .finish()
        .with(filter)
        .init();
}
