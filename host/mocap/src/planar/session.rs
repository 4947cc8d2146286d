//! A camera session and a tracker in one.

use core::net::{IpAddr, SocketAddr};

use super::{
    config::{PlanarConfig, PlanarConfigError},
    counters::PlanarCounters,
    level::Level,
    neighbour::Neighbour,
    observation::{Observation, PoseState},
    tracker::PlanarTracker,
};
use crate::{
    binding::{Binding, BodyNames},
    codec::DecodeError,
    session::{DatagramOutcome, Phase, Session, SessionEvent, Transmit},
};

/// A NatNet client that follows one rigid body in the plane.
///
/// It is called as every session ([order of the calls](crate#order-of-the-calls)).
///
/// ```
/// use singletrack_mocap::planar::{PlanarConfig, PlanarOutcome, PlanarSession, PoseState};
/// use singletrack_mocap::{Transport, UpAxis};
///
/// # fn main() -> Result<(), Box<dyn std::error::Error>> {
/// let server = "192.168.1.10".parse()?;
/// let config = PlanarConfig::new(server, Transport::Multicast, "car", UpAxis::Y)?;
/// let mut session = PlanarSession::new(config)?;
///
/// # let (now_ns, source, datagram) = (0, "192.168.1.10:1511".parse()?, [0; 4]);
/// let outcome = session.handle_datagram(now_ns, source, &datagram, &mut |event| {
///     println!("{event:?}");
/// });
/// if let PlanarOutcome::Frame(observation) = outcome
///     && let PoseState::Valid(pose) = observation.state
/// {
///     println!("{:.3} m, {:.3} m, {:.3} rad", pose.x_m, pose.y_m, pose.yaw_rad);
/// }
/// # Ok(())
/// # }
/// ```
#[derive(Clone, Debug)]
pub struct PlanarSession {
    session: Session,
    tracker: PlanarTracker,
    config: PlanarConfig,
}

/// What became of a datagram. Every case is counted as well.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub enum PlanarOutcome {
    /// The newest frame, and what it says of the body.
    Frame(Observation),
    /// A frame older than the newest: dropped.
    Late,
    /// The newest frame again: dropped.
    Duplicate,
    /// A reply that the session waited for.
    Reply,
    /// A good message that the session does not need: dropped.
    Ignored,
    /// From another address than the server's: dropped.
    WrongSource,
    /// It can't be decoded: dropped.
    Malformed(DecodeError),
}

/// A rare event, worth a line in the log.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum PlanarEvent {
    /// An event of the camera session, other than
    /// [`DefinitionsOutdated`](SessionEvent::DefinitionsOutdated).
    Session(SessionEvent),
    /// The body's name was found, was not found, or is looked up again.
    Binding(Binding),
}

impl PlanarSession {
    /// A session that has not connected yet.
    ///
    /// # Errors
    /// A value of the configuration can't be used.
    pub fn new(config: PlanarConfig) -> Result<Self, PlanarConfigError> {
        Ok(Self {
            session: Session::new(config.session.clone())?,
            tracker: PlanarTracker::new(config.rigid_body.clone(), config.limits)?,
            config,
        })
    }

    // Handlers.

    /// Takes a datagram that arrived at `now_ns` from `source`.
    pub fn handle_datagram(
        &mut self,
        now_ns: u64,
        source: SocketAddr,
        datagram: &[u8],
        on_event: &mut impl FnMut(PlanarEvent),
    ) -> PlanarOutcome {
        let Self {
            session, tracker, ..
        } = self;
        let outcome = session.handle_datagram(now_ns, source, datagram, &mut |event| {
            pass_on(tracker, event, on_event);
        });
        match outcome {
            DatagramOutcome::Frame(frame) => PlanarOutcome::Frame(tracker.observe(&frame)),
            DatagramOutcome::Definitions(definitions) => {
                if let Some(binding) = tracker.resolve(&definitions) {
                    on_event(PlanarEvent::Binding(binding));
                }
                if tracker.binding().id().is_none() {
                    session.request_definitions_again();
                }
                PlanarOutcome::Reply
            }
            DatagramOutcome::Reply => PlanarOutcome::Reply,
            DatagramOutcome::Late => PlanarOutcome::Late,
            DatagramOutcome::Duplicate => PlanarOutcome::Duplicate,
            DatagramOutcome::WrongSource => PlanarOutcome::WrongSource,
            DatagramOutcome::Malformed(error) => PlanarOutcome::Malformed(error),
            // `Ignored`, and what later versions of the session may add.
            _ => PlanarOutcome::Ignored,
        }
    }

    /// As [`Session::handle_timeout`].
    pub fn handle_timeout(&mut self, now_ns: u64, on_event: &mut impl FnMut(PlanarEvent)) {
        let Self {
            session, tracker, ..
        } = self;
        session.handle_timeout(now_ns, &mut |event| pass_on(tracker, event, on_event));
    }

    // Requests.

    /// As [`Session::set_stamp_offset_ns`].
    pub const fn set_stamp_offset_ns(&mut self, offset_ns: i64) {
        self.config.session.timing.stamp_offset_ns = offset_ns;
        self.session.set_stamp_offset_ns(offset_ns);
    }

    /// As [`Session::close`].
    pub const fn close(&mut self) {
        self.session.close();
    }

    // Pollers.

    /// As [`Session::poll_transmit`].
    pub fn poll_transmit(&mut self, now_ns: u64) -> Option<Transmit> {
        self.session.poll_transmit(now_ns)
    }

    /// As [`Session::poll_timeout`].
    #[must_use]
    pub fn poll_timeout(&self) -> Option<u64> {
        self.session.poll_timeout()
    }

    // Getters.

    /// What is known of the body at `now_ns`, silence included.
    #[must_use]
    pub fn pose_state(&self, now_ns: u64) -> PoseState {
        match self.session.stale_for_ns(now_ns) {
            Some(silent_ns) => PoseState::Stale { silent_ns },
            None => self.tracker.state(),
        }
    }

    /// How far the session is.
    #[must_use]
    pub const fn phase(&self) -> Phase {
        self.session.phase()
    }

    /// Which streaming id the body's name has.
    #[must_use]
    pub const fn binding(&self) -> Binding {
        self.tracker.binding()
    }

    /// As [`PlanarTracker::names`].
    #[must_use]
    pub const fn names(&self) -> &BodyNames {
        self.tracker.names()
    }

    /// As [`PlanarTracker::level`].
    #[must_use]
    pub const fn level(&self) -> Option<Level> {
        self.tracker.level()
    }

    /// As [`PlanarTracker::neighbour`].
    #[must_use]
    pub const fn neighbour(&self) -> Option<Neighbour> {
        self.tracker.neighbour()
    }

    /// As [`Session::other_source`].
    #[must_use]
    pub const fn other_source(&self) -> Option<IpAddr> {
        self.session.other_source()
    }

    /// As [`Session::is_contradicted`].
    #[must_use]
    pub fn is_contradicted(&self, now_ns: u64) -> bool {
        self.session.is_contradicted(now_ns)
    }

    /// What was counted so far.
    #[must_use]
    pub const fn counters(&self) -> PlanarCounters {
        let mut counters = self.tracker.counters();
        counters.session = self.session.counters();
        counters
    }

    /// The session's configuration.
    #[must_use]
    pub const fn config(&self) -> &PlanarConfig {
        &self.config
    }
}

fn pass_on(
    tracker: &mut PlanarTracker,
    event: SessionEvent,
    on_event: &mut impl FnMut(PlanarEvent),
) {
    if event == SessionEvent::DefinitionsOutdated {
        if let Some(binding) = tracker.forget_binding() {
            on_event(PlanarEvent::Binding(binding));
        }
    } else {
        on_event(PlanarEvent::Session(event));
    }
}
