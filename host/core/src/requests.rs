//! The way of requests to the control thread.

use std::sync::{Arc, Mutex, PoisonError};

use rtrb::Producer;
use singletrack_pilot::PilotRequest;

use crate::control_loop::ControlRequest;

/// The control thread has not taken what it was asked before: it is stalled, or
/// gone.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("the control thread takes no requests: it has ended or is stalled")]
pub struct Stalled;

/// Where anybody asks the control thread for something.
#[derive(Clone, Debug)]
pub struct Requests(Arc<Mutex<Producer<ControlRequest>>>);

/// Room that only a stop may use: however often somebody asks for something
/// else, it gets through.
const RESERVED: usize = 4;

impl Requests {
    /// The sending end of the ring that the control loop takes requests from.
    #[must_use]
    pub fn new(ring: Producer<ControlRequest>) -> Self {
        Self(Arc::new(Mutex::new(ring)))
    }

    /// Those who ask wait for each other; the control thread waits for nobody.
    pub fn push(&self, request: ControlRequest) -> Result<(), Stalled> {
        // The ring is whole at every moment.
        let mut ring = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let stops = match request {
            ControlRequest::Pilot(PilotRequest::Arm | PilotRequest::Disarm)
            | ControlRequest::Reconfigure(_) => false,
            ControlRequest::Pilot(PilotRequest::EmergencyStop)
            | ControlRequest::Finish
            | ControlRequest::Abort => true,
        };
        if !stops && ring.slots() <= RESERVED {
            return Err(Stalled);
        }
        ring.push(request).map_err(|_| Stalled)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_stop_gets_through_however_often_something_else_is_asked() {
        let (ring, mut taken) = rtrb::RingBuffer::new(12);
        let requests = Requests::new(ring);
        let disarm = ControlRequest::Pilot(PilotRequest::Disarm);
        assert!((0..100).any(|_| requests.push(disarm.clone()).is_err()));
        let stop = ControlRequest::Pilot(PilotRequest::EmergencyStop);
        assert_eq!(requests.push(stop.clone()), Ok(()));
        assert_eq!(requests.push(ControlRequest::Finish), Ok(()));
        let mut last = Vec::new();
        while let Ok(request) = taken.pop() {
            last.push(request);
        }
        assert!(last.ends_with(&[stop, ControlRequest::Finish]));
    }
}
