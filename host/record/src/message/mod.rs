//! The messages of a record. Each is declared once: the type that is encoded, the
//! `ros2msg` schema in the file, the fields that are printed and the conversion from
//! and to the record's own types all follow from that declaration.
//!
//! The documentation of a field is its comment in the schema. A value that may be
//! absent takes two fields there, `bool has_x` and `x`, because ROS messages have no
//! options.

mod code;
mod declare;
mod event;
mod field;
mod report;
mod tick;

use std::mem;

pub(crate) use code::Coded;
#[cfg(test)]
pub(crate) use declare::ENCAPSULATION;
pub(crate) use declare::{Fields, decode, encode, schema_name, schema_text};
pub(crate) use field::Represents;
pub(crate) use report::{
    ConfigurationMessage, DropsMessage, LogMessage, PoseMessage, StatusMessage, TelemetryMessage,
};
pub(crate) use tick::TickMessage;

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
        if self.nested.iter().any(|(known, _)| *known == kind) {
            return;
        }
        let mut inner = Self::default();
        define(&mut inner);
        self.nested.push((kind.to_owned(), inner.text));
        for (kind, text) in inner.nested {
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
