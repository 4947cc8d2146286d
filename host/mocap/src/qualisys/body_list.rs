//! The names of the bodies, in the XML of QTM's settings.

/// A body's name: bytes, because a project may hold names in another encoding than UTF-8.
pub(super) type Name = heapless::Vec<u8, 255>;

/// The names in the answer to `GetParameters 6D`, in the order of the frames' bodies.
#[derive(Clone, Debug)]
pub struct BodyList<'a> {
    rest: &'a [u8],
}

impl<'a> BodyList<'a> {
    /// The names in this XML; none if it has no section of bodies.
    #[must_use]
    pub fn new(xml: &'a [u8]) -> Self {
        let (_, section) = split_once(xml, b"<The_6D>").unwrap_or_default();
        let rest = split_once(section, b"</The_6D>").map_or(section, |(section, _)| section);
        Self { rest }
    }
}

impl Iterator for BodyList<'_> {
    type Item = Name;

    fn next(&mut self) -> Option<Name> {
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
fn unescaped(text: &[u8]) -> Name {
    const ENTITIES: [(&[u8], u8); 5] = [
        (b"&lt;", b'<'),
        (b"&gt;", b'>'),
        (b"&quot;", b'"'),
        (b"&apos;", b'\''),
        (b"&amp;", b'&'),
    ];
    let mut name = Name::new();
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
