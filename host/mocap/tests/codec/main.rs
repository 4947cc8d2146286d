//! The codec: encoded messages are decoded to the same values, damaged ones are
//! refused, and other implementations agree in both directions.

#![expect(
    clippy::unwrap_used,
    clippy::panic,
    reason = "test helpers fail the test that calls them"
)]

mod interoperability;
mod messages;
mod models;
mod round_trip;

use proptest::{collection::vec, prelude::*};
use singletrack_mocap::{
    codec::{BitstreamVersion, CameraTicks, FrameFlags, PrecisionTime, RigidBody},
    encode::LabelledMarker,
};

/// Every named version, and one after 2.11.
fn all_versions() -> Vec<BitstreamVersion> {
    [
        (2, 7),
        (2, 8),
        (2, 9),
        (2, 10),
        (2, 11),
        (3, 0),
        (3, 1),
        (4, 0),
        (4, 1),
        (4, 2),
        (4, 3),
        (4, 4),
    ]
    .into_iter()
    .map(|(major, minor)| BitstreamVersion::new(major, minor).unwrap())
    .collect()
}

/// The datagram with the length in its header corrected.
fn with_fitting_header(mut datagram: Vec<u8>) -> Vec<u8> {
    let len = u16::try_from(datagram.len() - 4).unwrap();
    datagram[2..4].copy_from_slice(&len.to_le_bytes());
    datagram
}

/// The output of an encoder for a sufficient buffer.
fn encoded<E: core::fmt::Debug>(encode: impl FnOnce(&mut [u8]) -> Result<usize, E>) -> Vec<u8> {
    let mut buffer = vec![0xAA; 65_536];
    let len = encode(&mut buffer).unwrap();
    buffer.truncate(len);
    buffer
}

/// Whether a version is at least this one.
pub(crate) fn at_least(version: BitstreamVersion, major: u8, minor: u8) -> bool {
    version >= BitstreamVersion::new(major, minor).unwrap()
}

/// A datagram in the making, with whatever servers send.
pub(crate) struct Draft {
    bytes: Vec<u8>,
    pub(crate) version: BitstreamVersion,
}

impl Draft {
    pub(crate) fn new(id: u16, version: BitstreamVersion) -> Self {
        let mut bytes = id.to_le_bytes().to_vec();
        bytes.extend([0, 0]);
        Self { bytes, version }
    }

    pub(crate) fn finished(self) -> Vec<u8> {
        with_fitting_header(self.bytes)
    }

    pub(crate) fn at_least(&self, major: u8, minor: u8) -> bool {
        at_least(self.version, major, minor)
    }

    pub(crate) fn bytes(&mut self, bytes: &[u8]) {
        self.bytes.extend_from_slice(bytes);
    }

    pub(crate) fn i32(&mut self, value: i32) {
        self.bytes(&value.to_le_bytes());
    }

    pub(crate) fn f32s(&mut self, values: &[f32]) {
        values.iter().for_each(|it| self.bytes(&it.to_le_bytes()));
    }

    pub(crate) fn text(&mut self, text: &str) {
        self.bytes(text.as_bytes());
        self.bytes(&[0]);
    }

    /// The number of entries, then each.
    pub(crate) fn list<T>(&mut self, entries: &[T], write: impl Fn(&mut Self, &T)) {
        self.i32(i32::try_from(entries.len()).unwrap());
        entries.iter().for_each(|entry| write(self, entry));
    }

    /// What `write` writes, after its size from 4.1 on.
    pub(crate) fn sized(&mut self, write: impl FnOnce(&mut Self)) {
        let mut part = Self {
            bytes: vec![],
            version: self.version,
        };
        write(&mut part);
        if self.at_least(4, 1) {
            self.i32(i32::try_from(part.bytes.len()).unwrap());
        }
        self.bytes(&part.bytes);
    }

    fn section<T>(&mut self, entries: &[T], write: impl Fn(&mut Self, &T)) {
        self.i32(i32::try_from(entries.len()).unwrap());
        self.sized(|part| entries.iter().for_each(|entry| write(part, entry)));
    }

    fn labelled_marker(&mut self, marker: &LabelledMarker) {
        self.i32(marker.id);
        self.f32s(&marker.position_m);
        self.f32s(&[marker.size_m]);
        self.bytes(&marker.params.to_le_bytes());
        if self.at_least(3, 0) {
            self.f32s(&[marker.residual_m]);
        }
    }

    fn analog_device(&mut self, (id, channels): &(i32, Vec<Vec<f32>>)) {
        self.i32(*id);
        self.list(channels, |draft, samples| {
            draft.list(samples, |draft, sample| draft.f32s(&[*sample]));
        });
    }
}

/// A marker of a body, before 3.0: position, id, size.
pub(crate) type BodyMarker = ([f32; 3], i32, f32);

/// The content of a frame, owned.
#[derive(Clone, Debug)]
pub(crate) struct AnyFrame {
    pub(crate) number: i32,
    pub(crate) rigid_bodies: Vec<RigidBody>,
    pub(crate) body_markers: Vec<BodyMarker>,
    pub(crate) marker_sets: Vec<(String, Vec<[f32; 3]>)>,
    pub(crate) other_markers: Vec<[f32; 3]>,
    pub(crate) skeletons: Vec<(i32, Vec<RigidBody>)>,
    pub(crate) assets: Vec<(i32, Vec<RigidBody>, Vec<LabelledMarker>)>,
    pub(crate) labelled_markers: Vec<LabelledMarker>,
    pub(crate) force_plates: Vec<(i32, Vec<Vec<f32>>)>,
    pub(crate) devices: Vec<(i32, Vec<Vec<f32>>)>,
    pub(crate) timecode: [u32; 2],
    pub(crate) timestamp_s: f64,
    pub(crate) ticks: CameraTicks,
    pub(crate) precision_time: PrecisionTime,
    pub(crate) latency: f32,
    pub(crate) flags: FrameFlags,
}

impl AnyFrame {
    /// The frame in a version, without the sections that the version does not have.
    pub(crate) fn encode(&self, version: BitstreamVersion) -> Vec<u8> {
        let mut draft = Draft::new(7, version);
        let body = |draft: &mut Draft, body: &RigidBody| self.rigid_body(draft, body);
        draft.i32(self.number);
        draft.section(&self.marker_sets, |draft, (name, markers)| {
            draft.text(name);
            draft.list(markers, |draft, marker| draft.f32s(marker));
        });
        draft.section(&self.other_markers, |draft, marker| draft.f32s(marker));
        draft.section(&self.rigid_bodies, body);
        draft.section(&self.skeletons, |draft, (id, bones)| {
            draft.i32(*id);
            draft.list(bones, body);
        });
        if draft.at_least(4, 1) {
            draft.section(&self.assets, |draft, (id, bodies, markers)| {
                draft.i32(*id);
                draft.list(bodies, body);
                draft.list(markers, Draft::labelled_marker);
            });
        }
        draft.section(&self.labelled_markers, Draft::labelled_marker);
        if draft.at_least(2, 9) {
            draft.section(&self.force_plates, Draft::analog_device);
        }
        if draft.at_least(2, 11) {
            draft.section(&self.devices, Draft::analog_device);
        }
        if !draft.at_least(3, 0) {
            draft.f32s(&[self.latency]);
        }
        for word in self.timecode {
            draft.bytes(&word.to_le_bytes());
        }
        draft.bytes(&self.timestamp_s.to_le_bytes());
        if draft.at_least(3, 0) {
            let CameraTicks {
                mid_exposure,
                received,
                transmit,
            } = self.ticks;
            for ticks in [mid_exposure, received, transmit] {
                draft.bytes(&ticks.to_le_bytes());
            }
        }
        if draft.at_least(4, 1) {
            draft.bytes(&self.precision_time.seconds.to_le_bytes());
            draft.bytes(&self.precision_time.fraction.to_le_bytes());
        }
        draft.bytes(&self.flags.0.to_le_bytes());
        draft.i32(0);
        draft.finished()
    }

    fn rigid_body(&self, draft: &mut Draft, body: &RigidBody) {
        draft.i32(body.id);
        draft.f32s(&body.position_m);
        draft.f32s(&body.orientation_xyzw);
        if !draft.at_least(3, 0) {
            let markers = &self.body_markers;
            draft.list(markers, |draft, (position_m, ..)| draft.f32s(position_m));
            markers.iter().for_each(|(_, id, _)| draft.i32(*id));
            markers
                .iter()
                .for_each(|(.., size_m)| draft.f32s(&[*size_m]));
        }
        draft.f32s(&[body.mean_error_m]);
        draft.bytes(&body.params.to_le_bytes());
    }
}

pub(crate) fn number() -> impl Strategy<Value = f32> {
    use proptest::num::f32::{NEGATIVE, NORMAL, POSITIVE, ZERO};
    NORMAL | ZERO | POSITIVE | NEGATIVE
}

fn vector() -> impl Strategy<Value = [f32; 3]> {
    [number(), number(), number()]
}

pub(crate) fn rigid_body() -> impl Strategy<Value = RigidBody> {
    (
        any::<i32>(),
        vector(),
        [number(), number(), number(), number()],
        number(),
        any::<u16>(),
    )
        .prop_map(
            |(id, position_m, orientation_xyzw, mean_error_m, params)| RigidBody {
                id,
                position_m,
                orientation_xyzw,
                mean_error_m,
                params,
            },
        )
}

fn labelled_marker() -> impl Strategy<Value = LabelledMarker> {
    (any::<i32>(), vector(), number(), any::<u16>(), number()).prop_map(
        |(id, position_m, size_m, params, residual_m)| LabelledMarker {
            id,
            position_m,
            size_m,
            params,
            residual_m,
        },
    )
}

fn body_marker() -> impl Strategy<Value = BodyMarker> {
    (vector(), any::<i32>(), number())
}

fn analog() -> impl Strategy<Value = Vec<(i32, Vec<Vec<f32>>)>> {
    vec((any::<i32>(), vec(vec(number(), 0..4), 0..4)), 0..3)
}

pub(crate) fn name() -> impl Strategy<Value = String> {
    "[a-zA-Z0-9_ äß車]{0,12}"
}

pub(crate) fn any_frame() -> impl Strategy<Value = AnyFrame> {
    let markers = (
        vec((name(), vec(vector(), 0..4)), 0..3),
        vec(vector(), 0..4),
        vec(labelled_marker(), 0..5),
        vec(body_marker(), 0..4),
    );
    let bodies = (
        vec(rigid_body(), 0..6),
        vec((any::<i32>(), vec(rigid_body(), 0..3)), 0..3),
        vec(
            (
                any::<i32>(),
                vec(rigid_body(), 0..3),
                vec(labelled_marker(), 0..3),
            ),
            0..3,
        ),
    );
    let times = (
        any::<[u32; 2]>(),
        proptest::num::f64::NORMAL,
        any::<(u64, u64, u64)>(),
        any::<(u32, u32)>(),
        number(),
    );
    (
        any::<i32>(),
        markers,
        bodies,
        (analog(), analog()),
        times,
        any::<u16>(),
    )
        .prop_map(
            |(number, markers, bodies, (force_plates, devices), times, flags)| {
                let (marker_sets, other_markers, labelled_markers, body_markers) = markers;
                let (rigid_bodies, skeletons, assets) = bodies;
                let (timecode, timestamp_s, ticks, precision, latency) = times;
                AnyFrame {
                    number,
                    rigid_bodies,
                    body_markers,
                    marker_sets,
                    other_markers,
                    skeletons,
                    assets,
                    labelled_markers,
                    force_plates,
                    devices,
                    timecode,
                    timestamp_s,
                    ticks: CameraTicks {
                        mid_exposure: ticks.0,
                        received: ticks.1,
                        transmit: ticks.2,
                    },
                    precision_time: PrecisionTime {
                        seconds: precision.0,
                        fraction: precision.1,
                    },
                    latency,
                    flags: FrameFlags(flags),
                }
            },
        )
}
