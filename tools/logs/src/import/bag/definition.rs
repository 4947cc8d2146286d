//! Definitions of messages, as `.msg` files have them and bags store them.

use std::collections::HashMap;

/// The definitions of messages that bags without definitions may have.
const BUILT_IN: &str = include_str!("definitions.msg");

/// Messages within messages, at most.
const MAX_DEPTH: usize = 32;

/// Types in a definition, at most.
const MAX_TYPES: usize = 500;

/// The type of a message, with those of the messages within it.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Definition {
    /// The first one is the message itself.
    pub(super) messages: Vec<MessageType>,
}

/// The fields of a message.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct MessageType {
    /// Such as `geometry_msgs/Pose`.
    pub(super) name: String,
    pub(super) fields: Vec<Field>,
}

/// A field of a message.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Field {
    pub(super) name: String,
    pub(super) kind: Kind,
    pub(super) count: Count,
}

/// What a field, or each element of it, is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    Bool,
    /// Unsigned integer of this many bytes.
    Unsigned(usize),
    /// Signed integer of this many bytes.
    Signed(usize),
    /// Floating-point number of this many bytes.
    Float(usize),
    Text,
    /// One of [`Definition::messages`].
    Message(usize),
}

/// How many elements a field has.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Count {
    One,
    Array(u32),
    Sequence,
}

impl Definition {
    /// The definition of the message `name` in the text of a bag: its fields, and after lines of
    /// `=` those of other messages. What it lacks is taken from the built-in definitions; the reason
    /// if it is not there either, or can't be understood.
    pub(super) fn parse(name: &str, text: &str) -> Result<Self, String> {
        let name = short(name);
        let mut texts: HashMap<_, _> = parts(BUILT_IN).into_iter().collect();
        if !text.trim().is_empty() {
            let mut own = parts(text);
            if let Some((first, _)) = own.first_mut().filter(|(first, _)| first.is_empty()) {
                first.clone_from(&name);
            }
            texts.extend(own);
        }
        let mut definition = Self {
            messages: vec![MessageType {
                name,
                fields: Vec::new(),
            }],
        };
        let mut next = 0;
        while let Some(message) = definition.messages.get(next) {
            let name = message.name.clone();
            let lines = texts.get(&name);
            let lines = lines.ok_or_else(|| format!("{name} is not defined"))?;
            let fields = definition.fields(&name, lines)?;
            definition.messages[next].fields = fields;
            next += 1;
        }
        match definition.is_too_deep() {
            true => Err(format!("more than {MAX_DEPTH} messages are nested in it")),
            false => Ok(definition),
        }
    }

    /// The fields of the message `name`; messages in them that are new are added, without fields.
    fn fields(&mut self, name: &str, lines: &[&str]) -> Result<Vec<Field>, String> {
        let mut fields = Vec::new();
        for line in lines {
            let line = line.split('#').next().unwrap_or_default();
            let mut words = line.split_whitespace();
            let (Some(kind), Some(field)) = (words.next(), words.next()) else {
                continue;
            };
            let is_constant =
                field.contains('=') || words.next().is_some_and(|word| word.starts_with('='));
            if !is_constant {
                let wrong = |why| format!("{name} has a field `{kind} {field}`: {why}");
                let (kind, count) = self.kind(name, kind).map_err(wrong)?;
                fields.push(Field {
                    name: field.to_owned(),
                    kind,
                    count,
                });
            }
        }
        Ok(fields)
    }

    /// The type of a field of the message `parent`.
    fn kind(&mut self, parent: &str, word: &str) -> Result<(Kind, Count), &'static str> {
        let (word, count) = match word.split_once('[') {
            None => (word, Count::One),
            Some((word, length)) => match length.strip_suffix(']') {
                Some("") => (word, Count::Sequence),
                Some(length) if length.starts_with("<=") => (word, Count::Sequence),
                Some(length) => match length.parse() {
                    Ok(length @ 1..) => (word, Count::Array(length)),
                    _ => return Err("its length is not a number above 0"),
                },
                None => return Err("it has no `]`"),
            },
        };
        let kind = match word.split("<=").next().unwrap_or_default() {
            "bool" => Kind::Bool,
            "byte" | "char" | "uint8" => Kind::Unsigned(1),
            "uint16" => Kind::Unsigned(2),
            "uint32" => Kind::Unsigned(4),
            "uint64" => Kind::Unsigned(8),
            "int8" => Kind::Signed(1),
            "int16" => Kind::Signed(2),
            "int32" => Kind::Signed(4),
            "int64" => Kind::Signed(8),
            "float32" => Kind::Float(4),
            "float64" => Kind::Float(8),
            "string" => Kind::Text,
            "wstring" => return Err("text of this kind is not read"),
            message => {
                let name = match message.contains('/') {
                    true => short(message),
                    false => {
                        let package = parent.split('/').next().unwrap_or_default();
                        format!("{package}/{message}")
                    }
                };
                let known = self.messages.iter().position(|one| one.name == name);
                if known.is_none() && self.messages.len() >= MAX_TYPES {
                    return Err("more types than are read are nested in it");
                }
                Kind::Message(known.unwrap_or_else(|| {
                    self.messages.push(MessageType {
                        name,
                        fields: Vec::new(),
                    });
                    self.messages.len() - 1
                }))
            }
        };
        Ok((kind, count))
    }

    /// Whether more messages are nested in it than may be; a message within itself has no end.
    fn is_too_deep(&self) -> bool {
        // Each round adds one level to the known depth of each message.
        let mut depths = vec![0; self.messages.len()];
        for _ in 0..=MAX_DEPTH {
            let below = |field: &Field| match field.kind {
                Kind::Message(inner) => Some(depths[inner] + 1),
                _ => None,
            };
            let depth = |message: &MessageType| message.fields.iter().filter_map(below).max();
            let messages = self.messages.iter();
            depths = messages.map(|one| depth(one).unwrap_or(0)).collect();
        }
        depths[0] > MAX_DEPTH
    }

    /// The fields of one of the messages.
    pub(super) fn fields_of(&self, message: usize) -> &[Field] {
        &self.messages[message].fields
    }

    /// The name of one of the messages.
    pub(super) fn name_of(&self, message: usize) -> &str {
        &self.messages[message].name
    }
}

/// A name of a type without its folder: `geometry_msgs/Pose` of `geometry_msgs/msg/Pose`.
pub(super) fn short(name: &str) -> String {
    name.replacen("/msg/", "/", 1)
}

/// The definitions in a text, with their names and their lines; the first one need not have a name.
fn parts(text: &str) -> Vec<(String, Vec<&str>)> {
    let is_end = |line: &&str| {
        let line = line.trim_end();
        line.len() >= 3 && line.bytes().all(|byte| byte == b'=')
    };
    let lines: Vec<_> = text.lines().collect();
    let parts = lines.split(is_end).map(|lines| {
        let mut rest = lines.iter().skip_while(|line| line.trim().is_empty());
        let first = rest.next().copied().unwrap_or_default();
        match first.trim_start().strip_prefix("MSG:") {
            Some(name) => (short(name.trim()), rest.copied().collect()),
            None => (String::new(), lines.to_vec()),
        }
    });
    parts.collect()
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "a test may fail")]

    use super::*;

    fn field(name: &str, kind: Kind, count: Count) -> Field {
        Field {
            name: name.to_owned(),
            kind,
            count,
        }
    }

    #[test]
    fn constants_comments_defaults_and_bounds_are_no_part_of_the_layout() {
        let text = "# a comment\nuint8 MAX=3\nstring TEXT = \"a # b\"\n\nint16[<=4] some 1 # one\n\
                    string<=5 name \"x\"\nfloat32[3] three\nPart part\nother/msg/Part[] parts\n\
                    ====\nMSG: pack/Part\nbool is\n====\nMSG: other/Part\nchar c\n";
        let definition = Definition::parse("pack/msg/Whole", text).unwrap();
        let expected = [
            field("some", Kind::Signed(2), Count::Sequence),
            field("name", Kind::Text, Count::One),
            field("three", Kind::Float(4), Count::Array(3)),
            field("part", Kind::Message(1), Count::One),
            field("parts", Kind::Message(2), Count::Sequence),
        ];
        assert_eq!(definition.fields_of(0), expected);
        assert_eq!(definition.name_of(1), "pack/Part");
        assert_eq!(
            definition.fields_of(2),
            [field("c", Kind::Unsigned(1), Count::One)]
        );
    }

    #[test]
    fn every_built_in_definition_is_whole() {
        let names: Vec<_> = parts(BUILT_IN).into_iter().map(|(name, _)| name).collect();
        assert!(names.len() > 20);
        for name in names {
            let definition = Definition::parse(&name, "").unwrap();
            assert!(definition.messages.iter().all(|one| !one.fields.is_empty()));
        }
    }

    #[test]
    fn what_is_no_definition_is_refused() {
        for (text, expected) in [
            ("Unknown u", "p/Unknown is not defined"),
            ("M m", "more than 32 messages are nested in it"),
            ("int8[0] none", "its length is not a number above 0"),
            ("int8[3 x", "it has no `]`"),
            ("wstring w", "text of this kind is not read"),
        ] {
            let error = Definition::parse("p/M", text).unwrap_err();
            assert!(error.contains(expected), "{error}");
        }
        let error = Definition::parse("q/Unknown", "").unwrap_err();
        assert_eq!(error, "q/Unknown is not defined");
    }
}
