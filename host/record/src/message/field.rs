//! What a field of a message can be.

use serde::{Deserialize, Deserializer, Serialize, Serializer, de::DeserializeOwned};

use super::{Message, PACKAGE};
use crate::value::{Value, Visitor};

/// A field's type: how the schema declares it and how its value is shown.
pub(crate) trait Field: Clone + Serialize + DeserializeOwned {
    /// Adds it to the definition of the message that it is a field of.
    fn declare(name: &'static str, definition: &mut Definition);

    /// What is encoded where there is no value.
    fn absent() -> Self;

    /// Shows it.
    fn visit(&self, name: &'static str, visitor: &mut dyn Visitor);

    /// Shows that it is absent.
    fn visit_absent(name: &'static str, visitor: &mut dyn Visitor) {
        visitor.value(name, Value::Absent);
    }
}

/// The schema of a message under construction.
#[derive(Default)]
pub(crate) struct Definition {
    text: String,
    /// The messages within it, by the names they are referred to.
    nested: Vec<(String, String)>,
}

impl Definition {
    /// Adds a comment, given as the text of a documentation line.
    pub(crate) fn comment(&mut self, text: &str) {
        self.text.push('#');
        self.text.push_str(text);
        self.text.push('\n');
    }

    /// Adds an empty line.
    pub(crate) fn blank(&mut self) {
        self.text.push('\n');
    }

    /// Adds a field of a type that ROS knows.
    pub(crate) fn plain(&mut self, kind: &str, name: &str) {
        self.text.push_str(&format!("{kind} {name}\n"));
    }

    /// Adds a field of type `M`, or an array of it.
    pub(crate) fn nested<M: Message>(&mut self, name: &str, array: &str) {
        self.message(&format!("{PACKAGE}/{}", M::NAME), M::define, name, array);
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

macro_rules! plain {
    ($($type:ty as $kind:literal, $absent:expr, |$value:ident| $shown:expr;)*) => {
        $(
            impl Field for $type {
                fn declare(name: &'static str, definition: &mut Definition) {
                    definition.plain($kind, name);
                }

                fn absent() -> Self {
                    $absent
                }

                fn visit(&self, name: &'static str, visitor: &mut dyn Visitor) {
                    let $value = self;
                    visitor.value(name, $shown);
                }
            }
        )*
    };
}

plain! {
    bool as "bool", false, |value| Value::Bool(*value);
    u8 as "uint8", 0, |value| Value::Unsigned((*value).into());
    u16 as "uint16", 0, |value| Value::Unsigned((*value).into());
    u32 as "uint32", 0, |value| Value::Unsigned((*value).into());
    u64 as "uint64", 0, |value| Value::Unsigned(*value);
    i16 as "int16", 0, |value| Value::Signed((*value).into());
    i32 as "int32", 0, |value| Value::Signed((*value).into());
    i64 as "int64", 0, |value| Value::Signed(*value);
    f64 as "float64", f64::NAN, |value| Value::Float(*value);
    String as "string", Self::new(), |value| Value::Text(value.clone().into());
}

impl<M: Message + Field> Field for Vec<M> {
    fn declare(name: &'static str, definition: &mut Definition) {
        definition.nested::<M>(name, "[]");
    }

    fn absent() -> Self {
        Self::new()
    }

    fn visit(&self, name: &'static str, visitor: &mut dyn Visitor) {
        visitor.list(name, self.len(), &|index, inner| {
            if let Some(element) = self.get(index) {
                Message::visit(element, inner);
            }
        });
    }
}

/// A field that may be absent: on the wire a flag, then the value or, where
/// there is none, what stands for it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Maybe<T>(pub(crate) Option<T>);

impl<T> Maybe<T> {
    /// From something that may be absent.
    pub(crate) fn from<U: Into<T>>(value: Option<U>) -> Self {
        Self(value.map(Into::into))
    }
}

impl<T: Field> Serialize for Maybe<T> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match &self.0 {
            Some(value) => (true, value).serialize(serializer),
            None => (false, T::absent()).serialize(serializer),
        }
    }
}

impl<'de, T: Field> Deserialize<'de> for Maybe<T> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let (present, value) = <(bool, T)>::deserialize(deserializer)?;
        Ok(Self(present.then_some(value)))
    }
}

impl<T: Field> Field for Maybe<T> {
    fn declare(name: &'static str, definition: &mut Definition) {
        definition.plain("bool", &format!("has_{name}"));
        T::declare(name, definition);
    }

    fn absent() -> Self {
        Self(None)
    }

    fn visit(&self, name: &'static str, visitor: &mut dyn Visitor) {
        match &self.0 {
            Some(value) => value.visit(name, visitor),
            None => T::visit_absent(name, visitor),
        }
    }
}
