//! Which streaming id a rigid body's name has.

use crate::codec::ModelDefinitions;

/// What the model definitions say of a rigid body's name.
///
/// This enum is exhaustive: every user must decide what each case means to it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Binding {
    /// The definitions have not been read, or they have changed since.
    Unresolved,
    /// One rigid body has the name.
    Bound {
        /// Its streaming id.
        id: i32,
    },
    /// No rigid body has the name.
    Missing,
    /// Several rigid bodies have the name; none of them is chosen.
    Ambiguous {
        /// How many.
        count: usize,
    },
}

impl Binding {
    /// Looks the name up in the definitions.
    #[must_use]
    pub fn resolve(definitions: &ModelDefinitions<'_>, name: &str) -> Self {
        let mut named = definitions
            .rigid_bodies()
            .filter(|definition| definition.name == name);
        match (named.next(), named.count()) {
            (None, _) => Self::Missing,
            (Some(definition), 0) => Self::Bound { id: definition.id },
            (Some(_), others) => Self::Ambiguous { count: others + 1 },
        }
    }

    /// The streaming id, if exactly one body has the name.
    #[must_use]
    pub const fn id(self) -> Option<i32> {
        match self {
            Self::Bound { id } => Some(id),
            _ => None,
        }
    }
}
