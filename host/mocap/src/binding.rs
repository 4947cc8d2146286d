//! Which streaming id the configured name has.

use crate::codec::ModelDefinitions;

/// What the model definitions say of the configured name.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Binding {
    /// The definitions have not been read, or changed since.
    Unresolved,
    /// One rigid body has the name.
    Bound {
        /// Its streaming id.
        id: i32,
    },
    /// No rigid body has the name.
    Missing,
    /// Several rigid bodies have the name: none is followed.
    Ambiguous {
        /// How many.
        count: usize,
    },
}

impl Binding {
    pub(crate) fn resolve(definitions: &ModelDefinitions<'_>, name: &str) -> Self {
        let mut named = definitions
            .rigid_bodies()
            .filter(|definition| definition.name == name);
        match (named.next(), named.count()) {
            (None, _) => Self::Missing,
            (Some(definition), 0) => Self::Bound { id: definition.id },
            (Some(_), others) => Self::Ambiguous { count: others + 1 },
        }
    }
}
