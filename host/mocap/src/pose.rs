//! Poses in the world frame, and everything that can be the matter with one.

use crate::binding::Binding;
use crate::clock::Capture;
use crate::codec::RigidBody;
use crate::config::PoseLimits;

/// The axis that points up in the server's stream: a setting of the server that
/// is not on the wire.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum UpAxis {
    /// y points up (Motive's default). World x is the stream's x, world y its -z.
    Y,
    /// z points up, as in the world frame.
    Z,
}

impl UpAxis {
    /// A vector of the stream in the world frame. It turns the vector part of a
    /// quaternion as well.
    #[must_use]
    pub fn to_z_up(self, [x, y, z]: [f32; 3]) -> [f64; 3] {
        let [x, y, z] = [f64::from(x), f64::from(y), f64::from(z)];
        match self {
            Self::Y => [x, -z, y],
            Self::Z => [x, y, z],
        }
    }
}

/// A believable pose of the body, in the world frame with z up.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pose {
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
    /// When the cameras saw it, on the local monotonic clock. Never after
    /// `receive_time_ns`.
    pub capture_time_ns: u64,
    /// Bound on the error of `capture_time_ns`.
    pub capture_uncertainty_ns: u64,
    /// How `capture_time_ns` was found.
    pub capture_source: CaptureTimeSource,
    /// When the frame arrived, on the local monotonic clock.
    pub receive_time_ns: u64,
    /// The server's number of the frame.
    pub frame_number: i32,
    /// Mean distance of the markers from the model, in metres.
    pub mean_error_m: f64,
    /// The first pose ever, or the first after the body was locked out: it does
    /// not continue the one before.
    pub reacquired: bool,
}

/// How a capture time was found, best first.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum CaptureTimeSource {
    /// Mid-exposure time, mapped by echo exchanges. The uncertainty is a bound.
    MidExposureEcho,
    /// Mid-exposure time, mapped by the least delay observed between sending and
    /// receiving. The uncertainty rests on an assumed network delay.
    MidExposureMinDelay,
    /// The frame's timestamp, mapped by the least delay observed: the server does
    /// not tell mid-exposure. The uncertainty rests on an assumed latency.
    FrameTimestamp,
}

impl CaptureTimeSource {
    /// All values.
    pub const ALL: [Self; 3] = [
        Self::MidExposureEcho,
        Self::MidExposureMinDelay,
        Self::FrameTimestamp,
    ];

    /// The word for this value in status, log, record and documentation.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::MidExposureEcho => "mid-exposure-echo",
            Self::MidExposureMinDelay => "mid-exposure-min-delay",
            Self::FrameTimestamp => "frame-timestamp",
        }
    }
}

/// What is known of the body.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum PoseState {
    /// No frame has come since the session connected.
    NoFrames,
    /// Frames come, but the body's name has no id.
    Unbound(Binding),
    /// The cameras see it.
    Valid(Pose),
    /// The server lists it as not tracked.
    Untracked,
    /// The frame does not list it.
    Absent,
    /// There is a pose, but it is not believed.
    Rejected(RejectReason),
    /// Many poses in a row were not believed; this is the newest one's reason.
    LockedOut(RejectReason),
    /// The stream is silent.
    Stale {
        /// For how long.
        silent_ns: u64,
    },
}

/// Why a pose is not believed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum RejectReason {
    /// A number is not finite.
    NotFinite,
    /// The quaternion's norm is not one.
    NotUnitQuaternion,
    /// Two bodies of the frame have the body's id.
    DuplicateId,
    /// The markers fit the model badly.
    MeanError,
    /// The frame has no usable time, one after its reception, or one before the
    /// last pose's.
    CaptureTime,
    /// The body would have moved faster than it can.
    Jump,
    /// The body would have turned faster than it can, or its up axis is too far
    /// from the world's.
    Flip,
}

impl RejectReason {
    /// All values.
    pub const ALL: [Self; 7] = [
        Self::NotFinite,
        Self::NotUnitQuaternion,
        Self::DuplicateId,
        Self::MeanError,
        Self::CaptureTime,
        Self::Jump,
        Self::Flip,
    ];

    /// The word for this value in status, log, record and documentation.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::NotFinite => "not-finite",
            Self::NotUnitQuaternion => "not-unit-quaternion",
            Self::DuplicateId => "duplicate-id",
            Self::MeanError => "mean-error",
            Self::CaptureTime => "capture-time",
            Self::Jump => "jump",
            Self::Flip => "flip",
        }
    }
}

impl Pose {
    /// The body's pose in the world frame, or why it can be none whatever came
    /// before.
    pub(crate) fn from_body(
        body: &RigidBody,
        up_axis: UpAxis,
        limits: &PoseLimits,
        frame_number: i32,
        receive_time_ns: u64,
        capture: Capture,
    ) -> Result<Self, RejectReason> {
        let [qx, qy, qz, qw] = body.orientation_xyzw;
        let position = up_axis.to_z_up(body.position_m);
        let vector = up_axis.to_z_up([qx, qy, qz]);
        let w = f64::from(qw);
        let mean_error_m = f64::from(body.mean_error_m);
        let finite = position
            .iter()
            .chain(&vector)
            .all(|value| value.is_finite());
        if !(finite && w.is_finite() && mean_error_m.is_finite()) {
            return Err(RejectReason::NotFinite);
        }
        let norm = libm::sqrt(vector.iter().map(|v| v * v).sum::<f64>() + w * w);
        if libm::fabs(norm - 1.0) > limits.quaternion_norm_tolerance {
            return Err(RejectReason::NotUnitQuaternion);
        }
        if mean_error_m > limits.max_mean_error_m {
            return Err(RejectReason::MeanError);
        }
        let [x, y, z] = vector.map(|v| v / norm);
        let w = w / norm;
        // The half angle's sine, which unlike the cosine is exact near zero.
        let tilt_rad = 2.0 * libm::asin(libm::sqrt(x * x + y * y).min(1.0));
        if tilt_rad > limits.max_tilt_rad {
            return Err(RejectReason::Flip);
        }
        let [x_m, y_m, z_m] = position;
        Ok(Self {
            x_m,
            y_m,
            z_m,
            yaw_rad: libm::atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z)),
            tilt_rad,
            capture_time_ns: capture.time_ns,
            capture_uncertainty_ns: capture.uncertainty_ns,
            capture_source: capture.source,
            receive_time_ns,
            frame_number,
            mean_error_m,
            reacquired: false,
        })
    }
}
