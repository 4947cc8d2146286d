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

mod observation;
mod session;
mod tracker;

use core::net::IpAddr;

use crate::{
    body::UpAxis,
    config::{SessionConfig, SessionConfigError, Transport, not_zero, positive},
};

pub use observation::{
    Observation, PlanarCounters, PlanarPose, PoseState, RejectReason, RejectedCounts,
};
pub use session::{PlanarEvent, PlanarSession};
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
        let name = RigidBodyName::try_from(rigid_body)
            .ok()
            .filter(|name| !name.is_empty())
            .ok_or(PlanarConfigError::RigidBodyName {
                len: rigid_body.len(),
            })?;
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
