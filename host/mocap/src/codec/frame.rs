//! FRAMEOFDATA: one frame of poses.

use super::{
    error::DecodeError,
    packet::Packet,
    reader::Reader,
    rigid_body::{RigidBodies, RigidBody},
    version::BitstreamVersion,
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
    #[must_use]
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
    pub(super) fn decode(
        packet: &Packet<'a>,
        version: BitstreamVersion,
    ) -> Result<Self, DecodeError> {
        let mut reader = packet.reader();
        let number = reader.i32("frame number")?;
        let mut walk = Walk {
            reader: &mut reader,
            version,
        };
        let mut sections = SectionCounts::default();

        (sections.marker_sets, _) = walk.section("marker set count", 5, |reader| {
            reader.c_bytes("marker set name")?;
            let markers = reader.count(MARKER_LEN, "marker count")?;
            reader.skip(markers, MARKER_LEN, "markers")
        })?;
        (sections.other_markers, _) = walk.section("other marker count", MARKER_LEN, |reader| {
            reader.skip(1, MARKER_LEN, "other marker")
        })?;
        let bodies;
        (sections.rigid_bodies, bodies) =
            walk.section("rigid body count", RigidBody::MIN_LEN, |reader| {
                RigidBody::skip(reader, 1, version)
            })?;
        (sections.skeletons, _) = walk.section("skeleton count", 8, |reader| {
            reader.i32("skeleton id")?;
            let bones = reader.count(RigidBody::MIN_LEN, "bone count")?;
            RigidBody::skip(reader, bones, version)
        })?;
        let labelled_marker_len = labelled_marker_len(version);
        if version.has_assets() {
            (sections.assets, _) = walk.section("asset count", 12, |reader| {
                reader.i32("asset id")?;
                let bodies = reader.count(RigidBody::MIN_LEN, "asset rigid body count")?;
                RigidBody::skip(reader, bodies, version)?;
                let markers = reader.count(labelled_marker_len, "asset marker count")?;
                reader.skip(markers, labelled_marker_len, "asset markers")
            })?;
        }
        (sections.labelled_markers, _) =
            walk.section("labelled marker count", labelled_marker_len, |reader| {
                reader.skip(1, labelled_marker_len, "labelled marker")
            })?;
        if version.has_force_plates() {
            (sections.force_plates, _) =
                walk.section("force plate count", 8, skip_analog_channels)?;
        }
        if version.has_devices() {
            (sections.devices, _) = walk.section("device count", 8, skip_analog_channels)?;
        }
        Self {
            number,
            sections,
            timecode: [0; 2],
            timestamp_s: 0.0,
            ticks: None,
            precision_time: None,
            latency: None,
            flags: FrameFlags(0),
            rigid_bodies: RigidBodies::new(bodies, sections.rigid_bodies, version),
        }
        .with_tail(&mut reader, version)
    }

    /// Reads the fields after the sections, to the end.
    fn with_tail(
        mut self,
        reader: &mut Reader<'_>,
        version: BitstreamVersion,
    ) -> Result<Self, DecodeError> {
        if version.has_latency() {
            self.latency = Some(reader.f32("latency")?);
        }
        self.timecode = [reader.u32("timecode")?, reader.u32("timecode subframe")?];
        self.timestamp_s = reader.f64("timestamp")?;
        if version.has_camera_ticks() {
            self.ticks = Some(CameraTicks {
                mid_exposure: reader.u64("mid-exposure ticks")?,
                received: reader.u64("received ticks")?,
                transmit: reader.u64("transmit ticks")?,
            });
        }
        if version.has_precision_time() {
            self.precision_time = Some(PrecisionTime {
                seconds: reader.u32("precision seconds")?,
                fraction: reader.u32("precision fraction")?,
            });
        }
        self.flags = FrameFlags(reader.u16("frame flags")?);
        let offset = reader.offset();
        let value = reader.i32("end tag")?;
        reader.finish("the frame")?;
        if value != 0 {
            return Err(DecodeError::EndTag { offset, value });
        }
        Ok(self)
    }

    /// The bodies of the rigid-body section in wire order. Bones of skeletons and bodies
    /// of assets are not among them.
    #[must_use]
    pub fn rigid_bodies(&self) -> RigidBodies<'a> {
        self.rigid_bodies.clone()
    }
}

const fn labelled_marker_len(version: BitstreamVersion) -> usize {
    // id, position, size, parameters; then the residual.
    4 + 12 + 4 + 2 + if version.has_marker_residual() { 4 } else { 0 }
}

/// Force plates and devices: an id, then channels of samples.
fn skip_analog_channels(reader: &mut Reader<'_>) -> Result<(), DecodeError> {
    reader.i32("analog device id")?;
    let channels = reader.count(4, "channel count")?;
    for _ in 0..channels {
        let samples = reader.count(4, "sample count")?;
        reader.skip(samples, 4, "samples")?;
    }
    Ok(())
}

struct Walk<'r, 'a> {
    reader: &'r mut Reader<'a>,
    version: BitstreamVersion,
}

impl<'a> Walk<'_, 'a> {
    /// Walks one section, and checks its size where the version has one.
    /// Returns the number of entries and a reader at the first one.
    fn section(
        &mut self,
        field: &'static str,
        min_entry_len: usize,
        mut entry: impl FnMut(&mut Reader<'a>) -> Result<(), DecodeError>,
    ) -> Result<(usize, Reader<'a>), DecodeError> {
        let offset = self.reader.offset();
        let count = self.reader.length(field)?;
        let sized = self.version.has_section_sizes();
        let body = if sized {
            self.reader.sized("section size")?
        } else {
            *self.reader
        };
        body.check_count(count, min_entry_len, field, offset)?;
        let mut walked = body;
        for _ in 0..count {
            entry(&mut walked)?;
        }
        if sized {
            walked.finish(field)?;
        } else {
            *self.reader = walked;
        }
        Ok((count, body))
    }
}
