//! Enumerations in messages: `uint8` on the wire, constants in the schema, words in
//! JSON. Their declarations give each value its number and its word.

use serde::{Deserialize, Deserializer, Serialize, Serializer, de::Error};
use singletrack_control::SlowedBy;
use singletrack_control::words;
use singletrack_mocap::{CaptureTimeSource, RejectReason};
use singletrack_pilot::{
    BoardRequest, BoardState, Filtering, LinkState, Mode, PilotRequest, PoseMissing, Reason,
    SetpointRefusal,
};
use singletrack_protocol::{BoardMode, ImuState, RefusalReason, ResetCause, StopCause};

use super::{
    Definition,
    field::{Field, Represents},
};
use crate::{
    Level, LinkPhase,
    value::{Value, Visitor},
};

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

fn declare<C: Coded>(optional: bool, name: &str, definition: &mut Definition) {
    // The constants of a second field of the same type have its name.
    let prefix = match definition.has_constants(C::PREFIX) {
        true => name.to_uppercase(),
        false => C::PREFIX.to_owned(),
    };
    if optional {
        definition.plain("uint8", &format!("{prefix}_NONE=0"));
    }
    let mut values = C::CODED.to_vec();
    values.sort_by_key(|value| value.code());
    for value in values {
        let word = value.word().to_uppercase().replace('-', "_");
        definition.plain("uint8", &format!("{prefix}_{word}={}", value.code()));
    }
    definition.plain("uint8", name);
}

fn from_code<C: Coded, E: Error>(code: u8) -> Result<C, E> {
    C::CODED
        .iter()
        .copied()
        .find(|value| value.code() == code)
        .ok_or_else(|| E::custom(format!("{code} is none of the {}_ constants", C::PREFIX)))
}

/// A value by its number.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Code<C>(pub(crate) C);

impl<C: Coded> Serialize for Code<C> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        self.0.code().serialize(serializer)
    }
}

impl<'de, C: Coded> Deserialize<'de> for Code<C> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        from_code(u8::deserialize(deserializer)?).map(Self)
    }
}

/// A value by its number, or 0 for none.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct OptionalCode<C>(pub(crate) Option<C>);

impl<C: Coded> Serialize for OptionalCode<C> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        self.0.map_or(0, Coded::code).serialize(serializer)
    }
}

impl<'de, C: Coded> Deserialize<'de> for OptionalCode<C> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        match u8::deserialize(deserializer)? {
            0 => Ok(Self(None)),
            code => from_code(code).map(|value| Self(Some(value))),
        }
    }
}

impl<C: Coded> Field for Code<C> {
    fn declare(name: &'static str, definition: &mut Definition) {
        declare::<C>(false, name, definition);
    }

    fn absent() -> Self {
        Self(C::FIRST)
    }

    fn visit(&self, name: &'static str, visitor: &mut dyn Visitor) {
        visitor.value(name, Value::Text(self.0.word().into()));
    }
}

impl<C: Coded> Field for OptionalCode<C> {
    fn declare(name: &'static str, definition: &mut Definition) {
        declare::<C>(true, name, definition);
    }

    fn absent() -> Self {
        Self(None)
    }

    fn visit(&self, name: &'static str, visitor: &mut dyn Visitor) {
        visitor.value(
            name,
            self.0
                .map_or(Value::Absent, |value| Value::Text(value.word().into())),
        );
    }
}

impl<C: Coded> Represents<C> for Code<C> {
    fn of(value: &C) -> Self {
        Self(*value)
    }

    fn value(self) -> Result<C, String> {
        Ok(self.0)
    }
}

impl<C: Coded> Represents<Option<C>> for OptionalCode<C> {
    fn of(value: &Option<C>) -> Self {
        Self(*value)
    }

    fn value(self) -> Result<Option<C>, String> {
        Ok(self.0)
    }
}

/// Gives an enumeration the prefix of its constants. The number of a value is its discriminant,
/// plus one where that counts from zero.
macro_rules! codes {
    ($($type:ident $(+ $one:literal)? as $prefix:literal,)*) => {
        $(
            impl $crate::message::code::Coded for $type {
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
