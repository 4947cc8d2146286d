//! Follows one body through the frames: whether a pose can follow the last accepted one, how the body
//! lies with either up axis, and another body near its place, whose markers may have been taken for
//! those of the car.

use core::f64::consts::{PI, TAU};

use super::{
    Observation, PlanarConfigError, PlanarCounters, PlanarPose, PoseLimits, PoseState,
    RejectReason, RigidBodyName,
};
use crate::{
    body::{BodyPose, BodyState, InvalidBody, UpAxis},
    names::{Binding, BodyNames, Names},
    pose_source::PoseFrame,
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
    /// Which streaming id the body's name has.
    pub binding: Binding,
    /// The names of the server's rigid bodies, as read last.
    pub names: BodyNames,
    gate: PoseGate,
    /// How the body lies by its last pose, accepted or not, with either up axis.
    pub level: Option<Level>,
    /// Another body near the followed one in the newest frame.
    pub neighbour: Option<Neighbour>,
    /// The state of the body in the newest frame.
    pub state: PoseState,
    /// What was counted so far. The session's counts are zero: the tracker does not
    /// know them.
    pub counters: PlanarCounters,
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
        let place_m = self.gate.place_m();
        let neighbour = |id| Neighbour::of(id, frame, place_m);
        self.neighbour = self.binding.id().and_then(neighbour);
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
        if body.state == BodyState::Untracked {
            self.counters.untracked += 1;
            return PoseState::Untracked;
        }
        let candidate = self.candidate(body.state, frame);
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
    fn candidate(&self, state: BodyState, frame: &PoseFrame<'_>) -> Candidate {
        let capture = frame.capture.ok_or(RejectReason::CaptureTime);
        let (pose, capture) = match state {
            BodyState::Tracked(pose) => (pose, capture?),
            BodyState::Invalid(InvalidBody::DuplicateId) => return Err(RejectReason::DuplicateId),
            BodyState::Invalid(InvalidBody::NotUnitQuaternion) => {
                return capture.and(Err(RejectReason::NotUnitQuaternion));
            }
            _ => return capture.and(Err(RejectReason::NotFinite)),
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
}

/// A pose that may follow the last one, or why it can't whatever came before.
type Candidate = Result<PlanarPose, RejectReason>;

/// The plausibility check of a [`PlanarTracker`], which is also for poses
/// that were recorded without one.
#[derive(Clone, Debug)]
pub struct PoseGate {
    limits: PoseLimits,
    last_valid: Option<PlanarPose>,
    last_implausible: Option<PlanarPose>,
    rejects: u32,
    /// Implausible poses in a row that follow each other, since the lock-out.
    consistent: u32,
}

impl PoseGate {
    /// A gate that has seen no pose.
    pub const fn new(limits: PoseLimits) -> Self {
        Self {
            limits,
            last_valid: None,
            last_implausible: None,
            rejects: 0,
            consistent: 0,
        }
    }

    /// Whether the pose can follow the ones before it.
    pub fn judge(&mut self, pose: PlanarPose) -> PoseState {
        self.judge_candidate(Ok(pose))
    }

    /// Position of the last accepted pose, m.
    fn place_m(&self) -> Option<[f64; 3]> {
        self.last_valid.map(|pose| [pose.x_m, pose.y_m, pose.z_m])
    }

    fn judge_candidate(&mut self, candidate: Candidate) -> PoseState {
        let pose = match candidate {
            Ok(pose) => pose,
            Err(reason) => {
                self.last_implausible = None;
                self.consistent = 0;
                return self.reject(reason);
            }
        };
        let Some(last_valid) = self.last_valid else {
            return self.accept(pose, true);
        };
        let Err(reason) = self.follows(&last_valid, &pose) else {
            return self.accept(pose, self.is_locked_out());
        };
        let follows = |last| self.follows(&last, &pose).is_ok();
        let is_consistent = self.last_implausible.is_some_and(follows) && self.is_locked_out();
        let run = self.consistent + 1;
        self.consistent = if is_consistent { run } else { 0 };
        if is_consistent && self.consistent >= self.limits.max_consecutive_rejects {
            return self.accept(pose, true);
        }
        self.last_implausible = Some(pose);
        self.reject(reason)
    }

    const fn is_locked_out(&self) -> bool {
        self.rejects >= self.limits.max_consecutive_rejects
    }

    fn accept(&mut self, mut pose: PlanarPose, reacquired: bool) -> PoseState {
        pose.reacquired = reacquired;
        self.last_valid = Some(pose);
        self.last_implausible = None;
        self.rejects = 0;
        self.consistent = 0;
        PoseState::Valid(pose)
    }

    const fn reject(&mut self, reason: RejectReason) -> PoseState {
        self.rejects = self.rejects.saturating_add(1);
        if self.is_locked_out() {
            PoseState::LockedOut(reason)
        } else {
            PoseState::Rejected(reason)
        }
    }

    /// Whether a body that was at `from` can be at `to`.
    fn follows(&self, from: &PlanarPose, to: &PlanarPose) -> Result<(), RejectReason> {
        // Accepting an old capture time would make the next pose plausible wherever it
        // is: the body would have had a long time to get there.
        let backward_ns = from.capture_time_ns.saturating_sub(to.capture_time_ns);
        let from_within_ns = from.capture_uncertainty_ns;
        let uncertainty_ns = from_within_ns.saturating_add(to.capture_uncertainty_ns);
        if backward_ns > uncertainty_ns {
            return Err(RejectReason::CaptureTime);
        }
        let elapsed_ns = to.capture_time_ns.saturating_sub(from.capture_time_ns);
        let elapsed_s = elapsed_ns as f64 * 1e-9;
        let [dx, dy, dz] = [to.x_m - from.x_m, to.y_m - from.y_m, to.z_m - from.z_m];
        let distance_m = libm::sqrt(dx * dx + dy * dy + dz * dz);
        let limits = &self.limits;
        if distance_m > limits.jump_margin_m + limits.max_speed_m_s * elapsed_s {
            return Err(RejectReason::Jump);
        }
        let turned_rad = libm::fabs(wrap_to_pi(to.yaw_rad - from.yaw_rad));
        if turned_rad > limits.yaw_margin_rad + limits.max_yaw_rate_rad_s * elapsed_s {
            return Err(RejectReason::Flip);
        }
        Ok(())
    }
}

/// An angle wrapped to -pi to pi.
fn wrap_to_pi(angle_rad: f64) -> f64 {
    angle_rad - TAU * libm::floor((angle_rad + PI) / TAU)
}

/// Height and tilt of a body, read with the configured up axis and with the other one.
///
/// The up axis is a setting of the server and is not on the wire. A car on a floor has a low
/// height and a small tilt with the right one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Level {
    /// Height of the pivot, in metres.
    pub height_m: f64,
    /// Angle between the body's up axis and the world's, in radians.
    pub tilt_rad: f64,
    /// The height with the other up axis.
    pub other_height_m: f64,
    /// The tilt with the other up axis.
    pub other_tilt_rad: f64,
}

/// Where the pivot of a car on a floor can be, in metres, and how far it can tilt, in radians.
const LOWEST_M: f64 = -0.1;
const HIGHEST_M: f64 = 0.6;
const TILT_RAD: f64 = 0.3;

impl Level {
    pub(super) fn of(pose: &BodyPose, up_axis: UpAxis) -> Self {
        let [x, y, z, _] = pose.orientation_xyzw;
        let [_, py, pz] = pose.position_m;
        // Back to the stream's axes, then read as the other one.
        let (other_height_m, other_vector) = match up_axis {
            // Stream (x, y, z) was read as (x, -z, y).
            UpAxis::Y => (-py, [x, z]),
            UpAxis::Z => (py, [x, -z]),
        };
        Self {
            height_m: pz,
            tilt_rad: tilt([x, y]),
            other_height_m,
            other_tilt_rad: tilt(other_vector),
        }
    }

    /// Whether the pose is that of a car only if the other axis points up, and not the configured one.
    pub fn suggests_other_axis(&self) -> bool {
        let sensible = |height_m: f64, tilt_rad: f64| {
            (LOWEST_M..=HIGHEST_M).contains(&height_m) && tilt_rad <= TILT_RAD
        };
        !sensible(self.height_m, self.tilt_rad)
            && sensible(self.other_height_m, self.other_tilt_rad)
    }
}

/// The angle between two up axes, from the horizontal part of the rotation's vector.
pub(super) fn tilt([x, y]: [f64; 2]) -> f64 {
    2.0 * libm::asin(libm::sqrt(x * x + y * y).min(1.0))
}

/// What a frame says of another rigid body than the one that is followed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OtherBody {
    /// Its streaming id.
    pub id: i32,
    /// Mid-exposure, in nanoseconds of the local monotonic clock.
    pub capture_time_ns: u64,
    /// Position of its pivot on the floor, x and y of the world with z up, in metres; none if it
    /// is not tracked, or its numbers are no pose.
    pub position_m: Option<[f64; 2]>,
}

impl OtherBody {
    /// All of a frame but the body `id`; none of a frame without a usable time.
    pub(super) fn of<'a>(
        id: i32,
        frame: &'a PoseFrame<'_>,
    ) -> impl Iterator<Item = Self> + use<'a> {
        let others = frame.bodies().filter(move |body| body.id != id);
        others.filter_map(move |body| {
            Some(Self {
                id: body.id,
                capture_time_ns: frame.capture?.time_ns,
                position_m: tracked_m(body.state).map(|[x_m, y_m, _]| [x_m, y_m]),
            })
        })
    }
}

/// Distance from the followed body within which another one counts as near, m.
pub const NEAR_M: f64 = 0.5;

/// The nearest tracked body with another id, within [`NEAR_M`] of the followed body: of where the
/// stream has it, plausible or not, or of its last accepted pose.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Neighbour {
    /// Its streaming id.
    pub id: i32,
    /// Distance between the pivots, m.
    pub distance_m: f64,
}

impl Neighbour {
    /// The neighbour of the body `id`, which was last accepted at `accepted_m`.
    pub(super) fn of(id: i32, frame: &PoseFrame<'_>, accepted_m: Option<[f64; 3]>) -> Option<Self> {
        let streamed_m = frame.body(id).and_then(|body| tracked_m(body.state));
        let mut nearest: Option<Self> = None;
        for body in frame.bodies().filter(|body| body.id != id) {
            let Some(position_m) = tracked_m(body.state) else {
                continue;
            };
            for place_m in [streamed_m, accepted_m].into_iter().flatten() {
                let distance_m = distance(place_m, position_m);
                if distance_m <= nearest.map_or(NEAR_M, |nearest| nearest.distance_m) {
                    let id = body.id;
                    nearest = Some(Self { id, distance_m });
                }
            }
        }
        nearest
    }
}

/// The position of a tracked body, m.
const fn tracked_m(state: BodyState) -> Option<[f64; 3]> {
    match state {
        BodyState::Tracked(BodyPose { position_m, .. }) => Some(position_m),
        _ => None,
    }
}

fn distance(from: [f64; 3], to: [f64; 3]) -> f64 {
    let squares = from.iter().zip(to).map(|(a, b)| (a - b) * (a - b));
    libm::sqrt(squares.sum())
}
