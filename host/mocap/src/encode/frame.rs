//! Encodes FRAMEOFDATA, with a bounded little-endian cursor that can fill in sizes afterwards.

use super::EncodeError;
use crate::codec::{
    BitstreamVersion, CameraTicks, FrameFlags, HEADER_LEN, MAX_DATAGRAM_LEN, MessageId,
    PrecisionTime, RigidBody,
};

/// The content of a frame. A field that the version does not have is left out: ticks
/// before 3.0, precision time before 4.1, latency and body markers from 3.0 on.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct FrameContent<'a> {
    /// The frame's number.
    pub number: i32,
    /// The rigid bodies, tracked or not.
    pub rigid_bodies: &'a [RigidBody],
    /// Markers that every body carries (before 3.0).
    pub body_markers: &'a [BodyMarker],
    /// The other sections.
    pub sections: Sections<'a>,
    /// SMPTE timecode and subframe.
    pub timecode: [u32; 2],
    /// Time of the frame in seconds.
    pub timestamp_s: f64,
    /// Exposure, reception and transmission in ticks (from 3.0 on).
    pub ticks: CameraTicks,
    /// PTP time (from 4.1 on).
    pub precision_time: PrecisionTime,
    /// Latency (before 3.0).
    pub latency: f32,
    /// The frame's flags.
    pub flags: FrameFlags,
}

/// The sections of a frame other than rigid bodies.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Sections<'a> {
    /// Named sets of markers.
    pub marker_sets: &'a [MarkerSet<'a>],
    /// Positions of markers that belong to no marker set, in metres.
    pub other_markers: &'a [[f32; 3]],
    /// Skeletons.
    pub skeletons: &'a [Skeleton<'a>],
    /// Assets (from 4.1 on).
    pub assets: &'a [Asset<'a>],
    /// Labelled markers.
    pub labelled_markers: &'a [LabelledMarker],
    /// Force plates (from 2.9 on).
    pub force_plates: &'a [AnalogDevice<'a>],
    /// Other devices (from 2.11 on).
    pub devices: &'a [AnalogDevice<'a>],
}

/// A marker of a rigid body, before 3.0.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BodyMarker {
    /// Position in metres.
    pub position_m: [f32; 3],
    /// Its id.
    pub id: i32,
    /// Diameter in metres.
    pub size_m: f32,
}

/// A named set of markers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MarkerSet<'a> {
    /// Its name.
    pub name: &'a str,
    /// Positions in metres.
    pub markers_m: &'a [[f32; 3]],
}

/// A skeleton.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Skeleton<'a> {
    /// Its id.
    pub id: i32,
    /// Its bones.
    pub bones: &'a [RigidBody],
}

/// An asset.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Asset<'a> {
    /// Its id.
    pub id: i32,
    /// Its bodies.
    pub rigid_bodies: &'a [RigidBody],
    /// Its markers.
    pub markers: &'a [LabelledMarker],
}

/// A labelled marker.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LabelledMarker {
    /// Its id: model in the upper half, member in the lower.
    pub id: i32,
    /// Position in metres.
    pub position_m: [f32; 3],
    /// Diameter in metres.
    pub size_m: f32,
    /// Parameter bits.
    pub params: u16,
    /// Residual in metres (from 3.0 on).
    pub residual_m: f32,
}

/// A force plate or another device: channels of samples.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AnalogDevice<'a> {
    /// Its id.
    pub id: i32,
    /// The samples of each channel.
    pub channels: &'a [&'a [f32]],
}

/// Encodes one frame.
///
/// # Errors
/// The buffer is too small, a name contains a NUL, or a section that is not
/// empty does not exist in `version`.
pub fn frame(
    version: BitstreamVersion,
    content: &FrameContent<'_>,
    out: &mut [u8],
) -> Result<usize, EncodeError> {
    let mut encoder = FrameEncoder {
        writer: Writer::message(out, MessageId::Frame),
        version,
        body_markers: content.body_markers,
    };
    encoder.writer.i32(content.number, "frame number");
    encoder.sections(content);
    encoder.tail(content);
    encoder.writer.finish()
}

struct FrameEncoder<'a, 'c> {
    writer: Writer<'a>,
    version: BitstreamVersion,
    body_markers: &'c [BodyMarker],
}

impl FrameEncoder<'_, '_> {
    fn sections(&mut self, content: &FrameContent<'_>) {
        let Sections {
            marker_sets,
            other_markers,
            skeletons,
            assets,
            labelled_markers,
            force_plates,
            devices,
        } = content.sections;
        let version = self.version;
        self.section(marker_sets, "marker sets", |encoder, set| {
            encoder
                .writer
                .c_bytes(set.name.as_bytes(), "marker set name");
            encoder.writer.count(set.markers_m.len(), "marker count");
            encoder.writer.f32s(set.markers_m.as_flattened(), "marker");
        });
        self.section(other_markers, "other markers", |encoder, marker| {
            encoder.writer.f32s(marker, "other marker");
        });
        self.section(content.rigid_bodies, "rigid bodies", Self::rigid_body);
        self.section(skeletons, "skeletons", |encoder, skeleton| {
            encoder.writer.i32(skeleton.id, "skeleton id");
            encoder.rigid_bodies(skeleton.bones);
        });
        self.section_if(version.has_assets(), assets, "assets", |encoder, asset| {
            encoder.writer.i32(asset.id, "asset id");
            encoder.rigid_bodies(asset.rigid_bodies);
            let markers = asset.markers;
            encoder.writer.count(markers.len(), "asset marker count");
            markers
                .iter()
                .for_each(|marker| encoder.labelled_marker(marker));
        });
        self.section(labelled_markers, "labelled markers", Self::labelled_marker);
        for (exists, devices, field) in [
            (version.has_force_plates(), force_plates, "force plates"),
            (version.has_devices(), devices, "devices"),
        ] {
            self.section_if(exists, devices, field, Self::analog_device);
        }
    }

    fn tail(&mut self, content: &FrameContent<'_>) {
        let writer = &mut self.writer;
        if self.version.has_latency() {
            writer.f32(content.latency, "latency");
        }
        for word in content.timecode {
            writer.u32(word, "timecode");
        }
        writer.bytes(&content.timestamp_s.to_le_bytes(), "timestamp");
        if self.version.has_camera_ticks() {
            writer.u64(content.ticks.mid_exposure, "mid-exposure ticks");
            writer.u64(content.ticks.received, "received ticks");
            writer.u64(content.ticks.transmit, "transmit ticks");
        }
        if self.version.has_precision_time() {
            writer.u32(content.precision_time.seconds, "precision seconds");
            writer.u32(content.precision_time.fraction, "precision fraction");
        }
        writer.u16(content.flags.0, "frame flags");
        writer.i32(0, "end tag");
    }

    fn section<T>(&mut self, entries: &[T], field: &'static str, write: impl Fn(&mut Self, &T)) {
        self.writer.count(entries.len(), field);
        let sized = self.version.has_section_sizes();
        let slot = sized.then(|| self.writer.size_slot(field));
        entries.iter().for_each(|entry| write(self, entry));
        if let Some(slot) = slot {
            self.writer.fill(slot, field);
        }
    }

    /// A section that some versions do not have.
    fn section_if<T>(
        &mut self,
        exists: bool,
        entries: &[T],
        field: &'static str,
        write: impl Fn(&mut Self, &T),
    ) {
        if exists {
            self.section(entries, field, write);
        } else if !entries.is_empty() {
            let version = self.version;
            self.writer
                .fail(EncodeError::NotInVersion { field, version });
        }
    }

    fn rigid_bodies(&mut self, bodies: &[RigidBody]) {
        self.writer.count(bodies.len(), "rigid body count");
        bodies.iter().for_each(|body| self.rigid_body(body));
    }

    fn rigid_body(&mut self, body: &RigidBody) {
        let writer = &mut self.writer;
        writer.i32(body.id, "rigid body id");
        writer.f32s(&body.position_m, "rigid body position");
        writer.f32s(&body.orientation_xyzw, "rigid body orientation");
        if self.version.has_markers_in_bodies() {
            writer.count(self.body_markers.len(), "rigid body marker count");
            for marker in self.body_markers {
                writer.f32s(&marker.position_m, "rigid body marker position");
            }
            for marker in self.body_markers {
                writer.i32(marker.id, "rigid body marker id");
            }
            for marker in self.body_markers {
                writer.f32(marker.size_m, "rigid body marker size");
            }
        }
        writer.f32(body.mean_error_m, "rigid body mean error");
        writer.u16(body.params, "rigid body parameters");
    }

    fn labelled_marker(&mut self, marker: &LabelledMarker) {
        let writer = &mut self.writer;
        writer.i32(marker.id, "labelled marker id");
        writer.f32s(&marker.position_m, "labelled marker position");
        writer.f32(marker.size_m, "labelled marker size");
        writer.u16(marker.params, "labelled marker parameters");
        if self.version.has_marker_residual() {
            writer.f32(marker.residual_m, "labelled marker residual");
        }
    }

    fn analog_device(&mut self, device: &AnalogDevice<'_>) {
        self.writer.i32(device.id, "analog device id");
        self.writer.count(device.channels.len(), "channel count");
        for samples in device.channels {
            self.writer.count(samples.len(), "sample count");
            self.writer.f32s(samples, "samples");
        }
    }
}

/// Writes a message. [`finish`](Self::finish) returns the first error; nothing is written after it.
pub(super) struct Writer<'a> {
    out: &'a mut [u8],
    len: usize,
    error: Option<EncodeError>,
}

impl<'a> Writer<'a> {
    /// Begins a message; its length is filled in by [`finish`](Self::finish).
    pub(super) fn message(out: &'a mut [u8], id: MessageId) -> Self {
        let (len, error) = (0, None);
        let mut writer = Self { out, len, error };
        writer.u16(id as u16, "message id");
        writer.u16(0, "payload length");
        writer
    }

    /// Completes the header and returns the datagram's length.
    pub(super) fn finish(self) -> Result<usize, EncodeError> {
        if let Some(error) = self.error {
            return Err(error);
        }
        let too_long = EncodeError::TooLong {
            len: self.len,
            max: MAX_DATAGRAM_LEN,
        };
        if self.len > MAX_DATAGRAM_LEN {
            return Err(too_long);
        }
        let payload = u16::try_from(self.len.saturating_sub(HEADER_LEN)).map_err(|_| too_long)?;
        if let Some(slot) = self.out.get_mut(2..4) {
            slot.copy_from_slice(&payload.to_le_bytes());
        }
        Ok(self.len)
    }

    pub(super) fn fail(&mut self, error: EncodeError) {
        self.error.get_or_insert(error);
    }

    pub(super) fn bytes(&mut self, bytes: &[u8], field: &'static str) {
        let capacity = self.out.len();
        let end = self.len.saturating_add(bytes.len());
        match self.out.get_mut(self.len..end) {
            Some(slot) if self.error.is_none() => {
                slot.copy_from_slice(bytes);
                self.len = end;
            }
            _ => self.fail(EncodeError::BufferTooSmall { field, capacity }),
        }
    }

    pub(super) fn u8(&mut self, value: u8, field: &'static str) {
        self.bytes(&[value], field);
    }

    pub(super) fn u16(&mut self, value: u16, field: &'static str) {
        self.bytes(&value.to_le_bytes(), field);
    }

    pub(super) fn u32(&mut self, value: u32, field: &'static str) {
        self.bytes(&value.to_le_bytes(), field);
    }

    pub(super) fn i32(&mut self, value: i32, field: &'static str) {
        self.bytes(&value.to_le_bytes(), field);
    }

    pub(super) fn u64(&mut self, value: u64, field: &'static str) {
        self.bytes(&value.to_le_bytes(), field);
    }

    pub(super) fn f32(&mut self, value: f32, field: &'static str) {
        self.bytes(&value.to_le_bytes(), field);
    }

    pub(super) fn f32s(&mut self, values: &[f32], field: &'static str) {
        values.iter().for_each(|value| self.f32(*value, field));
    }

    pub(super) fn count(&mut self, value: usize, field: &'static str) {
        match i32::try_from(value) {
            Ok(count) => self.i32(count, field),
            Err(_) => self.fail(EncodeError::CountOutOfRange { field, value }),
        }
    }

    /// A text, and the NUL that ends it.
    pub(super) fn c_bytes(&mut self, text: &[u8], field: &'static str) {
        if text.contains(&0) {
            self.fail(EncodeError::InteriorNul { field });
        }
        self.bytes(text, field);
        self.u8(0, field);
    }

    /// A name in a field of `N` bytes, padded with zeros, NUL included.
    pub(super) fn padded_name<const N: usize>(&mut self, name: &str, field: &'static str) {
        let (len, max) = (name.len(), N.saturating_sub(1));
        if name.contains('\0') {
            self.fail(EncodeError::InteriorNul { field });
        }
        let mut padded = [0; N];
        match padded.get_mut(..len) {
            Some(slot) if len <= max => slot.copy_from_slice(name.as_bytes()),
            _ => self.fail(EncodeError::NameTooLong { field, len, max }),
        }
        self.bytes(&padded, field);
    }

    /// Leaves room for the size of the part that follows, and returns the part's place.
    pub(super) fn size_slot(&mut self, field: &'static str) -> usize {
        self.i32(0, field);
        self.len
    }

    /// Fills in the size of the part that begins at `start`, by [`size_slot`](Self::size_slot).
    pub(super) fn fill(&mut self, start: usize, field: &'static str) {
        let value = self.len.saturating_sub(start);
        let before = self.out.get_mut(..start);
        let slot = before.and_then(|before| before.last_chunk_mut());
        match (i32::try_from(value), slot) {
            (Ok(size), Some(slot)) if self.error.is_none() => *slot = size.to_le_bytes(),
            _ => self.fail(EncodeError::CountOutOfRange { field, value }),
        }
    }
}
