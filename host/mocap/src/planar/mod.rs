//! The motion of one rigid body in the plane, with a plausibility check.
//!
//! A layer above the camera session for vehicles on a floor. It uses the public
//! interface of the crate only.
//!
//! - [`PlanarTracker`] takes the frames of a [`Session`](crate::Session), finds the
//!   body by its name, projects its pose onto the plane ([`PlanarPose`]), and checks
//!   each pose against the last accepted one ([`PoseLimits`]). The result is one
//!   [`Observation`] a frame.
//! - [`PlanarSession`] is a session and a tracker in one, called as every session
//!   ([order of the calls](crate#order-of-the-calls)).
//!
//! [`Observation`], [`PoseState`], [`PlanarPose`] and [`RejectReason`] are
//! exhaustive: what is recorded of them does not grow silently.

mod tracker;

use core::net::IpAddr;

use tracker::tilt;
pub use tracker::{Level, NEAR_M, Neighbour, OtherBody, PlanarTracker, PoseGate};

use crate::{
    body::{BodyPose, CaptureTime, CaptureTimeSource, UpAxis},
    config::{SessionConfig, SessionConfigError, Transport, not_zero, positive},
    names::Binding,
    pose_source::{Input, Output, PoseSource, SessionCounters, SessionEvent, Stream, Transmit},
    source::Source,
    words,
};

/// A rigid body's name as in the server's asset list.
pub type RigidBodyName = heapless::String<255>;

/// The configuration of a [`PlanarSession`].
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct PlanarConfig {
    /// The camera session's configuration, or a limit.
    pub session: SessionConfig,
    /// The body to follow.
    pub rigid_body: RigidBodyName,
    /// Which poses are plausible.
    pub limits: PoseLimits,
    /// Whether the session also passes on the poses of all other bodies.
    pub tells_others: bool,
}

/// Which poses are plausible.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PoseLimits {
    /// Largest mean marker error, in metres.
    pub max_mean_error_m: f64,
    /// Largest speed of the body, in metres per second.
    pub max_speed_m_s: f64,
    /// Distance allowed in addition to speed times time, in metres.
    pub jump_margin_m: f64,
    /// Largest yaw rate of the body, in radians per second.
    pub max_yaw_rate_rad_s: f64,
    /// Yaw allowed in addition to yaw rate times time, in radians.
    pub yaw_margin_rad: f64,
    /// Largest angle between the body's up axis and the world's, in radians.
    pub max_tilt_rad: f64,
    /// After this number of rejected poses in a row the body is locked out. After
    /// the same number of further poses that are consistent with each other, it is
    /// accepted again.
    pub max_consecutive_rejects: u32,
}

impl Default for PoseLimits {
    /// Limits for a model car on a floor.
    fn default() -> Self {
        Self {
            max_mean_error_m: 0.005,
            max_speed_m_s: 5.0,
            jump_margin_m: 0.05,
            max_yaw_rate_rad_s: 10.0,
            yaw_margin_rad: 0.3,
            max_tilt_rad: 0.5,
            max_consecutive_rejects: 10,
        }
    }
}

/// Why a configuration is refused.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum PlanarConfigError {
    /// The camera session's configuration, or a limit.
    #[error(transparent)]
    Session(#[from] SessionConfigError),
    /// No name, or one that NatNet can't carry.
    #[error("the rigid body's name is {len} bytes long, it must be 1 to 255")]
    RigidBodyName {
        /// Length of the name.
        len: usize,
    },
}

impl PlanarConfig {
    /// A configuration with default port, limits and timing.
    ///
    /// # Errors
    /// The name is empty or longer than 255 bytes.
    pub fn new(
        server: IpAddr,
        transport: Transport,
        rigid_body: &str,
        up_axis: UpAxis,
    ) -> Result<Self, PlanarConfigError> {
        let (name, len) = (RigidBodyName::try_from(rigid_body), rigid_body.len());
        let name = name.ok().filter(|_| len > 0);
        let name = name.ok_or(PlanarConfigError::RigidBodyName { len })?;
        Ok(Self {
            session: SessionConfig::new(server, transport, up_axis),
            rigid_body: name,
            limits: PoseLimits::default(),
            tells_others: false,
        })
    }
}

impl PoseLimits {
    fn validate(&self) -> Result<(), SessionConfigError> {
        positive(&[
            ("max_mean_error_m", self.max_mean_error_m),
            ("max_speed_m_s", self.max_speed_m_s),
            ("jump_margin_m", self.jump_margin_m),
            ("max_yaw_rate_rad_s", self.max_yaw_rate_rad_s),
            ("yaw_margin_rad", self.yaw_margin_rad),
            ("max_tilt_rad", self.max_tilt_rad),
        ])?;
        let rejects = self.max_consecutive_rejects.into();
        not_zero(&[("max_consecutive_rejects", rejects)])
    }
}

/// What one frame says of the body.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Observation {
    /// The server's number of the frame.
    pub frame_number: i32,
    /// When the frame arrived, in nanoseconds of the local monotonic clock.
    pub receive_time_ns: u64,
    /// The state of the body.
    pub state: PoseState,
}

/// What is known of the body.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum PoseState {
    /// No frame has arrived yet.
    NoFrames,
    /// Frames arrive, but the body's name has no id.
    Unbound(Binding),
    /// The cameras see the body.
    Valid(PlanarPose),
    /// The server lists the body as not tracked.
    Untracked,
    /// The frame does not list the body.
    Absent,
    /// The pose is not plausible.
    Rejected(RejectReason),
    /// Many poses in a row were not plausible. This is the reason for the newest.
    LockedOut(RejectReason),
    /// The stream is silent.
    Stale {
        /// Duration of the silence.
        silent_ns: u64,
    },
}

/// An accepted pose of the body, in the world frame with z up.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlanarPose {
    /// Position of the body's pivot, in metres.
    pub x_m: f64,
    /// Position of the body's pivot, in metres.
    pub y_m: f64,
    /// Height of the body's pivot, in metres.
    pub z_m: f64,
    /// Heading of the body's x axis in the plane, from world x towards world y,
    /// in -pi to pi radians.
    pub yaw_rad: f64,
    /// Angle between the body's up axis and the world's, in radians.
    pub tilt_rad: f64,
    /// Rotation about the body's x axis, its left side up, in radians.
    pub roll_rad: f64,
    /// Rotation about the body's y axis, its front down, in radians.
    pub pitch_rad: f64,
    /// Mid-exposure, in nanoseconds of the local monotonic clock. It is never after
    /// `receive_time_ns`.
    pub capture_time_ns: u64,
    /// Bound on the error of `capture_time_ns`, in nanoseconds.
    pub capture_uncertainty_ns: u64,
    /// How `capture_time_ns` was found.
    pub capture_source: CaptureTimeSource,
    /// When the frame arrived, in nanoseconds of the local monotonic clock.
    pub receive_time_ns: u64,
    /// The server's number of the frame.
    pub frame_number: i32,
    /// Mean distance of the markers from the model, in metres.
    pub mean_error_m: f64,
    /// The pose does not continue the one before: it is the first, or the first
    /// after a lock-out.
    pub reacquired: bool,
}

words! {
    /// Why a pose is not accepted.
    pub enum RejectReason {
        /// A number is not finite.
        ///
        /// Remedy: Report it to the cameras' vendor.
        NotFinite = "not-finite",
        /// The quaternion's norm is not one.
        ///
        /// Remedy: Stop other programs that send to this port; check `motion_capture.bitstream`.
        NotUnitQuaternion = "not-unit-quaternion",
        /// Two bodies of the frame have the car's id.
        ///
        /// Remedy: Give each rigid body an id of its own.
        DuplicateId = "duplicate-id",
        /// The markers fit the model badly.
        ///
        /// Remedy: Define the rigid body again; a marker has moved.
        MeanError = "mean-error",
        /// The frame has no usable time, or one after its arrival or before the last pose.
        ///
        /// Remedy: Look at the server's clock and at what it stamps (`wrong-clock`); restart it.
        CaptureTime = "capture-time",
        /// The body would have moved faster than `motion_capture.pose.max_speed_m_s`.
        ///
        /// Effect: Ten in a row lock the body out: `pose-implausible`.
        ///
        /// Remedy: Look for reflections and bodies with the same markers.
        Jump = "jump",
        /// The body would have turned too fast, or lies on its side.
        ///
        /// Effect: As `jump`.
        ///
        /// Remedy: Make the marker pattern less symmetric.
        Flip = "flip",
    }
}

impl PlanarPose {
    /// Projects a pose onto the plane.
    ///
    /// With the quaternion (x, y, z, w), the yaw is atan2(2(wz + xy), 1 - 2(y² + z²))
    /// and the tilt is 2 asin √(x² + y²). The world's up axis, seen from the body, gives
    /// roll and pitch.
    pub(super) fn project(
        pose: &BodyPose,
        capture: &CaptureTime,
        frame_number: i32,
        receive_time_ns: u64,
    ) -> Self {
        let [x_m, y_m, z_m] = pose.position_m;
        let [x, y, z, w] = pose.orientation_xyzw;
        Self {
            x_m,
            y_m,
            z_m,
            yaw_rad: libm::atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z)),
            tilt_rad: tilt([x, y]),
            roll_rad: libm::atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y)),
            pitch_rad: libm::asin((2.0 * (w * y - x * z)).clamp(-1.0, 1.0)),
            capture_time_ns: capture.time_ns,
            capture_uncertainty_ns: capture.uncertainty_ns,
            capture_source: capture.source,
            receive_time_ns,
            frame_number,
            mean_error_m: pose.mean_error_m,
            reacquired: false,
        }
    }
}

/// Counts since the session was made. Nothing resets them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[non_exhaustive]
pub struct PlanarCounters {
    /// The camera session's counts.
    pub session: SessionCounters,
    /// Frames with an accepted pose.
    pub valid: u64,
    /// Frames in which the body is not tracked.
    pub untracked: u64,
    /// Frames without the body.
    pub absent: u64,
    /// Frames while the body's name had no id.
    pub unbound: u64,
    /// Frames with a rejected pose, by reason.
    pub rejected: RejectedCounts,
    /// Frames while the body was locked out. `rejected` counts them as well.
    pub locked_out: u64,
}

/// Rejected poses by reason.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct RejectedCounts([u64; RejectReason::ALL.len()]);

impl RejectedCounts {
    pub(super) const fn count(&mut self, reason: RejectReason) {
        self.0[reason as usize] += 1;
    }

    /// Poses that were rejected for this reason.
    pub const fn of(&self, reason: RejectReason) -> u64 {
        self.0[reason as usize]
    }

    /// The sum of all reasons.
    pub fn total(&self) -> u64 {
        self.0.iter().sum()
    }
}

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

    /// Takes what arrived: see [`PoseSource::handle_input`].
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

    /// Acts on what did not arrive: see [`PoseSource::handle_timeout`].
    pub fn handle_timeout(&mut self, now_ns: u64, on_event: &mut impl FnMut(PlanarEvent)) {
        let (tracker, tells_others) = (&mut self.tracker, self.config.tells_others);
        self.source.handle_timeout(now_ns, &mut |output| {
            pass_on(tracker, &output, tells_others, on_event);
        });
    }

    // Requests.

    /// Replaces the offset of the stamps: see [`PoseSource::set_stamp_offset_ns`].
    pub fn set_stamp_offset_ns(&mut self, offset_ns: i64) {
        self.config.session.timing.stamp_offset_ns = offset_ns;
        self.source.set_stamp_offset_ns(offset_ns);
    }

    /// Leaves the server: see [`PoseSource::close`].
    pub fn close(&mut self) {
        self.source.close();
    }

    // Pollers.

    /// The next message to send: see [`PoseSource::poll_transmit`].
    pub fn poll_transmit(&mut self, now_ns: u64) -> Option<Transmit> {
        self.source.poll_transmit(now_ns)
    }

    /// The time of the next wake-up: see [`PoseSource::poll_timeout`].
    pub fn poll_timeout(&self) -> Option<u64> {
        self.source.poll_timeout()
    }

    /// The stream that the owner keeps open: see [`PoseSource::stream`].
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
