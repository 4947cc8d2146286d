//! The server's thread of a program without the feature `live`: it never starts.

use singletrack_core::config::LiveSection;
use singletrack_record::{ClockMapping, FeedInput};

use super::status::{LiveError, LiveView};

#[derive(Debug)]
pub(crate) struct LiveThread {
    pub(crate) view: LiveView,
}

impl LiveThread {
    pub(crate) fn start(_: LiveSection, _: ClockMapping) -> Result<(Self, FeedInput), LiveError> {
        Err(LiveError::NotBuilt)
    }
}
