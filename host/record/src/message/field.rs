//! The types that a field of a message can have; among them positions and velocities on the floor.

use serde::{Deserialize, Deserializer, Serialize, Serializer, de::DeserializeOwned};
use singletrack_control::{Position, Time, Velocity};
use singletrack_protocol::Sequence;

use super::{
    Definition,
    declare::{Fields, Message, declare, fields, message},
};
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

/// A field's type as the form in which a message holds a `T` of the record.
pub(crate) trait Represents<T>: Sized {
    /// The form of `value`.
    fn of(value: &T) -> Self;

    /// The value that has this form.
    ///
    /// # Errors
    ///
    /// When no value has it.
    fn value(self) -> Result<T, String>;
}

/// Takes the parts that a message of a certain kind must have, here named for errors.
#[derive(Clone, Copy)]
pub(crate) struct Part(pub(crate) &'static str);

impl Part {
    /// The value of a part.
    pub(crate) fn take<T>(
        self,
        field: impl Represents<Option<T>>,
        part: &'static str,
    ) -> Result<T, String> {
        let kind = self.0;
        field
            .value()?
            .ok_or_else(|| format!("{kind} without {part}"))
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

            impl Represents<$type> for $type {
                fn of(value: &$type) -> Self {
                    value.clone()
                }

                fn value(self) -> Result<$type, String> {
                    Ok(self)
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

impl Represents<Time> for u64 {
    fn of(time: &Time) -> Self {
        time.0
    }

    fn value(self) -> Result<Time, String> {
        Ok(Time(self))
    }
}

impl Represents<Sequence> for u8 {
    fn of(sequence: &Sequence) -> Self {
        sequence.0
    }

    fn value(self) -> Result<Sequence, String> {
        Ok(Sequence(self))
    }
}

impl<M: Message + Field> Field for Vec<M> {
    fn declare(name: &'static str, definition: &mut Definition) {
        declare::<M>(name, "[]", definition);
    }

    fn absent() -> Self {
        Self::new()
    }

    fn visit(&self, name: &'static str, visitor: &mut dyn Visitor) {
        visitor.list(name, self.len(), &|index, inner| {
            if let Some(element) = self.get(index) {
                Fields::visit(element, inner);
            }
        });
    }
}

impl<M: Represents<T>, T, const MAX: usize> Represents<heapless::Vec<T, MAX>> for Vec<M> {
    fn of(values: &heapless::Vec<T, MAX>) -> Self {
        values.iter().map(M::of).collect()
    }

    fn value(self) -> Result<heapless::Vec<T, MAX>, String> {
        if self.len() > MAX {
            let count = self.len();
            return Err(format!("{count} events in a tick, which has at most {MAX}"));
        }
        self.into_iter().map(M::value).collect()
    }
}

/// A field that may be absent: on the wire a flag, then the value or, where there is
/// none, [`Field::absent`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Maybe<T>(pub(crate) Option<T>);

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

impl<F: Represents<T>, T> Represents<Option<T>> for Maybe<F> {
    fn of(value: &Option<T>) -> Self {
        Self(value.as_ref().map(F::of))
    }

    fn value(self) -> Result<Option<T>, String> {
        self.0.map(F::value).transpose()
    }
}

/// A group of fields that stand among those of the message, without a name of their
/// own.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(transparent)]
pub(crate) struct Group<G>(pub(crate) G);

impl<G: Fields> Field for Group<G> {
    fn declare(_: &'static str, definition: &mut Definition) {
        definition.group(G::define);
    }

    fn absent() -> Self {
        Self(G::absent())
    }

    #[inline]
    fn visit(&self, _: &'static str, visitor: &mut dyn Visitor) {
        self.0.visit(visitor);
    }
}

impl<G: Represents<T>, T> Represents<T> for Group<G> {
    fn of(value: &T) -> Self {
        Self(G::of(value))
    }

    fn value(self) -> Result<T, String> {
        self.0.value()
    }
}

/// Declares a message that has the two parts of a vector.
macro_rules! vector {
    (
        $(#[doc = $about:literal])*
        $type:ident as $name:literal of $vector:ident { $x:ident, $y:ident }
    ) => {
        message! { $(#[doc = $about])* $type as $name { $x: f64, $y: f64, } }

        impl Represents<$vector> for $type {
            fn of(vector: &$vector) -> Self {
                Self { $x: vector.x, $y: vector.y }
            }

            fn value(self) -> Result<$vector, String> {
                Ok($vector::new(self.$x, self.$y))
            }
        }
    };
}

vector! {
    /// A position on the floor, world frame.
    PointMessage as "Point" of Position { x_m, y_m }
}

vector! {
    /// A velocity on the floor, world frame.
    VelocityMessage as "Velocity" of Velocity { x_m_s, y_m_s }
}

vector! {
    /// Gains of the position loop, world frame.
    GainMessage as "Gain" of Velocity { x_per_s, y_per_s }
}
