//! The standard messages that follow from entries.

mod diagnostics;
mod header;
mod messages;

pub(crate) use diagnostics::Diagnostics;
pub(crate) use messages::derive;

#[cfg(test)]
mod tests;
