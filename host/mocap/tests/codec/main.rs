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
    encode::{
        self, AnalogDevice, Asset, BodyMarker, FrameContent, LabelledMarker, MarkerSet, Sections,
        Skeleton,
    },
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

/// The content of a frame, owned.
#[derive(Clone, Debug)]
pub(crate) struct AnyFrame {
    pub(crate) number: i32,
    pub(crate) rigid_bodies: Vec<RigidBody>,
    body_markers: Vec<BodyMarker>,
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
        let at_least = |major, minor| version >= BitstreamVersion::new(major, minor).unwrap();
        let marker_sets: Vec<_> = self
            .marker_sets
            .iter()
            .map(|(name, markers_m)| MarkerSet { name, markers_m })
            .collect();
        let skeletons: Vec<_> = self
            .skeletons
            .iter()
            .map(|(id, bones)| Skeleton { id: *id, bones })
            .collect();
        let assets: Vec<_> = self
            .assets
            .iter()
            .filter(|_| at_least(4, 1))
            .map(|(id, rigid_bodies, markers)| Asset {
                id: *id,
                rigid_bodies,
                markers,
            })
            .collect();
        let force_plate_channels = channels(&self.force_plates, at_least(2, 9));
        let device_channels = channels(&self.devices, at_least(2, 11));
        encoded(|out| {
            let content = FrameContent {
                number: self.number,
                rigid_bodies: &self.rigid_bodies,
                body_markers: &self.body_markers,
                sections: Sections {
                    marker_sets: &marker_sets,
                    other_markers: &self.other_markers,
                    skeletons: &skeletons,
                    assets: &assets,
                    labelled_markers: &self.labelled_markers,
                    force_plates: &analog_devices(&force_plate_channels),
                    devices: &analog_devices(&device_channels),
                },
                timecode: self.timecode,
                timestamp_s: self.timestamp_s,
                ticks: self.ticks,
                precision_time: self.precision_time,
                latency: self.latency,
                flags: self.flags,
            };
            encode::frame(version, &content, out)
        })
    }
}

fn channels(devices: &[(i32, Vec<Vec<f32>>)], exists: bool) -> Vec<(i32, Vec<&[f32]>)> {
    devices
        .iter()
        .filter(|_| exists)
        .map(|(id, channels)| (*id, channels.iter().map(Vec::as_slice).collect()))
        .collect()
}

fn analog_devices<'a>(devices: &'a [(i32, Vec<&'a [f32]>)]) -> Vec<AnalogDevice<'a>> {
    devices
        .iter()
        .map(|(id, channels)| AnalogDevice { id: *id, channels })
        .collect()
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
    (vector(), any::<i32>(), number()).prop_map(|(position_m, id, size_m)| BodyMarker {
        position_m,
        id,
        size_m,
    })
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
