//! Encodes MODELDEF.

use super::{error::EncodeError, writer::Writer};
use crate::codec::{BitstreamVersion, MessageId, RigidBodyDefinition, dataset};

/// One entry of the model definitions.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Dataset<'a> {
    /// A rigid body.
    RigidBody {
        /// Name, ids, offset.
        definition: RigidBodyDefinition<'a>,
        /// Its markers. Versions before 3.0 do not carry them.
        markers: &'a [DefinitionMarker<'a>],
    },
    /// A named set of markers.
    MarkerSet {
        /// Its name.
        name: &'a str,
        /// Its markers' names.
        marker_names: &'a [&'a str],
    },
    /// A skeleton, of bones without markers.
    Skeleton {
        /// Its name.
        name: &'a str,
        /// Its id.
        id: i32,
        /// Its bones.
        bones: &'a [RigidBodyDefinition<'a>],
    },
    /// Another dataset, already encoded.
    Other {
        /// The dataset's type.
        type_id: i32,
        /// The bytes after type and size.
        body: &'a [u8],
    },
}

/// A marker of a rigid-body definition.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DefinitionMarker<'a> {
    /// Position in the body, in metres.
    pub position_m: [f32; 3],
    /// The active label, or 0.
    pub label: i32,
    /// Its name. Versions before 4.0 do not carry it.
    pub name: &'a str,
}

/// Encodes the answer to a request for model definitions.
///
/// # Errors
/// The buffer is too small, or a name contains a NUL.
pub fn model_definitions(
    version: BitstreamVersion,
    datasets: &[Dataset<'_>],
    out: &mut [u8],
) -> Result<usize, EncodeError> {
    let mut writer = Writer::message(out, MessageId::ModelDefinitions)?;
    writer.count(datasets.len(), "dataset count")?;
    for dataset in datasets {
        writer.i32(dataset.type_id(), "dataset type")?;
        if version.has_section_sizes() {
            let slot = writer.size_slot("dataset size")?;
            dataset.write(&mut writer, version)?;
            writer.fill(slot, "dataset size")?;
        } else {
            dataset.write(&mut writer, version)?;
        }
    }
    writer.finish()
}

impl<'a> Dataset<'a> {
    /// A rigid body's definition without markers.
    #[must_use]
    pub const fn rigid_body(definition: RigidBodyDefinition<'a>) -> Self {
        Self::RigidBody {
            definition,
            markers: &[],
        }
    }

    const fn type_id(&self) -> i32 {
        match self {
            Self::MarkerSet { .. } => dataset::MARKER_SET,
            Self::RigidBody { .. } => dataset::RIGID_BODY,
            Self::Skeleton { .. } => dataset::SKELETON,
            Self::Other { type_id, .. } => *type_id,
        }
    }

    fn write(&self, writer: &mut Writer<'_>, version: BitstreamVersion) -> Result<(), EncodeError> {
        match self {
            Self::RigidBody {
                definition,
                markers,
            } => write_rigid_body(writer, version, definition, markers),
            Self::MarkerSet { name, marker_names } => {
                writer.c_str(name, "marker set name")?;
                writer.count(marker_names.len(), "marker name count")?;
                marker_names
                    .iter()
                    .try_for_each(|name| writer.c_str(name, "marker name"))
            }
            Self::Skeleton { name, id, bones } => {
                writer.c_str(name, "skeleton name")?;
                writer.i32(*id, "skeleton id")?;
                writer.count(bones.len(), "bone count")?;
                bones
                    .iter()
                    .try_for_each(|bone| write_rigid_body(writer, version, bone, &[]))
            }
            Self::Other { body, .. } => writer.bytes(body, "dataset"),
        }
    }
}

fn write_rigid_body(
    writer: &mut Writer<'_>,
    version: BitstreamVersion,
    definition: &RigidBodyDefinition<'_>,
    markers: &[DefinitionMarker<'_>],
) -> Result<(), EncodeError> {
    writer.c_bytes(definition.name, "rigid body name")?;
    writer.i32(definition.id, "rigid body id")?;
    writer.i32(definition.parent_id, "rigid body parent")?;
    writer.f32s(&definition.offset_m, "rigid body offset")?;
    if version.has_definition_rotation() {
        writer.f32s(&[0.0, 0.0, 0.0, 1.0], "rigid body rotation")?;
    }
    if version.has_definition_markers() {
        writer.count(markers.len(), "definition marker count")?;
        for marker in markers {
            writer.f32s(&marker.position_m, "definition marker position")?;
        }
        for marker in markers {
            writer.i32(marker.label, "definition marker label")?;
        }
        if version.has_definition_marker_names() {
            for marker in markers {
                writer.c_str(marker.name, "definition marker name")?;
            }
        }
    }
    Ok(())
}
