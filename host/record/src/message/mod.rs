//! The messages of a record. Each is declared once: the type that is encoded, the
//! `ros2msg` schema in the file, the fields that are printed and the conversion from
//! and to the record's own types all follow from that declaration, whose macros stand here. The encoding is
//! plain CDR, as in ROS 2.
//!
//! The documentation of a field is its comment in the schema. A value that may be
//! absent takes two fields there, `bool has_x` and `x`, because ROS messages have no
//! options.

mod event;
mod field;
mod report;
mod tick;

use std::{iter, mem};

use byteorder::LittleEndian;
use serde::{Serialize, de::DeserializeOwned};

pub(crate) use field::{Coded, Represents};
pub(crate) use report::{
    ConfigurationMessage, DropsMessage, LogMessage, PoseMessage, StatusMessage, TelemetryMessage,
};
pub(crate) use tick::TickMessage;

use crate::value::Visitor;

/// The schema of a message under construction.
#[derive(Default)]
pub(crate) struct Definition {
    text: String,
    /// The messages within it, by the names that refer to them.
    nested: Vec<(String, String)>,
    /// Whether the next field continues the group that a comment has begun.
    in_group: bool,
}

impl Definition {
    /// Adds a comment, given as the text of a documentation line.
    pub(crate) fn comment(&mut self, text: &str) {
        self.text.push('#');
        self.text.push_str(text);
        self.text.push('\n');
    }

    /// Begins a field with its comments. An empty line separates it from the text
    /// before, except the first field of a group from the comment of the group.
    pub(crate) fn begin_field(&mut self, comments: &[&str]) {
        if !mem::take(&mut self.in_group) {
            self.text.push('\n');
        }
        for comment in comments {
            self.comment(comment);
        }
    }

    /// Adds the fields of a group to the message. The comment before the first of
    /// them is that of the group.
    pub(crate) fn group(&mut self, define: impl FnOnce(&mut Self)) {
        self.in_group = true;
        define(self);
    }

    /// Adds a field of a type that ROS knows.
    pub(crate) fn plain(&mut self, kind: &str, name: &str) {
        self.text.push_str(&format!("{kind} {name}\n"));
    }

    /// Whether the message has constants with this prefix.
    pub(crate) fn has_constants(&self, prefix: &str) -> bool {
        self.text.contains(&format!("uint8 {prefix}_"))
    }

    /// Adds a field that is a message of its own, or an array of it.
    pub(crate) fn message(
        &mut self,
        kind: &str,
        define: impl FnOnce(&mut Self),
        name: &str,
        array: &str,
    ) {
        self.plain(&format!("{kind}{array}"), name);
        let mut inner = Self::default();
        define(&mut inner);
        let own = (kind.to_owned(), inner.text);
        for (kind, text) in iter::once(own).chain(inner.nested) {
            if !self.nested.iter().any(|(known, _)| *known == kind) {
                self.nested.push((kind, text));
            }
        }
    }

    /// The whole schema.
    pub(crate) fn finish(self) -> String {
        let mut text = self.text;
        for (kind, inner) in self.nested {
            text.push_str(&"=".repeat(80));
            text.push_str(&format!("\nMSG: {kind}\n{inner}"));
        }
        text
    }
}

/// The package that all messages belong to.
const PACKAGE: &str = "singletrack_msgs";

/// The fields of a message, or a group of them.
pub(crate) trait Fields: Clone + Serialize + DeserializeOwned {
    /// Adds the fields to a schema.
    fn define(definition: &mut Definition);

    /// What is encoded where the message is absent.
    fn absent() -> Self;

    /// Visits the fields in the order of the schema.
    fn visit(&self, visitor: &mut dyn Visitor);
}

/// A message type.
pub(crate) trait Message: Fields {
    /// Its name within the package.
    const NAME: &'static str;

    /// Its comment in the schema, line by line.
    const ABOUT: &'static [&'static str];
}

/// Adds the definition of a message: its comment, then its fields.
fn define<M: Message>(definition: &mut Definition) {
    for line in M::ABOUT {
        definition.comment(line);
    }
    M::define(definition);
}

/// Adds a field that is a message, or an array of it.
fn declare<M: Message>(name: &str, array: &str, definition: &mut Definition) {
    definition.message(&format!("{PACKAGE}/{}", M::NAME), define::<M>, name, array);
}

/// The name of a message's schema.
pub(crate) fn schema_name<M: Message>() -> String {
    format!("{PACKAGE}/msg/{}", M::NAME)
}

/// The text of a message's schema: its own definition, then those of all messages
/// within it.
pub(crate) fn schema_text<M: Message>() -> String {
    let mut definition = Definition::default();
    define::<M>(&mut definition);
    definition.finish()
}

/// Declares the fields of a message, or a group of them: name and type in the schema.
///
/// After `of` stands the type of the record that the fields represent; a conversion
/// in each direction follows. `= part` names the part of that type that a field
/// represents where its name is another. `=> function` is a value that follows from
/// the whole: it is written for readers of the file and not read back.
macro_rules! fields {
    (
        $(#[doc = $about:literal])*
        $type:ident of $source:ident { $($fields:tt)* }
    ) => {
        fields! { $(#[doc = $about])* $type { $($fields)* } }
        fields! { @represents $type $source { $($fields)* } }
    };
    (
        $(#[doc = $about:literal])*
        $type:ident {
            $(
                $(#[doc = $comment:literal])*
                $field:ident : $kind:ty $(= $part:ident)? $(=> $function:path)?,
            )*
        }
    ) => {
        $(#[doc = $about])*
        #[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
        pub(crate) struct $type {
            $( $(#[doc = $comment])* pub(crate) $field: $kind, )*
        }

        impl $crate::message::Fields for $type {
            fn define(definition: &mut $crate::message::Definition) {
                use $crate::message::field::Field;
                $(
                    definition.begin_field(&[$($comment),*]);
                    <$kind as Field>::declare(stringify!($field), definition);
                )*
            }

            fn absent() -> Self {
                use $crate::message::field::Field;
                Self { $( $field: <$kind as Field>::absent(), )* }
            }

            fn visit(&self, visitor: &mut dyn $crate::value::Visitor) {
                use $crate::message::field::Field;
                $( Field::visit(&self.$field, stringify!($field), visitor); )*
            }
        }
    };
    (
        @represents $type:ident $source:ident {
            $(
                $(#[doc = $comment:literal])*
                $field:ident : $kind:ty $(= $part:ident)? $(=> $function:path)?,
            )*
        }
    ) => {
        impl $crate::message::field::Represents<$source> for $type {
            fn of(source: &$source) -> Self {
                Self {
                    $( $field: fields!(@of source $field $(= $part)? $(=> $function)?), )*
                }
            }

            fn value(self) -> Result<$source, String> {
                fields!(@value self $source {} $( $field $(= $part)? $(=> $function)?, )*)
            }
        }
    };
    (@of $source:ident $field:ident) => {
        $crate::message::field::Represents::of(&$source.$field)
    };
    (@of $source:ident $field:ident = $part:ident) => {
        $crate::message::field::Represents::of(&$source.$part)
    };
    (@of $source:ident $field:ident => $function:path) => {
        $crate::message::field::Represents::of(&$function($source))
    };
    (@value $self:ident $source:ident { $($done:tt)* }) => {
        Ok($source { $($done)* })
    };
    (@value $self:ident $source:ident { $($done:tt)* } $field:ident, $($rest:tt)*) => {
        fields!(@value $self $source {
            $($done)* $field: $crate::message::field::Represents::value($self.$field)?,
        } $($rest)*)
    };
    (@value $self:ident $source:ident { $($done:tt)* }
        $field:ident = $part:ident, $($rest:tt)*
    ) => {
        fields!(@value $self $source {
            $($done)* $part: $crate::message::field::Represents::value($self.$field)?,
        } $($rest)*)
    };
    (@value $self:ident $source:ident { $($done:tt)* }
        $field:ident => $function:path, $($rest:tt)*
    ) => {
        fields!(@value $self $source { $($done)* } $($rest)*)
    };
}

/// Declares a group of fields that represents an array, element by element.
macro_rules! array {
    ($type:ident of [$item:ty; $length:literal] { $($field:ident,)* }) => {
        fields! { $type { $($field: $item,)* } }

        impl $crate::message::field::Represents<[$item; $length]> for $type {
            fn of(value: &[$item; $length]) -> Self {
                let [$($field),*] = *value;
                Self { $($field),* }
            }

            fn value(self) -> Result<[$item; $length], String> {
                Ok([$(self.$field),*])
            }
        }
    };
}

/// Declares a message: a name for [`fields`] that other messages and the file refer to.
macro_rules! message {
    (
        $(#[doc = $about:literal])*
        $type:ident as $name:literal $(of $source:ident)? { $($fields:tt)* }
    ) => {
        fields! { $(#[doc = $about])* $type $(of $source)? { $($fields)* } }

        impl $crate::message::Message for $type {
            const NAME: &'static str = $name;
            const ABOUT: &'static [&'static str] = &[$($about),*];
        }

        impl $crate::message::field::Field for $type {
            fn declare(name: &'static str, definition: &mut $crate::message::Definition) {
                $crate::message::declare::<Self>(name, "", definition);
            }

            fn absent() -> Self {
                $crate::message::Fields::absent()
            }

            fn visit(&self, name: &'static str, visitor: &mut dyn $crate::value::Visitor) {
                visitor.message(name, true, &|inner| {
                    $crate::message::Fields::visit(self, inner);
                });
            }

            fn visit_absent(name: &'static str, visitor: &mut dyn $crate::value::Visitor) {
                visitor.message(name, false, &|inner| {
                    let absent = <Self as $crate::message::Fields>::absent();
                    $crate::message::Fields::visit(&absent, inner);
                });
            }
        }
    };
}

/// Declares a message for the values of an enumeration: the field for the kind, with the number and
/// the word of each, and the field for what that variant of the enumeration holds, with what an
/// error calls it.
macro_rules! choice {
    (
        $(#[doc = $about:literal])*
        $type:ident as $name:literal of $source:ident, $what:literal {
            $kind:ident as $prefix:literal,
            $(
                $number:literal $word:literal
                $variant:ident $(($(#[doc = $comment:literal])* $field:ident: $form:ty, $part:literal))?,
            )*
        }
    ) => {
        singletrack_control::words! {
            pub(crate) enum $kind { $($variant = $number $word,)* }
        }

        $crate::message::field::codes! { $kind as $prefix, }

        message! {
            $(#[doc = $about])*
            $type as $name {
                kind: $crate::message::field::Code<$kind>,
                $($($(#[doc = $comment])* $field: $form,)?)*
            }
        }

        impl $crate::message::field::Represents<$source> for $type {
            fn of(source: &$source) -> Self {
                let of = |kind| Self {
                    kind: $crate::message::field::Code(kind),
                    ..$crate::message::Fields::absent()
                };
                match source {
                    $($source::$variant $(($field))? => Self {
                        $($field: $crate::message::field::Represents::of(&Some(*$field)),)?
                        ..of($kind::$variant)
                    },)*
                }
            }

            fn value(self) -> Result<$source, String> {
                let part = $crate::message::field::Part($what);
                Ok(match self.kind.0 {
                    $($kind::$variant => $source::$variant $((part.take(self.$field, $part)?))?,)*
                })
            }
        }
    };
}

use {array, choice, fields, message};

/// The header of a ROS 2 message: plain CDR, little-endian, no options.
pub(crate) const ENCAPSULATION: [u8; 4] = [0x00, 0x01, 0x00, 0x00];

/// Adds a message with its header to `bytes`.
pub(crate) fn encode(
    message: &impl Serialize,
    bytes: &mut Vec<u8>,
) -> Result<(), cdr_encoding::Error> {
    bytes.extend_from_slice(&ENCAPSULATION);
    cdr_encoding::to_writer::<_, LittleEndian, _>(bytes, message)
}

/// The message that `bytes` encode, exactly.
pub(crate) fn decode<M: Message>(bytes: &[u8]) -> Result<M, String> {
    let Some(content) = bytes.strip_prefix(&ENCAPSULATION) else {
        return Err(format!(
            "a message begins with {:02x?}, not with the header of little-endian CDR",
            bytes.get(..4).unwrap_or(bytes)
        ));
    };
    let (message, length) =
        cdr_encoding::from_bytes::<M, LittleEndian>(content).map_err(|error| error.to_string())?;
    if length != content.len() {
        return Err(format!(
            "a message of {} has {} bytes too many",
            M::NAME,
            content.len().saturating_sub(length)
        ));
    }
    Ok(message)
}
