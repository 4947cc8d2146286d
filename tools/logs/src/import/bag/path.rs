//! Fields of messages, as a map names them: `twist.twist.linear.x`, `buttons[4]`,
//! `rigidbodies[rigid_body_name=car].pose.position.x`.

use super::definition::{Count, Definition, Field, Kind};

/// A field by its name, from the message inwards.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Path(pub(super) Vec<Part>);

/// A field, or an element of it if it is a list.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Part {
    pub(super) field: String,
    pub(super) element: Option<Element>,
}

/// An element of a list.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Element {
    Index(u32),
    /// The first one in which the field `key` is this text.
    Named {
        key: String,
        value: String,
    },
}

/// What a key of the map takes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Takes {
    Number,
    /// A number, or a quaternion of which the yaw is taken.
    Yaw,
    Stamp,
}

impl Path {
    /// `None` if the text is no path.
    pub(super) fn parse(text: &str) -> Option<Self> {
        let mut parts = Vec::new();
        let mut rest = text;
        loop {
            let end = rest.find(['.', '[']).unwrap_or(rest.len());
            let (field, after) = rest.split_at_checked(end)?;
            let (element, after) = match after.strip_prefix('[') {
                None => (None, after),
                Some(inside) => {
                    let (inside, after) = inside.split_once(']')?;
                    (Some(Element::parse(inside)?), after)
                }
            };
            if field.is_empty() {
                return None;
            }
            parts.push(Part {
                field: field.to_owned(),
                element,
            });
            match after.strip_prefix('.') {
                Some(after) => rest = after,
                None if after.is_empty() => return Some(Self(parts)),
                None => return None,
            }
        }
    }

    /// Fails if messages of this type have no such field, or none that the key can take.
    pub(super) fn check(&self, definition: &Definition, takes: Takes) -> Result<(), String> {
        // The message itself, and of the last field its name and what it is.
        let (mut before, mut kind) = ("", Kind::Message(0));
        for Part { field, element } in &self.0 {
            let Kind::Message(message) = kind else {
                return Err(format!("{before} has no fields"));
            };
            let found = find(definition, message, field)?;
            match (element, found.count) {
                (None, Count::One) => {}
                (None, _) => {
                    return Err(format!(
                        "{field} is a list: name an element, such as {field}[0]"
                    ));
                }
                (Some(_), Count::One) => return Err(format!("{field} is no list")),
                (Some(Element::Index(_)), _) => {}
                (Some(Element::Named { key, .. }), _) => {
                    let Kind::Message(inner) = found.kind else {
                        return Err(format!("{field} has no fields, such as {key}"));
                    };
                    let key = find(definition, inner, key)?;
                    if (key.kind, key.count) != (Kind::Text, Count::One) {
                        return Err(format!("{} is not a text", key.name));
                    }
                }
            }
            (before, kind) = (field, found.kind);
        }
        check_end(definition, kind, takes)
    }
}

impl Element {
    fn parse(text: &str) -> Option<Self> {
        match text.split_once('=') {
            None => Some(Self::Index(text.parse().ok()?)),
            Some((key, value)) if !key.is_empty() => Some(Self::Named {
                key: key.to_owned(),
                value: value.to_owned(),
            }),
            Some(_) => None,
        }
    }
}

fn find<'a>(definition: &'a Definition, message: usize, name: &str) -> Result<&'a Field, String> {
    let fields = definition.fields_of(message);
    let found = fields.iter().find(|field| field.name == name);
    found.ok_or_else(|| {
        let names: Vec<_> = fields.iter().map(|field| field.name.as_str()).collect();
        let (of, names) = (definition.name_of(message), names.join(", "));
        format!("{of} has no {name}, its fields are {names}")
    })
}

/// Fails if the key can't take a field of this kind.
fn check_end(definition: &Definition, kind: Kind, takes: Takes) -> Result<(), String> {
    let (what, fields) = match kind {
        Kind::Text => ("a text".to_owned(), &[][..]),
        Kind::Message(inner) => (
            format!("a {}", definition.name_of(inner)),
            definition.fields_of(inner),
        ),
        _ => ("a number".to_owned(), &[][..]),
    };
    let is_one = |field: &Field, kind| (field.kind, field.count) == (kind, Count::One);
    let is_taken = match (takes, kind, fields) {
        (Takes::Number | Takes::Yaw, kind, []) => !matches!(kind, Kind::Text | Kind::Message(_)),
        (Takes::Yaw, _, [x, y, z, w]) => [(x, "x"), (y, "y"), (z, "z"), (w, "w")]
            .iter()
            .all(|(field, name)| field.name == *name && is_one(field, Kind::Float(8))),
        (Takes::Stamp, Kind::Message(inner), [seconds, nanoseconds]) => {
            definition.name_of(inner) == "builtin_interfaces/Time"
                && is_one(seconds, Kind::Signed(4))
                && is_one(nanoseconds, Kind::Unsigned(4))
        }
        _ => false,
    };
    if is_taken {
        return Ok(());
    }
    let needed = match takes {
        Takes::Number => "a number",
        Takes::Yaw => "a number or a quaternion",
        Takes::Stamp => "a builtin_interfaces/Time",
    };
    Err(format!("it is {what}, not {needed}"))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "a test may fail")]

    use super::*;

    fn checked(name: &str, path: &str, takes: Takes) -> Result<(), String> {
        let definition = Definition::parse(name, "").unwrap();
        Path::parse(path).unwrap().check(&definition, takes)
    }

    #[test]
    fn a_path_leads_to_a_number_a_yaw_or_a_time() {
        let yaw = "rigidbodies[rigid_body_name=a.b].pose.orientation";
        let named = Element::Named {
            key: "rigid_body_name".to_owned(),
            value: "a.b".to_owned(),
        };
        let part = |(field, element): (&str, Option<Element>)| Part {
            field: field.to_owned(),
            element,
        };
        let parts = [
            ("rigidbodies", Some(named)),
            ("pose", None),
            ("orientation", None),
        ];
        let expected = Path(parts.map(part).to_vec());
        assert_eq!(Path::parse(yaw), Some(expected));
        for (name, path, takes) in [
            ("mocap4r2_msgs/msg/RigidBodies", yaw, Takes::Yaw),
            ("sensor_msgs/Joy", "buttons[4]", Takes::Number),
            ("sensor_msgs/Joy", "header.stamp", Takes::Stamp),
        ] {
            assert_eq!(checked(name, path, takes), Ok(()), "{path}");
        }
    }

    #[test]
    fn a_path_that_leads_nowhere_says_where_it_ends() {
        for (path, takes, expected) in [
            (
                "header.time",
                Takes::Number,
                "std_msgs/Header has no time, its fields are stamp, frame_id",
            ),
            (
                "header.frame_id",
                Takes::Number,
                "it is a text, not a number",
            ),
            (
                "header.stamp",
                Takes::Yaw,
                "it is a builtin_interfaces/Time, not a number or a quaternion",
            ),
            (
                "axes[0]",
                Takes::Stamp,
                "it is a number, not a builtin_interfaces/Time",
            ),
            (
                "axes",
                Takes::Number,
                "axes is a list: name an element, such as axes[0]",
            ),
            ("header[0].stamp", Takes::Stamp, "header is no list"),
            ("axes[0].x", Takes::Number, "axes has no fields"),
            (
                "axes[name=x]",
                Takes::Number,
                "axes has no fields, such as name",
            ),
        ] {
            let error = checked("sensor_msgs/Joy", path, takes).unwrap_err();
            assert_eq!(error, expected);
        }
        for path in [
            "", ".", "a.", "a[", "a[]", "a[x]", "a[=x]", "a[1]b", "[1]", "a..b",
        ] {
            assert_eq!(Path::parse(path), None, "{path}");
        }
    }
}
