//! The names that the servers of each protocol give bodies, and the streaming id of a body's name.

use core::{
    fmt::{self, Write as _},
    ops::Range,
};

use crate::codec::ModelDefinitions;

/// The names of a server's bodies.
#[derive(Clone, Debug)]
pub enum Names<'a> {
    /// NatNet's definitions of rigid bodies.
    Definitions(ModelDefinitions<'a>),
    /// The senders that a VRPN server describes.
    Senders(&'a Senders),
    /// The list of bodies of QTM.
    Listed(BodyList<'a>),
}

impl Names<'_> {
    /// Passes each body's id and name to `visit`, in the order of the server. A name is bytes until
    /// it is shown: see [`NameText`].
    pub fn for_each(&self, visit: &mut dyn FnMut(i32, &[u8])) {
        match self {
            Self::Definitions(definitions) => definitions
                .rigid_bodies()
                .for_each(|definition| visit(definition.id, definition.name)),
            Self::Senders(senders) => senders.iter().for_each(|(id, name)| visit(id, name)),
            Self::Listed(list) => (0..)
                .zip(list.clone())
                .for_each(|(id, name)| visit(id, &name)),
        }
    }
}

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
    /// The streaming id of each listed name, and where the name is in `listed`.
    ids: heapless::Vec<(i32, Range<usize>), 60>,
    /// How many are not listed for want of room.
    omitted: usize,
}

/// A server's name as text: quoted as a string's `Debug`, which escapes what a terminal would obey.
/// Bytes that are not UTF-8 are shown as `\xe4`.
#[derive(Clone, Copy)]
pub struct NameText<'a>(pub &'a [u8]);

impl NameText<'_> {
    /// Whether all of it is text.
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

impl BodyNames {
    pub(crate) fn of(bodies: &Names<'_>) -> Self {
        let mut names = Self::default();
        bodies.for_each(&mut |id, name| names.list(id, name));
        names
    }

    fn list(&mut self, id: i32, name: &[u8]) {
        let separator = if self.listed.is_empty() { "" } else { ", " };
        let room = self.listed.capacity() - self.listed.len();
        let mut text = heapless::String::<320>::new();
        let fits = write!(text, "{separator}{:?}", NameText(name)).is_ok();
        let is_room = fits && text.len() <= room && !self.ids.is_full();
        if self.omitted == 0 && is_room {
            let begin = self.listed.len() + separator.len();
            // Both have room: see above.
            let _ = self.listed.push_str(&text);
            let _ = self.ids.push((id, begin..self.listed.len()));
        } else {
            self.omitted += 1;
        }
    }

    /// The quoted name of the body with this streaming id; none if it is not listed.
    pub fn name(&self, id: i32) -> Option<&str> {
        let (_, place) = self.ids.iter().find(|(known, _)| *known == id)?;
        self.listed.get(place.clone())
    }

    /// The streaming id of the body with this quoted name, if it is listed.
    pub fn id(&self, quoted: &str) -> Option<i32> {
        let ids = self.ids.iter().map(|(id, _)| *id);
        ids.into_iter().find(|id| self.name(*id) == Some(quoted))
    }

    /// Whether the server has no rigid body.
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
    pub fn resolve(bodies: &Names<'_>, name: &str) -> Self {
        let (mut last, mut count) = (0, 0);
        bodies.for_each(&mut |id, other| {
            if other == name.as_bytes() {
                (last, count) = (id, count + 1);
            }
        });
        match count {
            0 => Self::Missing,
            1 => Self::Bound { id: last },
            count => Self::Ambiguous { count },
        }
    }

    /// The streaming id, if exactly one body has the name.
    pub const fn id(self) -> Option<i32> {
        match self {
            Self::Bound { id } => Some(id),
            _ => None,
        }
    }
}

/// The longest name of a sender that VRPN allows.
pub(crate) const NAME_LEN: usize = 100;

/// How many senders are remembered.
const SENDERS: usize = 24;

/// A sender's name.
pub(crate) type SenderName = heapless::Vec<u8, NAME_LEN>;

/// The senders that a server has described, by their numbers.
#[derive(Clone, Debug, Default)]
pub struct Senders {
    names: heapless::Vec<(i32, SenderName), SENDERS>,
    sensor: i32,
}

/// The name of the connection itself, which is no tracker.
pub(crate) const CONTROL: &[u8] = b"VRPN Control";

impl Senders {
    pub(crate) const fn new(sensor: i32) -> Self {
        let names = heapless::Vec::new();
        Self { names, sensor }
    }

    /// Takes a description. Returns whether it was news. The needed sender always has room.
    pub(crate) fn describe(&mut self, number: i32, name: &[u8], needed: Option<&[u8]>) -> bool {
        let Ok(name) = SenderName::try_from(name) else {
            return false;
        };
        // A name belongs to one number: the newest.
        self.names
            .retain(|(known, other)| *known == number || *other != name);
        let mut names = self.names.iter_mut();
        if let Some((_, known)) = names.find(|(known, _)| *known == number) {
            let is_news = *known != name;
            *known = name;
            return is_news;
        }
        if self.names.is_full() {
            if needed != Some(name.as_slice()) {
                return false;
            }
            self.names.pop();
        }
        self.names.push((number, name)).is_ok()
    }

    /// The name of a sender.
    pub(crate) fn name(&self, number: i32) -> Option<&[u8]> {
        let mut names = self.names.iter();
        let (_, name) = names.find(|(known, _)| *known == number)?;
        Some(name)
    }

    /// The body of each sender with the configured sensor, and the sender's name.
    pub fn iter(&self) -> impl Iterator<Item = (i32, &[u8])> {
        let named = self.names.iter().filter(|(_, name)| name != CONTROL);
        named.map(|(number, name)| (body_id(*number, self.sensor), name.as_slice()))
    }
}

/// The id of a body: the sender's number and the sensor's.
pub(crate) const fn body_id(sender: i32, sensor: i32) -> i32 {
    sender.wrapping_mul(1_000).wrapping_add(sensor)
}

/// A body's name: bytes, because a project may hold names in another encoding than UTF-8.
pub(crate) type ListedName = heapless::Vec<u8, 255>;

/// The names in the answer to `GetParameters 6D`, in the order of the frames' bodies.
#[derive(Clone, Debug)]
pub struct BodyList<'a> {
    rest: &'a [u8],
}

impl<'a> BodyList<'a> {
    /// The names in this XML; none if it has no section of bodies.
    pub fn new(xml: &'a [u8]) -> Self {
        let (_, section) = split_once(xml, b"<The_6D>").unwrap_or_default();
        let rest = split_once(section, b"</The_6D>").map_or(section, |(section, _)| section);
        Self { rest }
    }
}

impl Iterator for BodyList<'_> {
    type Item = ListedName;

    fn next(&mut self) -> Option<ListedName> {
        // `<Bodies>` is their number, in older versions. Each part of the text is read once.
        let ends =
            split_once(self.rest, b"<Body>").and_then(|(_, body)| split_once(body, b"</Body>"));
        let (own, rest) = ends.unwrap_or_default();
        self.rest = rest;
        ends?;
        let text = split_once(own, b"<Name>")
            .and_then(|(_, name)| split_once(name, b"</Name>"))
            .map_or(&[][..], |(name, _)| name);
        Some(unescaped(text))
    }
}

/// What is before and after the first `tag`.
fn split_once<'a>(text: &'a [u8], tag: &[u8]) -> Option<(&'a [u8], &'a [u8])> {
    let at = text.windows(tag.len()).position(|part| part == tag)?;
    Some((text.get(..at)?, text.get(at + tag.len()..)?))
}

/// The text with XML's five entities replaced. A name that is too long is cut off.
fn unescaped(text: &[u8]) -> ListedName {
    const ENTITIES: [(&[u8], u8); 5] = [
        (b"&lt;", b'<'),
        (b"&gt;", b'>'),
        (b"&quot;", b'"'),
        (b"&apos;", b'\''),
        (b"&amp;", b'&'),
    ];
    let mut name = ListedName::new();
    let mut rest = text;
    while let Some(first) = rest.first() {
        let entity = ENTITIES.iter().find(|(entity, _)| rest.starts_with(entity));
        let (length, byte) = entity.map_or((1, *first), |(entity, byte)| (entity.len(), *byte));
        if name.push(byte).is_err() {
            break;
        }
        rest = rest.get(length..).unwrap_or_default();
    }
    name
}
