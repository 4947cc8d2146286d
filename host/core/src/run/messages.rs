//! What the control thread is asked, and what it reports for record, status and log.

use std::sync::{Arc, Mutex, PoisonError};

use rtrb::Producer;
use singletrack_control::SteeringMap;
use singletrack_link::{ConfigureError, Counters, Event as LinkEvent, State};
use singletrack_pilot::{Learned, PilotConfig, PilotRequest, Underway};
use singletrack_protocol::Configuration;
use singletrack_record::{Entry, LinkPhase, StatusRecord, TelemetryRecord};

use crate::run::proof::Proof;

/// A request to the control thread.
#[derive(Clone, Debug, PartialEq)]
pub enum ControlRequest {
    /// Pass a request to the pilot.
    Pilot(PilotRequest),
    /// Arm the car, and let its reference begin at this time, in ns.
    ArmAt(u64),
    /// Tell the pilot what is learned.
    Learned(Learned),
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
    /// A drive is underway.
    #[error(transparent)]
    Underway(#[from] Underway),
    /// The session does not accept the board's configuration.
    #[error("board: {0}")]
    Board(#[from] ConfigureError),
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
pub struct Requests(Arc<Mutex<Sender>>);

#[derive(Debug)]
struct Sender {
    ring: Producer<ControlRequest>,
    /// The slots of the ring.
    slots: usize,
    /// The stops since the last other request, a bit for each kind.
    stops: u8,
}

/// Slots of the ring for stops only, one for each kind: no number of requests keeps a stop out.
const RESERVED: usize = u8::BITS as usize;

/// A report of the control thread. Ticks have their own ring.
#[derive(Clone, Copy, Debug)]
pub enum Report {
    /// Telemetry of the board.
    Telemetry(TelemetryRecord),
    /// A status message of the board.
    Status(StatusRecord),
    /// A rare event of the link, for the log.
    Link {
        /// When it happened.
        time_ns: u64,
        /// The event.
        event: LinkEvent,
    },
    /// The counters so far.
    Counters(LineCounters),
    /// A configuration has been proved on a car.
    Proved {
        /// When the first metre had passed.
        time_ns: u64,
        /// The configuration and the car.
        proof: Proof,
    },
    /// A proof is void: a drive contradicted the configuration.
    Disproved {
        /// When the contradiction was found.
        time_ns: u64,
        /// The configuration and the car.
        proof: Proof,
    },
}

/// Counts of the line to the board.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct LineCounters {
    /// The counters of the session.
    pub link: Counters,
    /// Drive commands written to the port.
    pub drives_written: u64,
    /// Drive commands not written because the port was full or closed, or the board silent.
    pub drives_withheld: u64,
    /// Reports and ticks that found no room in their rings.
    pub reports_dropped: u64,
}

impl ControlRequest {
    /// The bit of a request that ends a drive; `None` for any other.
    const fn stop(&self) -> Option<u8> {
        Some(match self {
            Self::Pilot(PilotRequest::Arm(_) | PilotRequest::Hold)
            | Self::ArmAt(_)
            | Self::Learned(_)
            | Self::Reconfigure(_) => return None,
            Self::Pilot(PilotRequest::Disarm) => 1,
            Self::Pilot(PilotRequest::Carried) => 1 << 1,
            Self::Pilot(PilotRequest::EmergencyStop) => 1 << 2,
            Self::Pilot(PilotRequest::OperatorGone) => 1 << 3,
            Self::Pilot(PilotRequest::TimeUp) => 1 << 4,
            Self::Pilot(PilotRequest::Halt) => 1 << 5,
            Self::Finish => 1 << 6,
            Self::Abort => 1 << 7,
        })
    }
}

impl Requests {
    /// Wraps the sending end of the ring that the control loop reads.
    pub fn new(ring: Producer<ControlRequest>) -> Self {
        Self(Arc::new(Mutex::new(Sender {
            slots: ring.slots(),
            ring,
            stops: 0,
        })))
    }

    /// Pushes a request. Senders may wait for each other; the control thread never waits.
    ///
    /// A stop is always taken: one that waits already, with nothing but stops behind it, is not
    /// pushed again, because the control loop takes all that wait with one tick.
    ///
    /// # Errors
    ///
    /// [`Stalled`] for requests other than a stop, if only the reserved slots are left.
    pub fn push(&self, request: ControlRequest) -> Result<(), Stalled> {
        // The ring is consistent even if a sender has panicked.
        let mut sender = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let free = sender.ring.slots();
        if free == sender.slots {
            sender.stops = 0;
        }
        match request.stop() {
            Some(stop) if sender.stops & stop != 0 => return Ok(()),
            Some(stop) => sender.stops |= stop,
            None if free <= RESERVED => return Err(Stalled),
            None => sender.stops = 0,
        }
        sender.ring.push(request).map_err(|_| Stalled)
    }
}

impl Report {
    /// The entry for the record; `None` for a report that is only logged or counted.
    pub const fn entry(self) -> Option<Entry> {
        match self {
            Self::Telemetry(record) => Some(Entry::Telemetry(record)),
            Self::Status(record) => Some(Entry::Status(record)),
            Self::Link { .. }
            | Self::Counters(_)
            | Self::Proved { .. }
            | Self::Disproved { .. } => None,
        }
    }

    /// The report of a link event that happened at `time_ns`.
    pub const fn of(time_ns: u64, event: &LinkEvent) -> Self {
        match *event {
            LinkEvent::Telemetry(record) => Self::Telemetry(TelemetryRecord {
                receive_time_ns: record.receive_time_ns,
                board_time_host_ns: record.board_time_host_ns,
                imu_time_host_ns: record.imu_time_host_ns,
                telemetry: record.telemetry,
            }),
            LinkEvent::Status(status) => Self::Status(StatusRecord {
                receive_time_ns: time_ns,
                status,
            }),
            event => Self::Link { time_ns, event },
        }
    }
}

/// The state of the session without its details, as the record has it.
pub const fn link_phase(state: &State) -> LinkPhase {
    match state {
        State::Disconnected => LinkPhase::Disconnected,
        State::Greeting { .. } => LinkPhase::Greeting,
        State::VersionMismatch(_) => LinkPhase::VersionMismatch,
        State::Configuring => LinkPhase::Configuring,
        State::ConfigurationRefused { .. } => LinkPhase::ConfigurationRefused,
        State::Ready { .. } => LinkPhase::Ready,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// All requests that a client, a signal or the end of a connection can cause.
    fn all() -> Vec<ControlRequest> {
        let pilot = PilotRequest::ALL.map(ControlRequest::Pilot);
        pilot
            .into_iter()
            .chain([ControlRequest::Finish, ControlRequest::Abort])
            .collect()
    }

    #[test]
    fn no_flood_of_requests_keeps_any_stop_out() {
        for flood in all() {
            for other in all() {
                let (ring, mut taken) = rtrb::RingBuffer::new(2 * RESERVED);
                let requests = Requests::new(ring);
                for _ in 0..100 {
                    let _ = requests.push(flood.clone());
                    let _ = requests.push(other.clone());
                }
                let stops = all().into_iter().filter(|request| request.stop().is_some());
                for stop in stops {
                    assert_eq!(requests.push(stop.clone()), Ok(()), "{flood:?}, {other:?}");
                    // It comes after all that could undo it.
                    let mut waiting = Vec::new();
                    while let Ok(request) = taken.pop() {
                        waiting.push(request);
                    }
                    let last = waiting.iter().rposition(|request| request.stop().is_none());
                    let after = &waiting[last.map_or(0, |last| last + 1)..];
                    assert!(after.contains(&stop), "{flood:?}, {other:?}: {waiting:?}");
                    for request in waiting {
                        let _ = requests.push(request);
                    }
                }
            }
        }
    }

    #[test]
    fn a_stop_that_was_taken_is_pushed_again() {
        let (ring, mut taken) = rtrb::RingBuffer::new(2 * RESERVED);
        let requests = Requests::new(ring);
        let disarm = ControlRequest::Pilot(PilotRequest::Disarm);
        for _ in 0..3 {
            assert_eq!(requests.push(disarm.clone()), Ok(()));
            assert_eq!(requests.push(disarm.clone()), Ok(()));
            assert_eq!(taken.pop(), Ok(disarm.clone()));
            assert!(taken.is_empty());
        }
    }
}
