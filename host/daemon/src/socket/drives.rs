//! The order of the drives: which request to arm is the latest, and what may end it.

use std::sync::{
    Arc,
    atomic::{AtomicU64, Ordering},
};

use singletrack_api::{Code, Refused};
use singletrack_core::ControlRequest;
use singletrack_pilot::PilotRequest;
use tokio::sync::Mutex;

use crate::{
    clock::monotonic_ns,
    handle::{DaemonHandle, Snapshot},
};

/// Numbers the drives, so that a client or task of an earlier one does not end a later one, and
/// orders the requests to arm.
#[derive(Clone, Debug, Default)]
pub(crate) struct Drives(Arc<Orders>);

#[derive(Debug, Default)]
struct Orders {
    /// The number of the latest drive.
    number: AtomicU64,
    /// When it was asked for.
    asked_ns: AtomicU64,
    /// Counts the requests to disarm and to stop.
    stops: AtomicU64,
    /// Held while a request to arm is judged: one at a time.
    judging: Arc<Mutex<()>>,
}

/// The right to renew and to end one drive.
#[derive(Clone, Debug)]
pub(super) struct Ticket {
    drives: Drives,
    number: u64,
}

impl Drives {
    pub(super) fn next(&self) -> Ticket {
        self.0.asked_ns.store(monotonic_ns(), Ordering::Release);
        Ticket {
            drives: self.clone(),
            number: self.0.number.fetch_add(1, Ordering::AcqRel) + 1,
        }
    }

    /// A client asks for a disarm or a stop: a request to arm that is being judged is void.
    pub(super) fn stop(&self) {
        self.0.stops.fetch_add(1, Ordering::AcqRel);
    }

    pub(super) fn stops(&self) -> u64 {
        self.0.stops.load(Ordering::Acquire)
    }

    /// The lock of a request to arm that is being judged.
    pub(super) fn judging(&self) -> Arc<Mutex<()>> {
        Arc::clone(&self.0.judging)
    }

    /// Whether the last request to arm may not have reached the pilot at this tick.
    pub(super) fn is_open(&self, snapshot: &Snapshot) -> bool {
        let asked_ns = self.0.asked_ns.load(Ordering::Acquire);
        let tick = snapshot.latest.tick.as_ref();
        tick.is_none_or(|tick| tick.start_ns <= asked_ns)
    }
}

impl Ticket {
    pub(super) fn is_latest(&self) -> bool {
        self.drives.0.number.load(Ordering::Acquire) == self.number
    }

    /// Passes a request on if the drive is still the latest one.
    pub(super) fn push(&self, daemon: &DaemonHandle, request: PilotRequest) -> Result<(), Refused> {
        self.pass(daemon, ControlRequest::Pilot(request))
    }

    /// Passes any request on if the drive is still the latest one.
    pub(super) fn pass(
        &self,
        daemon: &DaemonHandle,
        request: ControlRequest,
    ) -> Result<(), Refused> {
        if !self.is_latest() {
            return Ok(());
        }
        let pushed = daemon.requests.push(request);
        pushed.map_err(|error| Refused::new(Code::Stalled, error))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_ticket_of_an_earlier_drive_is_void() {
        let drives = Drives::default();
        let (first, second) = (drives.next(), drives.next());
        assert!(!first.is_latest() && second.is_latest());
    }
}
