//! Encodes FRAMEOFDATA, with a bounded little-endian cursor that can fill in sizes afterwards.

use super::{EncodeError, Encoded};
use crate::codec::{
    BitstreamVersion, CameraTicks, FrameFlags, HEADER_LEN, MAX_DATAGRAM_LEN, MessageId, RigidBody,
};

/// The content of a frame. A field that the version does not have is left out: ticks
/// before 3.0, latency from 3.0 on. All other sections are empty, and other times zero.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct FrameContent<'a> {
    /// The frame's number.
    pub number: i32,
    /// Named sets of markers.
    pub marker_sets: &'a [MarkerSet<'a>],
    /// The rigid bodies, tracked or not.
    pub rigid_bodies: &'a [RigidBody],
    /// Labelled markers.
    pub labelled_markers: &'a [LabelledMarker],
    /// Time of the frame in seconds.
    pub timestamp_s: f64,
    /// Exposure, reception and transmission in ticks (from 3.0 on).
    pub ticks: CameraTicks,
    /// Latency (before 3.0).
    pub latency: f32,
    /// The frame's flags.
    pub flags: FrameFlags,
}

/// A named set of markers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MarkerSet<'a> {
    /// Its name.
    pub name: &'a str,
    /// Positions in metres.
    pub markers_m: &'a [[f32; 3]],
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

/// Encodes one frame.
///
/// # Errors
/// The buffer is too small, or a name contains a NUL.
pub fn frame(version: BitstreamVersion, content: &FrameContent<'_>, out: &mut [u8]) -> Encoded {
    let mut writer = Writer::new(out);
    writer.i32(content.number, "frame number");
    let sets = content.marker_sets;
    writer.section(version, sets, "marker sets", |writer, set| {
        writer.c_bytes(set.name.as_bytes(), "marker set name");
        writer.count(set.markers_m.len(), "marker count");
        writer.f32s(set.markers_m.as_flattened(), "marker");
    });
    writer.empty(version, "other markers");
    let bodies = content.rigid_bodies;
    writer.section(version, bodies, "rigid bodies", |writer, body| {
        writer.i32(body.id, "rigid body id");
        writer.f32s(&body.position_m, "rigid body position");
        writer.f32s(&body.orientation_xyzw, "rigid body orientation");
        if version < BitstreamVersion::V3_0 {
            writer.count(0, "rigid body marker count");
        }
        writer.f32(body.mean_error_m, "rigid body mean error");
        writer.u16(body.params, "rigid body parameters");
    });
    writer.empty(version, "skeletons");
    if version >= BitstreamVersion::V4_1 {
        writer.empty(version, "assets");
    }
    let labelled = content.labelled_markers;
    writer.section(version, labelled, "labelled markers", |writer, marker| {
        writer.i32(marker.id, "labelled marker id");
        writer.f32s(&marker.position_m, "labelled marker position");
        writer.f32(marker.size_m, "labelled marker size");
        writer.u16(marker.params, "labelled marker parameters");
        if version >= BitstreamVersion::V3_0 {
            writer.f32(marker.residual_m, "labelled marker residual");
        }
    });
    if version >= BitstreamVersion::V2_9 {
        writer.empty(version, "force plates");
    }
    if version >= BitstreamVersion::V2_11 {
        writer.empty(version, "devices");
    }
    if version < BitstreamVersion::V3_0 {
        writer.f32(content.latency, "latency");
    }
    writer.u64(0, "timecode");
    writer.bytes(&content.timestamp_s.to_le_bytes(), "timestamp");
    if version >= BitstreamVersion::V3_0 {
        writer.u64(content.ticks.mid_exposure, "mid-exposure ticks");
        writer.u64(content.ticks.received, "received ticks");
        writer.u64(content.ticks.transmit, "transmit ticks");
    }
    if version >= BitstreamVersion::V4_1 {
        writer.u64(0, "precision time");
    }
    writer.u16(content.flags.0, "frame flags");
    writer.i32(0, "end tag");
    writer.finish(MessageId::Frame)
}

/// Writes a message. [`finish`](Self::finish) returns the first error; nothing is written after it.
pub(super) struct Writer<'a> {
    out: &'a mut [u8],
    len: usize,
    error: Option<EncodeError>,
}

impl<'a> Writer<'a> {
    /// Begins a message, with room for the header.
    pub(super) fn new(out: &'a mut [u8]) -> Self {
        let (len, error) = (0, None);
        let mut writer = Self { out, len, error };
        writer.u16(0, "message id");
        writer.u16(0, "payload length");
        writer
    }

    /// Fills in the header and returns the datagram's length.
    pub(super) fn finish(self, id: MessageId) -> Encoded {
        if let Some(error) = self.error {
            return Err(error);
        }
        if self.len > MAX_DATAGRAM_LEN {
            return Err(EncodeError::CountOutOfRange {
                field: "message",
                value: self.len,
            });
        }
        // No datagram is as long as the number allows.
        let payload = self.len.saturating_sub(HEADER_LEN) as u16;
        if let Some((header, _)) = self.out.split_first_chunk_mut() {
            let ([a, b], [c, d]) = ((id as u16).to_le_bytes(), payload.to_le_bytes());
            *header = [a, b, c, d];
        }
        Ok(self.len)
    }

    fn fail(&mut self, error: EncodeError) {
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

    /// Writes one section of a frame.
    fn section<T>(
        &mut self,
        version: BitstreamVersion,
        entries: &[T],
        field: &'static str,
        write: impl Fn(&mut Self, &T),
    ) {
        self.count(entries.len(), field);
        self.sized(version, field, |writer| {
            entries.iter().for_each(|entry| write(writer, entry));
        });
    }

    fn empty(&mut self, version: BitstreamVersion, field: &'static str) {
        self.section::<()>(version, &[], field, |_, ()| {});
    }

    /// Writes a part, before it its size if the version has one.
    pub(super) fn sized(
        &mut self,
        version: BitstreamVersion,
        field: &'static str,
        write: impl FnOnce(&mut Self),
    ) {
        if version < BitstreamVersion::V4_1 {
            return write(self);
        }
        self.i32(0, field);
        let start = self.len;
        write(self);
        let value = self.len.saturating_sub(start);
        let before = self.out.get_mut(..start);
        let slot = before.and_then(|before| before.last_chunk_mut());
        match (i32::try_from(value), slot) {
            (Ok(size), Some(slot)) if self.error.is_none() => *slot = size.to_le_bytes(),
            _ => self.fail(EncodeError::CountOutOfRange { field, value }),
        }
    }
}
