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
