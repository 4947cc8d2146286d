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

mod session;
mod tracker;

use core::net::IpAddr;

use crate::{
    body::{BodyPose, CaptureTime, CaptureTimeSource, UpAxis},
    config::{SessionConfig, SessionConfigError, Transport, not_zero, positive},
    names::Binding,
    pose_source::SessionCounters,
    words,
};

pub use session::{PlanarEvent, PlanarSession};
use tracker::tilt;
pub use tracker::{Level, NEAR_M, Neighbour, OtherBody, PlanarTracker, PoseGate};

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
