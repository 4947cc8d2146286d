//! Fields of messages, as a map names them: `twist.twist.linear.x`, `buttons[4]`,
//! `rigidbodies[rigid_body_name=car].pose.position.x`.

use super::{
    cdr::{End, Pick, Step, Target},
    definition::{Count, Definition, Field, Kind},
};

/// A field by its name, from the message inwards.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Path(Vec<Part>);

#[derive(Clone, Debug, PartialEq)]
struct Part {
    field: String,
    element: Option<Element>,
}

/// An element of a list.
#[derive(Clone, Debug, PartialEq)]
enum Element {
    Index(u32),
    Named { key: String, value: String },
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

    /// The field in messages of this type; the reason if there is no such field, or none that the key
    /// can take.
    pub(super) fn resolve(&self, definition: &Definition, takes: Takes) -> Result<Target, String> {
        // The message itself, and of the last field its name and what it is.
        let (mut before, mut kind) = ("", Kind::Message(0));
        let mut steps = Vec::new();
        for Part { field, element } in &self.0 {
            let Kind::Message(message) = kind else {
                return Err(format!("{before} has no fields"));
            };
            let (place, found) = find(definition, message, field)?;
            let pick = match (element, found.count) {
                (None, Count::One) => Pick::Whole,
                (None, _) => {
                    return Err(format!(
                        "{field} is a list: name an element, such as {field}[0]"
                    ));
                }
                (Some(_), Count::One) => return Err(format!("{field} is no list")),
                (Some(Element::Index(index)), _) => Pick::Index {
                    list: field.clone(),
                    index: *index,
                },
                (Some(Element::Named { key, value }), _) => {
                    let Kind::Message(inner) = found.kind else {
                        return Err(format!("{field} has no fields, such as {key}"));
                    };
                    let (key, found) = find(definition, inner, key)?;
                    if (found.kind, found.count) != (Kind::Text, Count::One) {
                        return Err(format!("{} is not a text", found.name));
                    }
                    Pick::Named {
                        key,
                        value: value.clone(),
                    }
                }
            };
            steps.push(Step { field: place, pick });
            (before, kind) = (field, found.kind);
        }
        let end = end(definition, kind, takes)?;
        Ok(Target { steps, end })
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

fn find<'a>(
    definition: &'a Definition,
    message: usize,
    name: &str,
) -> Result<(usize, &'a Field), String> {
    let fields = definition.fields_of(message);
    let mut places = fields.iter().enumerate();
    places.find(|(_, field)| field.name == name).ok_or_else(|| {
        let names: Vec<_> = fields.iter().map(|field| field.name.as_str()).collect();
        let (of, names) = (definition.name_of(message), names.join(", "));
        format!("{of} has no {name}, its fields are {names}")
    })
}

/// What is read of a field of this kind.
fn end(definition: &Definition, kind: Kind, takes: Takes) -> Result<End, String> {
    let what = match kind {
        Kind::Text => "a text".to_owned(),
        Kind::Message(inner) => format!("a {}", definition.name_of(inner)),
        _ => "a number".to_owned(),
    };
    let fields = match kind {
        Kind::Message(inner) => definition.fields_of(inner),
        _ => &[],
    };
    let part = |field: &Field| (field.kind, field.count);
    match (takes, kind, fields) {
        (Takes::Yaw, _, [x, y, z, w])
            if [x, y, z, w].map(|field| field.name.as_str()) == ["x", "y", "z", "w"]
                && [x, y, z, w].map(part) == [(Kind::Float(8), Count::One); 4] =>
        {
            return Ok(End::Yaw);
        }
        (Takes::Stamp, Kind::Message(inner), [seconds, nanoseconds])
            if definition.name_of(inner) == "builtin_interfaces/Time"
                && part(seconds) == (Kind::Signed(4), Count::One)
                && part(nanoseconds) == (Kind::Unsigned(4), Count::One) =>
        {
            return Ok(End::Stamp);
        }
        (_, Kind::Text | Kind::Message(_), _) | (Takes::Stamp, ..) => {}
        (Takes::Number | Takes::Yaw, ..) => return Ok(End::Number),
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

    fn resolved(name: &str, path: &str, takes: Takes) -> Result<Target, String> {
        let definition = Definition::parse(name, "").unwrap();
        Path::parse(path).unwrap().resolve(&definition, takes)
    }

    #[test]
    fn a_path_leads_to_a_number_a_yaw_or_a_time() {
        let body = "rigidbodies[rigid_body_name=a.b].pose";
        let target = resolved(
            "mocap4r2_msgs/msg/RigidBodies",
            &format!("{body}.orientation"),
            Takes::Yaw,
        );
        let named = Pick::Named {
            key: 0,
            value: "a.b".to_owned(),
        };
        let steps = [(2, named), (2, Pick::Whole), (1, Pick::Whole)];
        let steps = steps.map(|(field, pick)| Step { field, pick }).to_vec();
        assert_eq!(
            target,
            Ok(Target {
                steps,
                end: End::Yaw
            })
        );
        let button = resolved("sensor_msgs/Joy", "buttons[4]", Takes::Number).unwrap();
        assert_eq!(button.end, End::Number);
        let stamp = resolved("sensor_msgs/Joy", "header.stamp", Takes::Stamp).unwrap();
        assert_eq!(stamp.end, End::Stamp);
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
            let error = resolved("sensor_msgs/Joy", path, takes).unwrap_err();
            assert_eq!(error, expected);
        }
        for path in [
            "", ".", "a.", "a[", "a[]", "a[x]", "a[=x]", "a[1]b", "[1]", "a..b",
        ] {
            assert_eq!(Path::parse(path), None, "{path}");
        }
    }
}
