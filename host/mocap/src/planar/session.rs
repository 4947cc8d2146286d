//! A camera session and a tracker in one.

use super::{
    Observation, PlanarConfig, PlanarConfigError, PlanarCounters, PoseState,
    tracker::{OtherBody, PlanarTracker},
};
use crate::{
    names::Binding,
    pose_source::{Input, Output, PoseSource, SessionEvent, Stream, Transmit},
    source::Source,
};

/// A client of the configured protocol that follows one rigid body in the plane.
///
/// It is called as every session ([order of the calls](crate#order-of-the-calls)).
///
/// ```
/// use singletrack_mocap::planar::{PlanarConfig, PlanarEvent, PlanarSession, PoseState};
/// use singletrack_mocap::{Input, Transport, UpAxis};
///
/// # fn main() -> Result<(), Box<dyn std::error::Error>> {
/// let server = "192.168.1.10".parse()?;
/// let config = PlanarConfig::new(server, Transport::Multicast, "car", UpAxis::Y)?;
/// let mut session = PlanarSession::new(config)?;
///
/// # let (now_ns, source, bytes) = (0, "192.168.1.10:1511".parse()?, &[0; 4]);
/// session.handle_input(now_ns, Input::Datagram { source, bytes }, &mut |event| {
///     if let PlanarEvent::Observed(observation) = event
///         && let PoseState::Valid(pose) = observation.state
///     {
///         println!("{:.3} m, {:.3} m, {:.3} rad", pose.x_m, pose.y_m, pose.yaw_rad);
///     }
/// });
/// # Ok(())
/// # }
/// ```
#[derive(Clone, Debug)]
pub struct PlanarSession {
    source: Source,
    tracker: PlanarTracker,
    config: PlanarConfig,
}

/// What a session says to its owner, in order.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum PlanarEvent {
    /// What the newest frame says of the body. All other events are rare, and worth a line in the
    /// log.
    Observed(Observation),
    /// What it says of another body, before what it says of the one that is followed; with
    /// [`PlanarConfig::tells_others`] alone.
    Other(OtherBody),
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
        let body = Some(config.rigid_body.as_str());
        Ok(Self {
            source: Source::new(config.session.clone(), body)?,
            tracker: PlanarTracker::new(config.rigid_body.clone(), config.limits)?,
            config,
        })
    }

    // Handlers.

    /// Takes what arrived: see [`PoseSource::handle_input`](crate::PoseSource::handle_input).
    pub fn handle_input(
        &mut self,
        now_ns: u64,
        input: Input<'_>,
        on_event: &mut impl FnMut(PlanarEvent),
    ) -> usize {
        let (tracker, tells_others) = (&mut self.tracker, self.config.tells_others);
        let mut are_incomplete = false;
        let used = self.source.handle_input(now_ns, input, &mut |output| {
            are_incomplete |= pass_on(tracker, &output, tells_others, on_event);
        });
        if are_incomplete {
            self.source.request_names_again();
        }
        used
    }

    /// Acts on what did not arrive: see
    /// [`PoseSource::handle_timeout`](crate::PoseSource::handle_timeout).
    pub fn handle_timeout(&mut self, now_ns: u64, on_event: &mut impl FnMut(PlanarEvent)) {
        let (tracker, tells_others) = (&mut self.tracker, self.config.tells_others);
        self.source.handle_timeout(now_ns, &mut |output| {
            pass_on(tracker, &output, tells_others, on_event);
        });
    }

    // Requests.

    /// Replaces the offset of the stamps: see
    /// [`PoseSource::set_stamp_offset_ns`](crate::PoseSource::set_stamp_offset_ns).
    pub fn set_stamp_offset_ns(&mut self, offset_ns: i64) {
        self.config.session.timing.stamp_offset_ns = offset_ns;
        self.source.set_stamp_offset_ns(offset_ns);
    }

    /// Leaves the server: see [`PoseSource::close`](crate::PoseSource::close).
    pub fn close(&mut self) {
        self.source.close();
    }

    // Pollers.

    /// The next message to send: see
    /// [`PoseSource::poll_transmit`](crate::PoseSource::poll_transmit).
    pub fn poll_transmit(&mut self, now_ns: u64) -> Option<Transmit> {
        self.source.poll_transmit(now_ns)
    }

    /// The time of the next wake-up: see
    /// [`PoseSource::poll_timeout`](crate::PoseSource::poll_timeout).
    pub fn poll_timeout(&self) -> Option<u64> {
        self.source.poll_timeout()
    }

    /// The stream that the owner keeps open: see [`PoseSource::stream`](crate::PoseSource::stream).
    pub fn stream(&self) -> Option<Stream> {
        self.source.stream()
    }

    // Getters.

    /// What is known of the body at `now_ns`, silence included.
    pub fn pose_state(&self, now_ns: u64) -> PoseState {
        match self.source.stale_for_ns(now_ns) {
            Some(silent_ns) => PoseState::Stale { silent_ns },
            None => self.tracker.state,
        }
    }

    /// What the session knows of the server.
    pub fn source(&self) -> &dyn PoseSource {
        &*self.source
    }

    /// What is known of the body, its name and its neighbours by the newest frame.
    pub const fn tracker(&self) -> &PlanarTracker {
        &self.tracker
    }

    /// What was counted so far.
    pub fn counters(&self) -> PlanarCounters {
        let mut counters = self.tracker.counters;
        counters.session = self.source.counters();
        counters
    }

    /// The session's configuration.
    pub const fn config(&self) -> &PlanarConfig {
        &self.config
    }
}

/// Returns whether the server's names lack the body.
fn pass_on(
    tracker: &mut PlanarTracker,
    output: &Output<'_>,
    tells_others: bool,
    on_event: &mut impl FnMut(PlanarEvent),
) -> bool {
    let binding = match output {
        Output::Frame(frame) => {
            if let Some(id) = tracker.binding.id().filter(|_| tells_others) {
                OtherBody::of(id, frame).for_each(|other| on_event(PlanarEvent::Other(other)));
            }
            on_event(PlanarEvent::Observed(tracker.observe(frame)));
            return false;
        }
        Output::Names(names) => tracker.resolve(names),
        Output::Event(SessionEvent::DefinitionsOutdated) => tracker.forget_binding(),
        Output::Event(event) => {
            on_event(PlanarEvent::Session(*event));
            return false;
        }
    };
    if let Some(binding) = binding {
        on_event(PlanarEvent::Binding(binding));
    }
    matches!(output, Output::Names(_)) && tracker.binding.id().is_none()
}
