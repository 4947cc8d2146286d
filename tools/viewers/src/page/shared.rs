//! What all connections of the page share.

use singletrack_access::Token;
use tokio::sync::Semaphore;

use super::{feed::Feed, setup::Setup};

/// What all connections share.
#[derive(Debug)]
pub(super) struct Shared {
    pub(super) feed: Feed,
    pub(super) setup: Setup,
    pub(super) token: Option<Token>,
    /// For viewers of the events.
    pub(super) places: Semaphore,
}
