//! The types that a field of a message can have; among them positions and velocities on the floor, and
//! enumerations: `uint8` on the wire, constants in the schema, words in JSON. Their declarations give
//! each value its number and its word.

use serde::{
    Deserialize, Deserializer, Serialize, Serializer,
    de::{DeserializeOwned, Error},
};
use singletrack_control::{Position, SlowedBy, Time, Velocity, words};
use singletrack_mocap::{CaptureTimeSource, RejectReason};
use singletrack_pilot::{
    BoardRequest, BoardState, Filtering, LinkState, Mode, PilotRequest, PoseMissing, Reason,
    SetpointRefusal,
};
use singletrack_protocol::{BoardMode, ImuState, RefusalReason, ResetCause, Sequence, StopCause};

use super::{Definition, Fields, Message, declare, fields, message};
use crate::{
    Level, LinkPhase,
    value::{Value, Visitor},
};

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

/// An enumeration each of whose values has a number in a record.
pub(crate) trait Coded: Copy + PartialEq + 'static {
    /// The prefix of the constants in the schema, for the first field of a message.
    const PREFIX: &'static str;
    /// All values.
    const CODED: &'static [Self];
    /// What stands where a message is absent: the value with the lowest number.
    const FIRST: Self;

    /// The number, from 1: 0 stands for none. It never changes its meaning.
    fn code(self) -> u8;

    /// The word.
    fn word(self) -> &'static str;
}

/// What one number stands for: a value, or, where there may be none, a value or none, which is 0.
pub(crate) trait Numbered: Copy {
    /// The enumeration.
    type Kind: Coded;

    /// What stands where a message is absent.
    const ABSENT: Self;

    /// The value, if there is one.
    fn kind(self) -> Option<Self::Kind>;

    /// What stands for this value or for none; `None` if there must be one.
    fn of(kind: Option<Self::Kind>) -> Option<Self>;
}

impl<C: Coded> Numbered for C {
    type Kind = C;

    const ABSENT: Self = C::FIRST;

    fn kind(self) -> Option<C> {
        Some(self)
    }

    fn of(kind: Option<C>) -> Option<Self> {
        kind
    }
}

impl<C: Coded> Numbered for Option<C> {
    type Kind = C;

    const ABSENT: Self = None;

    fn kind(self) -> Self {
        self
    }

    fn of(kind: Self) -> Option<Self> {
        Some(kind)
    }
}

/// A value, or perhaps none, by its number.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Code<N>(pub(crate) N);

impl<N: Numbered> Serialize for Code<N> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let code = self.0.kind().map_or(0, Coded::code);
        code.serialize(serializer)
    }
}

impl<'de, N: Numbered> Deserialize<'de> for Code<N> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let code = u8::deserialize(deserializer)?;
        let mut values = N::Kind::CODED.iter().copied();
        let kind = values.find(|value| value.code() == code);
        let number = N::of(kind).filter(|_| kind.is_some() || code == 0);
        number.map(Self).ok_or_else(|| {
            let prefix = N::Kind::PREFIX;
            D::Error::custom(format!("{code} is none of the {prefix}_ constants"))
        })
    }
}

impl<N: Numbered> Field for Code<N> {
    fn declare(name: &'static str, definition: &mut Definition) {
        let prefix = N::Kind::PREFIX;
        // The constants of a second field of the same type have its name.
        let prefix = match definition.has_constants(prefix) {
            true => name.to_uppercase(),
            false => prefix.to_owned(),
        };
        if N::of(None).is_some() {
            definition.plain("uint8", &format!("{prefix}_NONE=0"));
        }
        let mut values = N::Kind::CODED.to_vec();
        values.sort_by_key(|value| value.code());
        for value in values {
            let word = value.word().to_uppercase().replace('-', "_");
            definition.plain("uint8", &format!("{prefix}_{word}={}", value.code()));
        }
        definition.plain("uint8", name);
    }

    fn absent() -> Self {
        Self(N::ABSENT)
    }

    fn visit(&self, name: &'static str, visitor: &mut dyn Visitor) {
        let word = |kind: N::Kind| Value::Text(kind.word().into());
        visitor.value(name, self.0.kind().map_or(Value::Absent, word));
    }
}

impl<N: Numbered> Represents<N> for Code<N> {
    fn of(value: &N) -> Self {
        Self(*value)
    }

    fn value(self) -> Result<N, String> {
        Ok(self.0)
    }
}

/// Gives an enumeration the prefix of its constants. The number of a value is its discriminant,
/// plus one where that counts from zero.
macro_rules! codes {
    ($($type:ident $(+ $one:literal)? as $prefix:literal,)*) => {
        $(
            impl $crate::message::field::Coded for $type {
                const PREFIX: &'static str = $prefix;
                const CODED: &'static [Self] = &Self::ALL;
                const FIRST: Self = Self::ALL[0];

                fn code(self) -> u8 {
                    self as u8 $(+ $one)?
                }

                fn word(self) -> &'static str {
                    self.name()
                }
            }
        )*
    };
}

words! {
    /// The state of the car in a frame of the motion capture, which only messages have.
    pub(crate) enum PoseKind {
        NoFrames = 1 "no-frames",
        Unbound = 2 "unbound",
        Valid = 3 "valid",
        Untracked = 4 "untracked",
        Absent = 5 "absent",
        Rejected = 6 "rejected",
        LockedOut = 7 "locked-out",
        Stale = 8 "stale",
    }
}

words! {
    /// The binding of the name of the car by the model definitions, which only messages have.
    pub(crate) enum BindingKind {
        Unresolved = 1 "unresolved",
        Bound = 2 "bound",
        Missing = 3 "missing",
        Ambiguous = 4 "ambiguous",
    }
}

codes! {
    PoseKind as "STATE",
    BindingKind as "BINDING",
    Filtering as "FILTERING",
    Mode as "MODE",
    Reason as "REASON",
    BoardRequest as "BOARD_REQUEST",
    LinkPhase as "LINK",
    SetpointRefusal as "SETPOINT_REFUSED",
    SlowedBy + 1 as "SLOWED_BY",
    PoseMissing as "POSE_MISSING",
    BoardState as "STATE",
    LinkState as "LINK",
    BoardMode + 1 as "MODE",
    StopCause + 1 as "STOP_CAUSE",
    ImuState + 1 as "IMU",
    ResetCause + 1 as "RESET_CAUSE",
    RefusalReason + 1 as "REFUSAL",
    RejectReason + 1 as "REJECTED",
    CaptureTimeSource + 1 as "SOURCE",
    Level as "LEVEL",
}

impl Coded for PilotRequest {
    const PREFIX: &'static str = "REQUEST";
    const CODED: &'static [Self] = &Self::ALL;
    const FIRST: Self = Self::ALL[0];

    fn code(self) -> u8 {
        self.number()
    }

    fn word(self) -> &'static str {
        self.name()
    }
}

pub(super) use codes;
