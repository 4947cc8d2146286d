//! Which streaming id a rigid body's name has.

use core::fmt::{self, Write as _};

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

/// The names of a server's rigid bodies, for messages.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct BodyNames {
    /// The first names, each quoted, after commas.
    listed: heapless::String<240>,
    /// The streaming id of each listed name, and where the name ends in `listed`.
    ids: heapless::Vec<(i32, u8), 60>,
    /// How many are not listed for want of room.
    omitted: usize,
}

/// Between two names in the list.
const SEPARATOR: &str = ", ";

impl BodyNames {
    pub(crate) fn of(definitions: &ModelDefinitions<'_>) -> Self {
        let mut names = Self::default();
        for definition in definitions.rigid_bodies() {
            let separator = if names.listed.is_empty() {
                ""
            } else {
                SEPARATOR
            };
            let room = names.listed.capacity() - names.listed.len();
            // Debug escapes what a terminal would obey.
            let mut text = heapless::String::<320>::new();
            let fits = write!(text, "{separator}{:?}", definition.name).is_ok();
            let is_room = fits && text.len() <= room && !names.ids.is_full();
            let end = u8::try_from(names.listed.len() + text.len());
            if let (0, true, Ok(end)) = (names.omitted, is_room, end) {
                // Both have room: see above.
                let _ = names.listed.push_str(&text);
                let _ = names.ids.push((definition.id, end));
            } else {
                names.omitted += 1;
            }
        }
        names
    }

    /// The quoted name of the body with this streaming id; none if it is not listed.
    #[must_use]
    pub fn name(&self, id: i32) -> Option<&str> {
        let index = self.ids.iter().position(|(known, _)| *known == id)?;
        let (_, end) = self.ids.get(index)?;
        let begin = match index.checked_sub(1).and_then(|last| self.ids.get(last)) {
            Some((_, end)) => usize::from(*end) + SEPARATOR.len(),
            None => 0,
        };
        self.listed.get(begin..usize::from(*end))
    }

    /// Whether the server has no rigid body.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.listed.is_empty() && self.omitted == 0
    }
}

impl fmt::Display for BodyNames {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(&self.listed)?;
        match self.omitted {
            0 => Ok(()),
            omitted => write!(formatter, " and {omitted} more"),
        }
    }
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
