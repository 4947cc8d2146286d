//! The way of requests to the control thread.

use std::sync::{Arc, Mutex, PoisonError};

use rtrb::Producer;

use crate::control_loop::ControlRequest;

/// The control thread has not taken what it was asked before: it is stalled, or
/// gone.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("the control thread takes no requests: it has ended or is stalled")]
pub struct Stalled;

/// Where anybody asks the control thread for something.
#[derive(Clone, Debug)]
pub(crate) struct Requests(Arc<Mutex<Producer<ControlRequest>>>);

impl Requests {
    pub(crate) fn new(ring: Producer<ControlRequest>) -> Self {
        Self(Arc::new(Mutex::new(ring)))
    }

    /// Those who ask wait for each other; the control thread waits for nobody.
    pub(crate) fn push(&self, request: ControlRequest) -> Result<(), Stalled> {
        self.0
            .lock()
            // The ring is whole at every moment.
            .unwrap_or_else(PoisonError::into_inner)
            .push(request)
            .map_err(|_| Stalled)
    }
}
