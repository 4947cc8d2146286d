//! The names of the bodies, in the XML of QTM's settings.

/// A body's name.
pub(super) type Name = heapless::String<255>;

/// The names in the answer to `GetParameters 6D`, in the order of the frames' bodies.
#[derive(Clone, Debug)]
pub struct BodyList<'a> {
    rest: &'a str,
}

impl<'a> BodyList<'a> {
    /// The names in this XML; none if it has no section of bodies.
    #[must_use]
    pub fn new(xml: &'a str) -> Self {
        let section = xml
            .split_once("<The_6D>")
            .map_or("", |(_, section)| section);
        let rest = section
            .split_once("</The_6D>")
            .map_or(section, |(section, _)| section);
        Self { rest }
    }
}

impl Iterator for BodyList<'_> {
    type Item = Name;

    fn next(&mut self) -> Option<Name> {
        // `<Bodies>` is their number, in older versions. Each part of the text is read once.
        let ends = self
            .rest
            .split_once("<Body>")
            .and_then(|(_, body)| body.split_once("</Body>"));
        let (own, rest) = ends.unwrap_or_default();
        self.rest = rest;
        ends?;
        let text = own
            .split_once("<Name>")
            .and_then(|(_, name)| name.split_once("</Name>"))
            .map_or("", |(name, _)| name);
        Some(unescaped(text))
    }
}

/// The text with XML's five entities replaced. A name that is too long is cut off.
fn unescaped(text: &str) -> Name {
    const ENTITIES: [(&str, char); 5] = [
        ("&lt;", '<'),
        ("&gt;", '>'),
        ("&quot;", '"'),
        ("&apos;", '\''),
        ("&amp;", '&'),
    ];
    let mut name = Name::new();
    let mut rest = text;
    while let Some(first) = rest.chars().next() {
        let entity = ENTITIES.iter().find(|(entity, _)| rest.starts_with(entity));
        let (length, character) = entity
            .map_or((first.len_utf8(), first), |(entity, character)| {
                (entity.len(), *character)
            });
        if name.push(character).is_err() {
            break;
        }
        rest = rest.get(length..).unwrap_or_default();
    }
    name
}
