//! Which streaming id a rigid body's name has.

use core::fmt::{self, Write as _};

use crate::pose_source::Names;

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

/// A server's name as text: quoted as a string's `Debug`, which escapes what a terminal would obey.
/// Bytes that are not UTF-8 are shown as `\xe4`.
#[derive(Clone, Copy)]
pub struct NameText<'a>(pub &'a [u8]);

impl NameText<'_> {
    /// Whether all of it is text.
    #[must_use]
    pub const fn is_utf8(&self) -> bool {
        core::str::from_utf8(self.0).is_ok()
    }
}

impl fmt::Debug for NameText<'_> {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        if let Ok(text) = core::str::from_utf8(self.0) {
            return fmt::Debug::fmt(text, formatter);
        }
        write!(formatter, "\"{self}\"")
    }
}

impl fmt::Display for NameText<'_> {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        if let Ok(text) = core::str::from_utf8(self.0) {
            return formatter.write_str(text);
        }
        self.0.utf8_chunks().try_for_each(|chunk| {
            write!(formatter, "{}", chunk.valid().escape_debug())?;
            write!(formatter, "{}", chunk.invalid().escape_ascii())
        })
    }
}

/// Between two names in the list.
const SEPARATOR: &str = ", ";

impl BodyNames {
    pub(crate) fn of(bodies: &Names<'_>) -> Self {
        let mut names = Self::default();
        bodies.for_each(&mut |id, name| names.list(id, name));
        names
    }

    fn list(&mut self, id: i32, name: &[u8]) {
        let separator = if self.listed.is_empty() {
            ""
        } else {
            SEPARATOR
        };
        let room = self.listed.capacity() - self.listed.len();
        let mut text = heapless::String::<320>::new();
        let fits = write!(text, "{separator}{:?}", NameText(name)).is_ok();
        let is_room = fits && text.len() <= room && !self.ids.is_full();
        let end = u8::try_from(self.listed.len() + text.len());
        if let (0, true, Ok(end)) = (self.omitted, is_room, end) {
            // Both have room: see above.
            let _ = self.listed.push_str(&text);
            let _ = self.ids.push((id, end));
        } else {
            self.omitted += 1;
        }
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

    /// The streaming id of the body with this quoted name, if it is listed.
    #[must_use]
    pub fn id(&self, quoted: &str) -> Option<i32> {
        let ids = self.ids.iter().map(|(id, _)| *id);
        ids.into_iter().find(|id| self.name(*id) == Some(quoted))
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
    /// Looks the name up among those of the server.
    #[must_use]
    pub fn resolve(bodies: &Names<'_>, name: &str) -> Self {
        let (mut first, mut count) = (0, 0);
        bodies.for_each(&mut |id, other| {
            if other == name.as_bytes() {
                if count == 0 {
                    first = id;
                }
                count += 1;
            }
        });
        match count {
            0 => Self::Missing,
            1 => Self::Bound { id: first },
            count => Self::Ambiguous { count },
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
