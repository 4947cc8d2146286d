//! Follows one body through the frames.

use super::{
    config::{PlanarConfigError, PoseLimits, RigidBodyName},
    counters::PlanarCounters,
    gate::PoseGate,
    level::Level,
    neighbour::Neighbour,
    observation::{Observation, PlanarPose, PoseState, RejectReason},
};
use crate::{
    binding::{Binding, BodyNames},
    body::{BodyState, InvalidBody},
    pose_source::Names,
    session::PoseFrame,
};

/// Follows one rigid body: finds it by its name, projects its pose onto the plane,
/// and rejects what is not plausible.
///
/// Feed it from a [`PoseSource`](crate::PoseSource):
///
/// - [`resolve`](Self::resolve) with [`Output::Names`](crate::Output::Names),
/// - [`forget_binding`](Self::forget_binding) on
///   [`SessionEvent::DefinitionsOutdated`](crate::SessionEvent::DefinitionsOutdated),
/// - [`observe`](Self::observe) with [`Output::Frame`](crate::Output::Frame).
///
/// [`PlanarSession`](super::PlanarSession) does this.
#[derive(Clone, Debug)]
pub struct PlanarTracker {
    rigid_body: RigidBodyName,
    limits: PoseLimits,
    binding: Binding,
    /// The names of the definitions read last.
    names: BodyNames,
    gate: PoseGate,
    level: Option<Level>,
    neighbour: Option<Neighbour>,
    state: PoseState,
    counters: PlanarCounters,
}

impl PlanarTracker {
    /// A tracker that has seen nothing.
    ///
    /// # Errors
    /// The name is empty, or a limit can't be used.
    pub fn new(rigid_body: RigidBodyName, limits: PoseLimits) -> Result<Self, PlanarConfigError> {
        if rigid_body.is_empty() {
            return Err(PlanarConfigError::RigidBodyName { len: 0 });
        }
        limits.validate()?;
        Ok(Self {
            rigid_body,
            limits,
            binding: Binding::Unresolved,
            names: BodyNames::default(),
            level: None,
            neighbour: None,
            gate: PoseGate::new(limits),
            state: PoseState::NoFrames,
            counters: PlanarCounters::default(),
        })
    }

    /// Looks the body's name up in new definitions. Returns the binding if it
    /// changed.
    pub fn resolve(&mut self, bodies: &Names<'_>) -> Option<Binding> {
        self.names = BodyNames::of(bodies);
        self.set_binding(Binding::resolve(bodies, &self.rigid_body))
    }

    /// The ids may mean other bodies: no pose is accepted until the definitions are
    /// read again. Returns the binding if it changed.
    ///
    /// The last accepted pose stays: it still bounds where the body can be.
    pub fn forget_binding(&mut self) -> Option<Binding> {
        self.set_binding(Binding::Unresolved)
    }

    fn set_binding(&mut self, binding: Binding) -> Option<Binding> {
        let changed = self.binding != binding;
        self.binding = binding;
        changed.then_some(binding)
    }

    /// What a frame says of the body.
    pub fn observe(&mut self, frame: &PoseFrame<'_>) -> Observation {
        self.state = self.state_in(frame);
        self.neighbour = self
            .binding
            .id()
            .and_then(|id| Neighbour::of(id, frame, self.gate.place_m()));
        Observation {
            frame_number: frame.number,
            receive_time_ns: frame.receive_time_ns,
            state: self.state,
        }
    }

    fn state_in(&mut self, frame: &PoseFrame<'_>) -> PoseState {
        let Binding::Bound { id } = self.binding else {
            self.counters.unbound += 1;
            return PoseState::Unbound(self.binding);
        };
        let Some(body) = frame.body(id) else {
            self.counters.absent += 1;
            return PoseState::Absent;
        };
        if let BodyState::Tracked(pose) = &body.state {
            self.level = Some(Level::of(pose, frame.up_axis()));
        }
        let candidate = match body.state {
            BodyState::Untracked => {
                self.counters.untracked += 1;
                return PoseState::Untracked;
            }
            state => self.candidate(state, frame),
        };
        let state = self.gate.judge_candidate(candidate);
        match state {
            PoseState::Rejected(reason) => self.counters.rejected.count(reason),
            PoseState::LockedOut(reason) => {
                self.counters.rejected.count(reason);
                self.counters.locked_out += 1;
            }
            _ => self.counters.valid += 1,
        }
        state
    }

    /// The body's pose in the plane, or why it is rejected without regard to earlier
    /// poses.
    fn candidate(
        &self,
        state: BodyState,
        frame: &PoseFrame<'_>,
    ) -> Result<PlanarPose, RejectReason> {
        if matches!(state, BodyState::Invalid(InvalidBody::DuplicateId)) {
            return Err(RejectReason::DuplicateId);
        }
        let capture = frame.capture.ok_or(RejectReason::CaptureTime)?;
        let BodyState::Tracked(pose) = state else {
            return Err(match state {
                BodyState::Invalid(InvalidBody::NotUnitQuaternion) => {
                    RejectReason::NotUnitQuaternion
                }
                _ => RejectReason::NotFinite,
            });
        };
        if pose.mean_error_m > self.limits.max_mean_error_m {
            return Err(RejectReason::MeanError);
        }
        let pose = PlanarPose::project(&pose, &capture, frame.number, frame.receive_time_ns);
        if pose.tilt_rad > self.limits.max_tilt_rad {
            return Err(RejectReason::Flip);
        }
        Ok(pose)
    }

    /// The names of the server's rigid bodies, as read last.
    #[must_use]
    pub const fn names(&self) -> &BodyNames {
        &self.names
    }

    /// How the body lies by its last pose, accepted or not, with either up axis.
    #[must_use]
    pub const fn level(&self) -> Option<Level> {
        self.level
    }

    /// Another body near the followed one in the newest frame.
    #[must_use]
    pub const fn neighbour(&self) -> Option<Neighbour> {
        self.neighbour
    }

    /// The state of the body in the newest frame.
    #[must_use]
    pub const fn state(&self) -> PoseState {
        self.state
    }

    /// Which streaming id the body's name has.
    #[must_use]
    pub const fn binding(&self) -> Binding {
        self.binding
    }

    /// What was counted so far. The session's counts are zero: the tracker does not
    /// know them.
    #[must_use]
    pub const fn counters(&self) -> PlanarCounters {
        self.counters
    }

    /// The body's name.
    #[must_use]
    pub fn rigid_body(&self) -> &str {
        &self.rigid_body
    }

    /// Which poses are plausible.
    #[must_use]
    pub const fn limits(&self) -> &PoseLimits {
        &self.limits
    }
}
