//! What all connections of the page share.

use singletrack_access::Token;
use tokio::sync::{Semaphore, SemaphorePermit, TryAcquireError};

use super::{feed::Feed, setup::Setup};

/// What all connections share.
#[derive(Debug)]
pub(super) struct Shared {
    pub(super) feed: Feed,
    pub(super) setup: Setup,
    pub(super) token: Option<Token>,
    pub(super) places: Semaphore,
}

/// The place of a viewer of the events.
pub(super) type Viewer<'a> = SemaphorePermit<'a>;

impl Shared {
    /// A place for a viewer of the events, if one is free.
    pub(super) fn viewer(&self) -> Result<Viewer<'_>, TryAcquireError> {
        self.places.try_acquire()
    }
}
