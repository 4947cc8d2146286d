//! The session of any protocol.

use core::ops::{Deref, DerefMut};

use crate::{
    config::{Protocol, SessionConfig, SessionConfigError},
    pose_source::PoseSource,
    qualisys,
    session::Session,
    vrpn,
};

/// The session of the configured protocol, used as a [`PoseSource`].
#[derive(Clone, Debug)]
#[expect(
    clippy::large_enum_variant,
    reason = "a session is made once, and there is no heap"
)]
pub enum Source {
    /// NatNet: OptiTrack Motive.
    NatNet(Session),
    /// VRPN.
    Vrpn(vrpn::Session),
    /// The real-time protocol of Qualisys QTM.
    Qualisys(qualisys::Session),
}

impl Source {
    /// A session that has not connected yet. With a name, VRPN has frames of that body only;
    /// without one, a frame of each body for itself.
    ///
    /// # Errors
    /// A value of the configuration can't be used.
    pub fn new(config: SessionConfig, body: Option<&str>) -> Result<Self, SessionConfigError> {
        config.validate()?;
        Ok(match config.protocol {
            Protocol::NatNet => Self::NatNet(Session::new(config)?),
            Protocol::Vrpn { sensor } => Self::Vrpn(vrpn::session(config, sensor, body)),
            Protocol::Qualisys => Self::Qualisys(qualisys::session(config)),
        })
    }
}

impl Deref for Source {
    type Target = dyn PoseSource;

    fn deref(&self) -> &Self::Target {
        match self {
            Self::NatNet(session) => session,
            Self::Vrpn(session) => session,
            Self::Qualisys(session) => session,
        }
    }
}

impl DerefMut for Source {
    fn deref_mut(&mut self) -> &mut Self::Target {
        match self {
            Self::NatNet(session) => session,
            Self::Vrpn(session) => session,
            Self::Qualisys(session) => session,
        }
    }
}
