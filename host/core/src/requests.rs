//! Requests to the control thread.

use std::sync::{Arc, Mutex, PoisonError};

use rtrb::Producer;
use singletrack_control::SteeringMap;
use singletrack_pilot::{PilotConfig, PilotRequest, Tuning};
use singletrack_protocol::Configuration;

use crate::controller::ReconfigureError;

/// A request to the control thread.
#[derive(Clone, Debug, PartialEq)]
pub enum ControlRequest {
    /// Pass a request to the pilot.
    Pilot(PilotRequest),
    /// Tune the pilot. The sender has checked the values:
    /// [`TuningRule::check`](crate::config::TuningRule::check).
    Tune(Tuning),
    /// Replace the configuration if the car does not drive, and return the box with the
    /// outcome.
    Reconfigure(Box<Reconfiguration>),
    /// Stop the car, disarm and end.
    Finish,
    /// Disarm at once and end.
    Abort,
}

/// A configuration that the control loop takes over between two ticks.
#[derive(Clone, Debug, PartialEq)]
pub struct Reconfiguration {
    /// Its number; the configuration at the start has 1.
    pub number: u32,
    /// For the pilot.
    pub pilot: PilotConfig,
    /// For the board.
    pub board: Configuration,
    /// For the angles that the board is commanded.
    pub steering: SteeringMap,
    /// Its hash: [`configuration_hash`](crate::configuration_hash).
    pub hash: u64,
    /// The caller's time-out: after this the configuration is refused, ns.
    pub until_ns: u64,
    /// The outcome; `None` until the control loop has handled it.
    pub outcome: Option<Result<(), Refusal>>,
}

/// Why the control loop refused a configuration.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum Refusal {
    /// The pilot or the session with the board refuses it.
    #[error(transparent)]
    Pilot(#[from] ReconfigureError),
    /// The loop is about to end.
    #[error("singletrackd is about to end")]
    Ending,
    /// The caller's time-out had passed.
    #[error("the control thread was stalled")]
    Late,
}

/// The ring of requests is full: the control thread is stalled or has ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("the control thread takes no requests: it has ended or is stalled")]
pub struct Stalled;

/// The sending end of the ring of requests, for every thread but the control thread.
#[derive(Clone, Debug)]
pub struct Requests(Arc<Mutex<Producer<ControlRequest>>>);

/// Slots of the ring for stops only: other requests can't keep them out.
const RESERVED: usize = 4;

impl Requests {
    /// Wraps the sending end of the ring that the control loop reads.
    #[must_use]
    pub fn new(ring: Producer<ControlRequest>) -> Self {
        Self(Arc::new(Mutex::new(ring)))
    }

    /// Pushes a request. Senders may wait for each other; the control thread never waits.
    ///
    /// # Errors
    ///
    /// [`Stalled`] if the ring is full; for requests other than a stop, if only the reserved
    /// slots are left.
    pub fn push(&self, request: ControlRequest) -> Result<(), Stalled> {
        // The ring is consistent even if a sender has panicked.
        let mut ring = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let stops = match request {
            ControlRequest::Pilot(
                PilotRequest::Arm
                | PilotRequest::ArmHeld
                | PilotRequest::ArmJog
                | PilotRequest::Hold
                | PilotRequest::Disarm
                | PilotRequest::Carried,
            )
            | ControlRequest::Tune(_)
            | ControlRequest::Reconfigure(_) => false,
            ControlRequest::Pilot(
                PilotRequest::EmergencyStop
                | PilotRequest::OperatorGone
                | PilotRequest::TimeUp
                | PilotRequest::Halt,
            )
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
    fn other_requests_do_not_keep_out_a_stop() {
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
