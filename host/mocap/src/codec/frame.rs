//! FRAMEOFDATA: one frame of poses, and the rigid bodies that it carries.

use super::{
    BitstreamVersion,
    packet::{DecodeError, Decoded, Packet, Reader},
};

const MARKER_LEN: usize = 12;

/// One frame of data, checked from the first byte to the last.
#[derive(Clone, Debug)]
pub struct Frame<'a> {
    /// The frame's number. It grows by one with every frame, wraps, and starts again
    /// with the server.
    pub number: i32,
    /// How many entries the sections hold.
    pub sections: SectionCounts,
    /// SMPTE timecode, and its subframe.
    pub timecode: [u32; 2],
    /// The server's time of this frame in seconds, from an epoch of its own.
    pub timestamp_s: f64,
    /// When the frame was exposed, received and sent, from 3.0 on.
    pub ticks: Option<CameraTicks>,
    /// PTP time, from 4.1 on.
    pub precision_time: Option<PrecisionTime>,
    /// The field that versions before 3.0 call latency. In real packets it is another
    /// timestamp in seconds.
    pub latency: Option<f32>,
    /// The frame's flags.
    pub flags: FrameFlags,
    rigid_bodies: RigidBodies<'a>,
}

/// Times of a frame in ticks of the server's high-resolution clock.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct CameraTicks {
    /// The middle of the exposure; 0 when it is not available.
    pub mid_exposure: u64,
    /// When the server had received the cameras' data.
    pub received: u64,
    /// When the server sent the frame.
    pub transmit: u64,
}

/// PTP time of a frame.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PrecisionTime {
    /// Whole seconds.
    pub seconds: u32,
    /// Fraction of a second, in the server's unit.
    pub fraction: u32,
}

/// The flags at the end of a frame.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct FrameFlags(pub u16);

impl FrameFlags {
    /// The server is recording.
    pub const RECORDING: Self = Self(1);
    /// The list of models changed. Servers do not always set it: poll the definitions
    /// as well.
    pub const MODELS_CHANGED: Self = Self(2);

    /// Whether every flag of `other` is set.
    pub const fn contains(self, other: Self) -> bool {
        self.0 & other.0 == other.0
    }
}

/// How many entries each section of a frame holds.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SectionCounts {
    /// Named marker sets.
    pub marker_sets: usize,
    /// Markers that belong to no marker set.
    pub other_markers: usize,
    /// Rigid bodies, tracked or not.
    pub rigid_bodies: usize,
    /// Skeletons.
    pub skeletons: usize,
    /// Assets (from 4.1 on).
    pub assets: usize,
    /// Labelled markers.
    pub labelled_markers: usize,
    /// Force plates (from 2.9 on).
    pub force_plates: usize,
    /// Devices (from 2.11 on).
    pub devices: usize,
}

impl<'a> Frame<'a> {
    /// Decodes a packet that the caller has identified as a frame.
    pub(super) fn decode(packet: &Packet<'a>, version: BitstreamVersion) -> Decoded<Self> {
        let mut reader = packet.reader();
        let number = reader.i32("frame number")?;
        let mut sections = SectionCounts::default();

        (sections.marker_sets, _) = reader.section(version, "marker set count", 5, |reader| {
            reader.c_bytes("marker set name")?;
            let markers = reader.count(MARKER_LEN, "marker count")?;
            reader.skip(markers, MARKER_LEN, "markers")
        })?;
        (sections.other_markers, _) =
            reader.section(version, "other marker count", MARKER_LEN, |reader| {
                reader.skip(1, MARKER_LEN, "other marker")
            })?;
        let bodies;
        (sections.rigid_bodies, bodies) =
            reader.section(version, "rigid body count", RigidBody::LEN, |reader| {
                RigidBody::skip(reader, 1, version)
            })?;
        (sections.skeletons, _) = reader.section(version, "skeleton count", 8, |reader| {
            reader.i32("skeleton id")?;
            let bones = reader.count(RigidBody::LEN, "bone count")?;
            RigidBody::skip(reader, bones, version)
        })?;
        let marker_len = labelled_marker_len(version);
        if version >= BitstreamVersion::V4_1 {
            (sections.assets, _) = reader.section(version, "asset count", 12, |reader| {
                reader.i32("asset id")?;
                let bodies = reader.count(RigidBody::LEN, "asset rigid body count")?;
                RigidBody::skip(reader, bodies, version)?;
                let markers = reader.count(marker_len, "asset marker count")?;
                reader.skip(markers, marker_len, "asset markers")
            })?;
        }
        (sections.labelled_markers, _) =
            reader.section(version, "labelled marker count", marker_len, |reader| {
                reader.skip(1, marker_len, "labelled marker")
            })?;
        if version >= BitstreamVersion::V2_9 {
            (sections.force_plates, _) =
                reader.section(version, "force plate count", 8, skip_analog_channels)?;
        }
        if version >= BitstreamVersion::V2_11 {
            (sections.devices, _) =
                reader.section(version, "device count", 8, skip_analog_channels)?;
        }
        let rigid_bodies = RigidBodies {
            reader: bodies,
            left: sections.rigid_bodies,
            version,
        };
        // In the order on the wire.
        let frame = Self {
            number,
            sections,
            rigid_bodies,
            latency: (version < BitstreamVersion::V3_0)
                .then(|| reader.f32("latency"))
                .transpose()?,
            timecode: [reader.u32("timecode")?, reader.u32("timecode subframe")?],
            timestamp_s: reader.f64("timestamp")?,
            ticks: match version >= BitstreamVersion::V3_0 {
                true => Some(CameraTicks {
                    mid_exposure: reader.u64("mid-exposure ticks")?,
                    received: reader.u64("received ticks")?,
                    transmit: reader.u64("transmit ticks")?,
                }),
                false => None,
            },
            precision_time: match version >= BitstreamVersion::V4_1 {
                true => Some(PrecisionTime {
                    seconds: reader.u32("precision seconds")?,
                    fraction: reader.u32("precision fraction")?,
                }),
                false => None,
            },
            flags: FrameFlags(reader.u16("frame flags")?),
        };
        let offset = reader.offset();
        let value = reader.i32("end tag")?;
        reader.finish("the frame")?;
        if value != 0 {
            return Err(DecodeError::EndTag { offset, value });
        }
        Ok(frame)
    }

    /// The bodies of the rigid-body section in wire order. Bones of skeletons and bodies
    /// of assets are not among them.
    pub fn rigid_bodies(&self) -> RigidBodies<'a> {
        self.rigid_bodies.clone()
    }
}

fn labelled_marker_len(version: BitstreamVersion) -> usize {
    // id, position, size, parameters; then the residual.
    let residual = usize::from(version >= BitstreamVersion::V3_0);
    4 + 12 + 4 + 2 + 4 * residual
}

/// Force plates and devices: an id, then channels of samples.
fn skip_analog_channels(reader: &mut Reader<'_>) -> Decoded<()> {
    reader.i32("analog device id")?;
    let channels = reader.count(4, "channel count")?;
    for _ in 0..channels {
        let samples = reader.count(4, "sample count")?;
        reader.skip(samples, 4, "samples")?;
    }
    Ok(())
}

impl<'a> Reader<'a> {
    /// Walks one section, and checks its size where the version has one.
    /// Returns the number of entries and a reader at the first one.
    fn section(
        &mut self,
        version: BitstreamVersion,
        field: &'static str,
        min_entry_len: usize,
        mut entry: impl FnMut(&mut Reader<'a>) -> Decoded<()>,
    ) -> Decoded<(usize, Reader<'a>)> {
        let offset = self.offset();
        let count = self.length(field)?;
        let sized = version >= BitstreamVersion::V4_1;
        let body = if sized {
            self.sized("section size")?
        } else {
            *self
        };
        body.check_count(count, min_entry_len, field, offset)?;
        let mut walked = body;
        for _ in 0..count {
            entry(&mut walked)?;
        }
        if sized {
            walked.finish(field)?;
        } else {
            *self = walked;
        }
        Ok((count, body))
    }
}

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
    /// Length on the wire from 3.0 on, and the least in any version.
    const LEN: usize = 38;

    /// A body with this pose, tracked, with a perfect fit.
    pub const fn tracked(id: i32, position_m: [f32; 3], orientation_xyzw: [f32; 4]) -> Self {
        Self {
            id,
            position_m,
            orientation_xyzw,
            mean_error_m: 0.0,
            params: TRACKING_VALID,
        }
    }

    /// This body with the tracking bit set or cleared.
    #[must_use]
    pub const fn with_tracking_valid(mut self, valid: bool) -> Self {
        self.params &= !TRACKING_VALID;
        if valid {
            self.params |= TRACKING_VALID;
        }
        self
    }

    /// Whether the cameras saw the body in this frame.
    pub const fn tracking_valid(&self) -> bool {
        self.params & TRACKING_VALID != 0
    }

    fn read(reader: &mut Reader<'_>, version: BitstreamVersion) -> Decoded<Self> {
        let id = reader.i32("rigid body id")?;
        let position_m = reader.f32s("rigid body position")?;
        let orientation_xyzw = reader.f32s("rigid body orientation")?;
        if version < BitstreamVersion::V3_0 {
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
    fn skip(reader: &mut Reader<'_>, count: usize, version: BitstreamVersion) -> Decoded<()> {
        if version >= BitstreamVersion::V3_0 {
            return reader.skip(count, Self::LEN, "rigid bodies");
        }
        (0..count).try_for_each(|_| Self::read(reader, version).map(drop))
    }
}

/// The rigid bodies of a decoded frame, in wire order.
#[derive(Clone, Debug)]
pub struct RigidBodies<'a> {
    reader: Reader<'a>,
    left: usize,
    version: BitstreamVersion,
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
