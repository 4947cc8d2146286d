//! MODELDEF: the models that the server tracks, with their names and ids.

use super::{
    BitstreamVersion,
    packet::{DecodeError, Decoded, Packet, Reader},
};

/// Dataset types of a model definition.
pub(crate) mod dataset {
    pub(crate) const MARKER_SET: i32 = 0;
    pub(crate) const RIGID_BODY: i32 = 1;
    pub(crate) const SKELETON: i32 = 2;
    pub(crate) const FORCE_PLATE: i32 = 3;
    pub(crate) const DEVICE: i32 = 4;
    pub(crate) const CAMERA: i32 = 5;
}

/// The definition of one rigid body.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RigidBodyDefinition<'a> {
    /// Its name, as in the server's asset list: bytes in the encoding of the server's computer, which
    /// is UTF-8 only by chance. [`NameText`](crate::NameText) shows it.
    pub name: &'a [u8],
    /// Its streaming id, as in the frames. The operator can change it.
    pub id: i32,
    /// Id of the parent body, or a negative number.
    pub parent_id: i32,
    /// Offset from the parent, in metres.
    pub offset_m: [f32; 3],
}

/// The definitions of all models that the server tracks.
#[derive(Clone, Debug)]
pub struct ModelDefinitions<'a> {
    /// Number of datasets, rigid bodies and others.
    pub dataset_count: usize,
    /// Why the first of those rigid bodies can't be read that have a size to skip them by; all others
    /// are listed.
    pub unreadable: Option<DecodeError>,
    rigid_bodies: RigidBodyDefinitions<'a>,
}

/// The rigid bodies among the definitions, in wire order.
#[derive(Clone, Debug)]
pub struct RigidBodyDefinitions<'a> {
    reader: Reader<'a>,
    datasets_left: usize,
    version: BitstreamVersion,
    unreadable: Option<DecodeError>,
}

impl<'a> ModelDefinitions<'a> {
    pub(super) fn decode(packet: &Packet<'a>, version: BitstreamVersion) -> Decoded<Self> {
        let mut reader = packet.reader();
        let is_sized = version >= BitstreamVersion::V4_1;
        let header_len = if is_sized { 8 } else { 4 };
        let dataset_count = reader.count(header_len, "dataset count")?;
        let rigid_bodies = RigidBodyDefinitions {
            reader,
            datasets_left: dataset_count,
            version,
            unreadable: None,
        };
        let mut walk = rigid_bodies.clone();
        while walk.datasets_left > 0 {
            walk.read_dataset()?;
        }
        walk.reader.finish("the model definitions")?;
        Ok(Self {
            dataset_count,
            unreadable: walk.unreadable,
            rigid_bodies,
        })
    }

    /// The rigid bodies. Bones of skeletons and bodies of assets are not listed.
    pub fn rigid_bodies(&self) -> RigidBodyDefinitions<'a> {
        self.rigid_bodies.clone()
    }
}

impl<'a> RigidBodyDefinitions<'a> {
    /// Reads one dataset; `Some` when it is a rigid body that can be read.
    fn read_dataset(&mut self) -> Decoded<Option<RigidBodyDefinition<'a>>> {
        self.datasets_left = self.datasets_left.saturating_sub(1);
        let version = self.version;
        let offset = self.reader.offset();
        let type_id = self.reader.i32("dataset type")?;
        if version >= BitstreamVersion::V4_1 {
            let mut body = self.reader.sized("dataset size")?;
            if type_id != dataset::RIGID_BODY {
                return Ok(None);
            }
            let read = read_rigid_body(&mut body, version);
            let whole = |read| body.finish("the rigid body definition").map(|()| read);
            let read = read.and_then(whole);
            // One that nobody needs must not take the others along.
            if let Err(error) = read {
                self.unreadable.get_or_insert(error);
            }
            return Ok(read.ok());
        }
        let reader = &mut self.reader;
        match type_id {
            dataset::RIGID_BODY => return read_rigid_body(reader, version).map(Some),
            dataset::MARKER_SET => {
                reader.c_bytes("marker set name")?;
                skip_names(reader, "marker name count")?;
            }
            dataset::SKELETON => {
                reader.c_bytes("skeleton name")?;
                reader.i32("skeleton id")?;
                for _ in 0..reader.count(21, "bone count")? {
                    read_rigid_body(reader, version)?;
                }
            }
            dataset::FORCE_PLATE => {
                reader.i32("force plate id")?;
                reader.c_bytes("force plate serial number")?;
                // Width, length, origin; calibration 12 x 12; four corners.
                reader.skip(5 + 144 + 12, 4, "force plate geometry")?;
                reader.i32("force plate type")?;
                reader.i32("force plate channel type")?;
                skip_names(reader, "force plate channel count")?;
            }
            dataset::DEVICE => {
                reader.i32("device id")?;
                reader.c_bytes("device name")?;
                reader.c_bytes("device serial number")?;
                reader.i32("device type")?;
                reader.i32("device channel type")?;
                skip_names(reader, "device channel count")?;
            }
            dataset::CAMERA => {
                reader.c_bytes("camera name")?;
                reader.skip(3 + 4, 4, "camera pose")?;
            }
            _ => {
                return Err(DecodeError::UnknownDataset {
                    offset,
                    type_id,
                    version,
                });
            }
        }
        Ok(None)
    }
}

impl<'a> Iterator for RigidBodyDefinitions<'a> {
    type Item = RigidBodyDefinition<'a>;

    fn next(&mut self) -> Option<RigidBodyDefinition<'a>> {
        while self.datasets_left > 0 {
            if let Some(definition) = self.read_dataset().ok()? {
                return Some(definition);
            }
        }
        None
    }
}

fn read_rigid_body<'a>(
    reader: &mut Reader<'a>,
    version: BitstreamVersion,
) -> Decoded<RigidBodyDefinition<'a>> {
    let definition = RigidBodyDefinition {
        name: reader.c_bytes("rigid body name")?,
        id: reader.i32("rigid body id")?,
        parent_id: reader.i32("rigid body parent")?,
        offset_m: reader.f32s("rigid body offset")?,
    };
    if version >= BitstreamVersion::V4_2 {
        reader.skip(4, 4, "rigid body rotation")?;
    }
    if version >= BitstreamVersion::V3_0 {
        // Position and label of each, then the names.
        let markers = reader.count(12 + 4, "definition marker count")?;
        reader.skip(markers, 12 + 4, "definition markers")?;
        if version >= BitstreamVersion::V4_0 {
            for _ in 0..markers {
                reader.c_bytes("definition marker name")?;
            }
        }
    }
    Ok(definition)
}

fn skip_names(reader: &mut Reader<'_>, field: &'static str) -> Decoded<()> {
    let names = reader.count(1, field)?;
    (0..names).try_for_each(|_| reader.c_bytes("name").map(drop))
}
