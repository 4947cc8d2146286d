//! Rigid bodies as a frame carries them.

use super::{error::DecodeError, reader::Reader, version::BitstreamVersion};

/// Bit 0 of a rigid body's parameters.
const TRACKING_VALID: u16 = 1;

/// Bytes of the markers that bodies carry before 3.0: position, id, size.
const BODY_MARKER_LEN: usize = 12 + 4 + 4;

/// One rigid body of a frame, in the axes the server streams.
///
/// A frame lists untracked bodies as well; an untracked one repeats an old
/// pose, or zeros. Check [`tracking_valid`](Self::tracking_valid) first.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RigidBody {
    /// The streaming id, which the model definitions give a name.
    pub id: i32,
    /// Position x, y, z of the body's pivot, in metres.
    pub position_m: [f32; 3],
    /// Attitude quaternion x, y, z, w.
    pub orientation_xyzw: [f32; 4],
    /// Mean distance of the markers from where the model has them, in metres.
    pub mean_error_m: f32,
    /// The parameter bits; bit 0 is "tracking valid".
    pub params: u16,
}

impl RigidBody {
    /// Length on the wire from 3.0 on.
    const LEN: usize = 38;
    /// The least a body takes in any version.
    pub(super) const MIN_LEN: usize = Self::LEN;

    /// A body with this pose, tracked, with a perfect fit.
    #[must_use]
    pub const fn tracked(id: i32, position_m: [f32; 3], orientation_xyzw: [f32; 4]) -> Self {
        Self {
            id,
            position_m,
            orientation_xyzw,
            mean_error_m: 0.0,
            params: TRACKING_VALID,
        }
    }

    /// The same body with the tracking bit set or cleared.
    #[must_use]
    pub const fn with_tracking_valid(mut self, valid: bool) -> Self {
        self.params = if valid {
            self.params | TRACKING_VALID
        } else {
            self.params & !TRACKING_VALID
        };
        self
    }

    /// Whether the cameras saw the body in this frame.
    #[must_use]
    pub const fn tracking_valid(&self) -> bool {
        self.params & TRACKING_VALID != 0
    }

    pub(super) fn read(
        reader: &mut Reader<'_>,
        version: BitstreamVersion,
    ) -> Result<Self, DecodeError> {
        let id = reader.i32("rigid body id")?;
        let position_m = reader.f32s("rigid body position")?;
        let orientation_xyzw = reader.f32s("rigid body orientation")?;
        if version.has_markers_in_bodies() {
            let markers = reader.count(BODY_MARKER_LEN, "rigid body marker count")?;
            reader.skip(markers, BODY_MARKER_LEN, "rigid body markers")?;
        }
        Ok(Self {
            id,
            position_m,
            orientation_xyzw,
            mean_error_m: reader.f32("rigid body mean error")?,
            params: reader.u16("rigid body parameters")?,
        })
    }

    /// Reads past `count` bodies, checking their bounds.
    pub(super) fn skip(
        reader: &mut Reader<'_>,
        count: usize,
        version: BitstreamVersion,
    ) -> Result<(), DecodeError> {
        if version.has_markers_in_bodies() {
            for _ in 0..count {
                Self::read(reader, version)?;
            }
            Ok(())
        } else {
            reader.skip(count, Self::LEN, "rigid bodies")
        }
    }
}

/// The rigid bodies of a decoded frame, in wire order.
#[derive(Clone, Debug)]
pub struct RigidBodies<'a> {
    reader: Reader<'a>,
    left: usize,
    version: BitstreamVersion,
}

impl<'a> RigidBodies<'a> {
    /// `reader` is at the first of `count` bodies, which have been checked.
    pub(super) const fn new(reader: Reader<'a>, count: usize, version: BitstreamVersion) -> Self {
        Self {
            reader,
            left: count,
            version,
        }
    }
}

impl Iterator for RigidBodies<'_> {
    type Item = RigidBody;

    fn next(&mut self) -> Option<RigidBody> {
        self.left = self.left.checked_sub(1)?;
        RigidBody::read(&mut self.reader, self.version).ok()
    }

    fn size_hint(&self) -> (usize, Option<usize>) {
        (self.left, Some(self.left))
    }
}

impl ExactSizeIterator for RigidBodies<'_> {}
