//! The rigid bodies of a frame, with whole poses in the world frame; and when the frame was captured,
//! in local time.

use crate::words;

use crate::codec::{RigidBodies, RigidBody};

words! {
    /// The axis that points up in the server's stream: a setting of the server that
    /// is not on the wire.
    pub enum UpAxis: serde {
        /// y points up (Motive's default). World x is the stream's x, world y its -z.
        Y = "y",
        /// z points up, as in the world frame.
        Z = "z",
    }
}

impl UpAxis {
    /// A vector of the stream in the world frame. The vector part of a quaternion
    /// turns in the same way.
    #[must_use]
    pub const fn to_z_up(self, [x, y, z]: [f64; 3]) -> [f64; 3] {
        match self {
            Self::Y => [x, -z, y],
            Self::Z => [x, y, z],
        }
    }
}

/// Where a rigid body is, in the right-handed world frame with z up.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct BodyPose {
    /// Position x, y, z of the body's pivot, in metres.
    pub position_m: [f64; 3],
    /// Unit quaternion x, y, z, w: it turns a vector of the body's frame into the
    /// world frame.
    pub orientation_xyzw: [f64; 4],
    /// Mean distance of the markers from the model, in metres.
    pub mean_error_m: f64,
}

/// What one frame says of one rigid body.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct Body {
    /// The streaming id. The model definitions give it a name.
    pub id: i32,
    /// Its pose, or why there is none.
    pub state: BodyState,
}

/// A body's pose, or why there is none.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum BodyState {
    /// The cameras see the body.
    Tracked(BodyPose),
    /// The server lists the body as not tracked. It repeats an old pose or zeros,
    /// which are not passed on.
    Untracked,
    /// The server lists the body as tracked, but its numbers are not a pose.
    Invalid(InvalidBody),
}

/// Why the numbers of a tracked body are not a pose.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, thiserror::Error)]
pub enum InvalidBody {
    /// A number of the pose or its mean error is not finite.
    #[error("a number of the pose is not finite")]
    NotFinite,
    /// The quaternion's norm differs from one by more than the tolerance.
    #[error("the quaternion's norm is not one")]
    NotUnitQuaternion,
    /// Two bodies of the frame have the id. Only a look-up by id reports this.
    #[error("two bodies of the frame have the same id")]
    DuplicateId,
}

/// No camera sees farther.
const FARTHEST_M: f64 = 10_000.0;

/// How streamed bodies are read.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct BodyReading {
    pub(crate) up_axis: UpAxis,
    pub(crate) quaternion_norm_tolerance: f64,
}

impl BodyReading {
    pub(crate) fn body(&self, body: &RigidBody) -> Body {
        let (id, mut state) = (body.id, BodyState::Untracked);
        if body.tracking_valid() {
            let position_m = body.position_m.map(f64::from);
            let orientation_xyzw = body.orientation_xyzw.map(f64::from);
            state = self.read(position_m, orientation_xyzw, body.mean_error_m.into());
        }
        Body { id, state }
    }

    /// What a body's numbers say that a server with doubles sent.
    pub(crate) fn state(
        &self,
        position_m: [f64; 3],
        orientation_xyzw: [f64; 4],
        mean_error_m: f64,
    ) -> BodyState {
        if position_m.iter().any(|x| libm::fabs(*x) > FARTHEST_M) {
            return BodyState::Invalid(InvalidBody::NotFinite);
        }
        self.read(position_m, orientation_xyzw, mean_error_m)
    }

    /// A pose in the server's axes.
    fn read(
        &self,
        position_m: [f64; 3],
        [qx, qy, qz, w]: [f64; 4],
        mean_error_m: f64,
    ) -> BodyState {
        let position_m = self.up_axis.to_z_up(position_m);
        let vector = self.up_axis.to_z_up([qx, qy, qz]);
        let finite = position_m.iter().chain(&vector).all(|x| x.is_finite());
        if !(finite && w.is_finite() && mean_error_m.is_finite()) {
            return BodyState::Invalid(InvalidBody::NotFinite);
        }
        let norm = libm::sqrt(vector.iter().map(|v| v * v).sum::<f64>() + w * w);
        if libm::fabs(norm - 1.0) > self.quaternion_norm_tolerance {
            return BodyState::Invalid(InvalidBody::NotUnitQuaternion);
        }
        // Doubles that are a rotation keep their bits.
        let is_one = libm::fabs(norm - 1.0) < 4.0 * f64::EPSILON;
        let norm = if is_one { 1.0 } else { norm };
        let [x, y, z] = vector.map(|v| v / norm);
        BodyState::Tracked(BodyPose {
            position_m,
            orientation_xyzw: [x, y, z, w / norm],
            mean_error_m,
        })
    }
}

/// The bodies of a frame in wire order, tracked or not.
#[derive(Clone, Debug)]
pub struct Bodies<'a> {
    pub(crate) of: BodiesOf<'a>,
    pub(crate) up_axis: UpAxis,
}

/// Where the bodies are read from.
#[derive(Clone, Debug)]
pub(crate) enum BodiesOf<'a> {
    NatNet(RigidBodies<'a>, BodyReading),
    List(core::slice::Iter<'a, Body>),
}

impl Bodies<'_> {
    /// The body with this id; `None` when the frame does not list it.
    pub(crate) fn with_id(&self, id: i32) -> Option<Body> {
        let mut bodies = self.clone().filter(|body| body.id == id);
        let mut body = bodies.next()?;
        if bodies.next().is_some() {
            body.state = BodyState::Invalid(InvalidBody::DuplicateId);
        }
        Some(body)
    }
}

impl Iterator for Bodies<'_> {
    type Item = Body;

    fn next(&mut self) -> Option<Body> {
        match &mut self.of {
            BodiesOf::NatNet(bodies, reading) => bodies.next().map(|body| reading.body(&body)),
            BodiesOf::List(bodies) => bodies.next().copied(),
        }
    }

    fn size_hint(&self) -> (usize, Option<usize>) {
        match &self.of {
            BodiesOf::NatNet(bodies, _) => bodies.size_hint(),
            BodiesOf::List(bodies) => bodies.size_hint(),
        }
    }
}

impl ExactSizeIterator for Bodies<'_> {}

/// The capture time of a frame on the local clock.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct CaptureTime {
    /// The middle of the exposure, in nanoseconds of the local clock. It is never
    /// after the frame's arrival.
    pub time_ns: u64,
    /// Bound on the error of `time_ns`, in nanoseconds.
    pub uncertainty_ns: u64,
    /// How `time_ns` was found.
    pub source: CaptureTimeSource,
}

words! {
    /// How a capture time was found, best first.
    ///
    /// This enum is exhaustive: a new source is a breaking change, because every user
    /// must decide whether it trusts it.
    pub enum CaptureTimeSource {
        /// Mid-exposure time, mapped by echo exchanges. The uncertainty is a bound. With VRPN it
        /// is the server's stamp of the report: what it stamps is the server's business.
        MidExposureEcho = "mid-exposure-echo",
        /// Mid-exposure time, mapped by the least delay observed between sending and
        /// receiving. The uncertainty rests on an assumed network delay.
        MidExposureMinDelay = "mid-exposure-min-delay",
        /// The frame's timestamp, mapped by the least delay observed: the server does
        /// not send mid-exposure time. The uncertainty rests on an assumed latency.
        FrameTimestamp = "frame-timestamp",
    }
}
