//! Model definitions.

use proptest::{collection::vec, prelude::*};
use singletrack_mocap::{
    codec::{BitstreamVersion, DecodeError, ModelDefinitions, RigidBodyDefinition, ServerMessage},
    encode::{self, Dataset},
};

use crate::{Draft, all_versions, encoded, name, number, with_fitting_header};

pub(crate) type OwnedBody = (String, i32, i32, [f32; 3]);

#[derive(Clone, Debug)]
pub(crate) enum OwnedDataset {
    RigidBody(OwnedBody, Vec<([f32; 3], i32, String)>),
    MarkerSet(String, Vec<String>),
    Skeleton(String, i32, Vec<OwnedBody>),
    ForcePlate,
    Device,
    Camera,
    /// Type and bytes.
    Other(i32, &'static [u8]),
}

fn body() -> impl Strategy<Value = OwnedBody> {
    (
        name(),
        any::<i32>(),
        any::<i32>(),
        [number(), number(), number()],
    )
}

fn dataset() -> impl Strategy<Value = OwnedDataset> {
    let marker = ([number(), number(), number()], any::<i32>(), name());
    prop_oneof![
        3 => (body(), vec(marker, 0..4))
            .prop_map(|(body, markers)| OwnedDataset::RigidBody(body, markers)),
        1 => (name(), vec(name(), 0..4))
            .prop_map(|(name, markers)| OwnedDataset::MarkerSet(name, markers)),
        1 => (name(), any::<i32>(), vec(body(), 0..4))
            .prop_map(|(name, id, bones)| OwnedDataset::Skeleton(name, id, bones)),
        1 => Just(OwnedDataset::ForcePlate),
        1 => Just(OwnedDataset::Device),
        1 => Just(OwnedDataset::Camera),
    ]
}

fn definition((name, id, parent_id, offset_m): &OwnedBody) -> RigidBodyDefinition<'_> {
    RigidBodyDefinition {
        name: name.as_bytes(),
        id: *id,
        parent_id: *parent_id,
        offset_m: *offset_m,
    }
}

/// id, serial, geometry, two types, two channels.
fn force_plate() -> Vec<u8> {
    let mut bytes = vec![1, 0, 0, 0, b'F', b'P', 0];
    bytes.resize(bytes.len() + (2 + 3 + 144 + 12) * 4 + 8, 0x11);
    bytes.extend_from_slice(b"\x02\0\0\0Fx\0Fy\0");
    bytes
}

/// id, name, serial, two types, one channel.
const DEVICE: &[u8] = b"\x05\0\0\0NI\x001234\0\x01\0\0\0\x02\0\0\0\x01\0\0\0ai0\0";

/// name, position, orientation.
fn camera() -> Vec<u8> {
    let mut bytes = b"Prime 13\0".to_vec();
    bytes.resize(bytes.len() + 7 * 4, 0x22);
    bytes
}

fn write_body(draft: &mut Draft, body: &OwnedBody, markers: &[([f32; 3], i32, String)]) {
    let (name, id, parent_id, offset_m) = body;
    draft.text(name);
    draft.i32(*id);
    draft.i32(*parent_id);
    draft.f32s(offset_m);
    if draft.at_least(4, 2) {
        draft.f32s(&[0.0, 0.0, 0.0, 1.0]);
    }
    if draft.at_least(3, 0) {
        draft.list(markers, |draft, (position_m, ..)| draft.f32s(position_m));
        markers.iter().for_each(|(_, label, _)| draft.i32(*label));
        if draft.at_least(4, 0) {
            markers.iter().for_each(|(.., name)| draft.text(name));
        }
    }
}

pub(crate) fn encode_all(datasets: &[OwnedDataset], version: BitstreamVersion) -> Vec<u8> {
    let mut draft = Draft::new(5, version);
    draft.list(datasets, |draft, dataset| {
        draft.i32(match dataset {
            OwnedDataset::MarkerSet(..) => 0,
            OwnedDataset::RigidBody(..) => 1,
            OwnedDataset::Skeleton(..) => 2,
            OwnedDataset::ForcePlate => 3,
            OwnedDataset::Device => 4,
            OwnedDataset::Camera => 5,
            OwnedDataset::Other(kind, _) => *kind,
        });
        draft.sized(|draft| match dataset {
            OwnedDataset::MarkerSet(name, names) => {
                draft.text(name);
                draft.list(names, |draft, name| draft.text(name));
            }
            OwnedDataset::RigidBody(body, markers) => write_body(draft, body, markers),
            OwnedDataset::Skeleton(name, id, bones) => {
                draft.text(name);
                draft.i32(*id);
                draft.list(bones, |draft, bone| write_body(draft, bone, &[]));
            }
            OwnedDataset::ForcePlate => draft.bytes(&force_plate()),
            OwnedDataset::Device => draft.bytes(DEVICE),
            OwnedDataset::Camera => draft.bytes(&camera()),
            OwnedDataset::Other(_, body) => draft.bytes(body),
        });
    });
    draft.finished()
}

fn decode(datagram: &[u8], version: BitstreamVersion) -> Result<ModelDefinitions<'_>, DecodeError> {
    match ServerMessage::decode(datagram, version)? {
        ServerMessage::ModelDefinitions(definitions) => Ok(definitions),
        other => panic!("not model definitions: {other:?}"),
    }
}

proptest! {
    #[test]
    fn the_rigid_bodies_of_any_definitions_are_found(datasets in vec(dataset(), 0..8)) {
        let expected: Vec<_> = datasets
            .iter()
            .filter_map(|dataset| match dataset {
                OwnedDataset::RigidBody(body, _) => Some(definition(body)),
                _ => None,
            })
            .collect();
        for version in all_versions() {
            let datagram = encode_all(&datasets, version);
            let definitions = decode(&datagram, version).unwrap();
            prop_assert_eq!(definitions.dataset_count, datasets.len());
            prop_assert_eq!(definitions.rigid_bodies().collect::<Vec<_>>(), expected.clone());
        }
    }

    #[test]
    fn the_encoder_writes_the_same_bytes(
        set in (name(), vec(name(), 0..4)),
        body in body(),
    ) {
        let (set_name, marker_names) = &set;
        let marker_names: Vec<_> = marker_names.iter().map(String::as_str).collect();
        let datasets = [
            Dataset::MarkerSet { name: set_name, marker_names: &marker_names },
            Dataset::RigidBody(definition(&body)),
        ];
        let own = [
            OwnedDataset::MarkerSet(set.0.clone(), set.1.clone()),
            OwnedDataset::RigidBody(body.clone(), vec![]),
        ];
        for version in all_versions() {
            let datagram = encoded(|out| encode::model_definitions(version, &datasets, out));
            prop_assert_eq!(datagram, encode_all(&own, version));
        }
    }

    #[test]
    fn every_strict_prefix_and_every_surplus_is_refused(datasets in vec(dataset(), 0..3)) {
        for version in all_versions() {
            let datagram = encode_all(&datasets, version);
            for len in 4..datagram.len() {
                let prefix = with_fitting_header(datagram[..len].to_vec());
                prop_assert!(decode(&prefix, version).is_err());
            }
            let mut longer = datagram;
            longer.push(0);
            let is_trailing = matches!(
                decode(&with_fitting_header(longer), version),
                Err(DecodeError::TrailingBytes { .. })
            );
            prop_assert!(is_trailing);
        }
    }

    #[test]
    fn random_damage_never_panics(
        datasets in vec(dataset(), 0..4),
        damage in vec((any::<prop::sample::Index>(), any::<u8>()), 1..8),
    ) {
        for version in all_versions() {
            let mut datagram = encode_all(&datasets, version);
            for (index, byte) in &damage {
                *index.get_mut(&mut datagram[4..]) = *byte;
            }
            if let Ok(ServerMessage::ModelDefinitions(definitions)) =
                ServerMessage::decode(&datagram, version)
            {
                prop_assert!(definitions.rigid_bodies().count() <= definitions.dataset_count);
            }
        }
    }
}

#[test]
fn an_unknown_dataset_is_skipped_by_size_or_refused_by_type() {
    let datasets = [
        OwnedDataset::Other(77, &[1, 2, 3, 4, 5]),
        OwnedDataset::RigidBody(("car".to_owned(), 4, -1, [0.0; 3]), vec![]),
    ];
    for version in all_versions() {
        let datagram = encode_all(&datasets, version);
        let definitions = decode(&datagram, version);
        if version >= BitstreamVersion::V4_1 {
            let ids: Vec<i32> = definitions
                .unwrap()
                .rigid_bodies()
                .map(|body| body.id)
                .collect();
            assert_eq!(ids, [4]);
        } else {
            assert_eq!(
                definitions.unwrap_err(),
                DecodeError::UnknownDataset {
                    offset: 8,
                    type_id: 77,
                    version
                }
            );
        }
    }
}

#[test]
fn a_definition_that_can_t_be_read_is_skipped_by_its_size() {
    let named = |name: &str, id| OwnedDataset::RigidBody((name.into(), id, -1, [0.0; 3]), vec![]);
    let datasets = [
        named("first", 1),
        // Its name has no end.
        OwnedDataset::Other(1, b"cut off"),
        named("T@r", 2),
        named("car", 3),
    ];
    for version in all_versions() {
        let mut datagram = encode_all(&datasets, version);
        // In another encoding than UTF-8.
        let at = datagram.iter().position(|byte| *byte == b'@').unwrap();
        datagram[at] = 0xfc;
        let definitions = decode(&datagram, version);
        if version < BitstreamVersion::V4_1 {
            assert!(definitions.is_err(), "{version}");
            continue;
        }
        let definitions = definitions.unwrap();
        assert!(matches!(
            definitions.unreadable,
            Some(DecodeError::UnterminatedString { .. })
        ));
        let bodies: Vec<_> = definitions
            .rigid_bodies()
            .map(|it| (it.id, it.name))
            .collect();
        assert_eq!(
            bodies,
            [(1, &b"first"[..]), (2, &b"T\xfcr"[..]), (3, &b"car"[..])]
        );
    }
}
