//! Enumerations in messages: `uint8` on the wire, constants in the schema, words in
//! JSON.

use serde::{Deserialize, Deserializer, Serialize, Serializer, de::Error};
use singletrack_control::SlowedBy;
use singletrack_mocap::{CaptureTimeSource, RejectReason};
use singletrack_pilot::{
    BoardRequest, BoardState, Filtering, LinkState, Mode, PilotRequest, PoseMissing, Reason,
    SetpointRefusal,
};
use singletrack_protocol::{BoardMode, ImuState, RefusalReason, ResetCause, StopCause};

use super::{
    definition::Definition,
    field::{Field, InvalidMessage, Represents},
};
use crate::{
    Level, LinkPhase,
    value::{Value, Visitor},
};

/// An enumeration each of whose values has a number in a record.
pub(crate) trait Coded: Copy + PartialEq + 'static {
    /// The prefix of the constants in the schema.
    const PREFIX: &'static str;
    /// All values, in the order of the schema; the first stands where a message is
    /// absent.
    const CODED: &'static [Self];

    /// The number, from 1: 0 stands for none. It never changes its meaning.
    fn code(self) -> u8;

    /// The word.
    fn word(self) -> &'static str;
}

fn declare<C: Coded>(optional: bool, name: &str, definition: &mut Definition) {
    if optional {
        definition.plain("uint8", &format!("{}_NONE=0", C::PREFIX));
    }
    for value in C::CODED {
        let word = value.word().to_uppercase().replace('-', "_");
        definition.plain("uint8", &format!("{}_{word}={}", C::PREFIX, value.code()));
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

    fn value(self) -> Result<C, InvalidMessage> {
        Ok(self.0)
    }
}

impl<C: Coded> Represents<Option<C>> for OptionalCode<C> {
    fn of(value: &Option<C>) -> Self {
        Self(*value)
    }

    fn value(self) -> Result<Option<C>, InvalidMessage> {
        Ok(self.0)
    }
}

/// Gives each value of an enumeration its number; the enumeration has the word. The
/// match makes sure that no value is left out.
macro_rules! codes {
    ($($type:ident as $prefix:literal { $first:ident = $first_code:literal,
        $($value:ident = $code:literal,)* })*) => {
        $(
            impl Coded for $type {
                const PREFIX: &'static str = $prefix;
                const CODED: &'static [Self] = &[Self::$first, $(Self::$value,)*];

                fn code(self) -> u8 {
                    match self {
                        Self::$first => $first_code,
                        $(Self::$value => $code,)*
                    }
                }

                fn word(self) -> &'static str {
                    self.name()
                }
            }

            impl Field for Code<$type> {
                fn declare(name: &'static str, definition: &mut Definition) {
                    declare::<$type>(false, name, definition);
                }

                fn absent() -> Self {
                    Self($type::$first)
                }

                fn visit(&self, name: &'static str, visitor: &mut dyn Visitor) {
                    visitor.value(name, Value::Text(self.0.name().into()));
                }
            }
        )*
    };
}

/// Declares an enumeration that only messages have: each value with its number and its
/// word.
macro_rules! kinds {
    (
        $(#[doc = $about:literal])*
        $type:ident as $prefix:literal { $($value:ident = $code:literal $word:literal,)* }
    ) => {
        $(#[doc = $about])*
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        pub(crate) enum $type {
            $($value,)*
        }

        impl $type {
            const fn name(self) -> &'static str {
                match self {
                    $(Self::$value => $word,)*
                }
            }
        }

        codes! { $type as $prefix { $($value = $code,)* } }
    };
}

kinds! {
    /// Which kind of event it is.
    EventKind as "KIND" {
        Pose = 1 "pose",
        PoseMissing = 2 "pose-missing",
        Board = 3 "board",
        Link = 4 "link",
        Request = 5 "request",
        ArmRefused = 6 "arm-refused",
        Health = 7 "health",
        Line = 8 "line",
        RealTime = 9 "real-time",
        Setpoint = 10 "setpoint",
        Reconfigured = 11 "reconfigured",
        Attitude = 12 "attitude",
        Proved = 13 "proved",
        Jog = 14 "jog",
        TrajectoryPiece = 15 "trajectory-piece",
        Tuning = 16 "tuning",
    }
}

kinds! {
    /// The state of the car in a frame of the motion capture.
    PoseKind as "STATE" {
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

kinds! {
    /// The binding of the name of the car by the model definitions.
    BindingKind as "BINDING" {
        Unresolved = 1 "unresolved",
        Bound = 2 "bound",
        Missing = 3 "missing",
        Ambiguous = 4 "ambiguous",
    }
}

codes! {
    Filtering as "FILTERING" {
        None = 1,
        Limited = 2,
        Scaled = 3,
        Stopped = 4,
    }
    Mode as "MODE" {
        Disconnected = 1,
        Idle = 2,
        Ready = 3,
        Arming = 4,
        Driving = 5,
        Stopping = 6,
        Fault = 7,
        Slowing = 8,
        Jogging = 9,
    }
    Reason as "REASON" {
        LinkDown = 1,
        BoardBooting = 2,
        BoardFailsafe = 3,
        EmergencyStop = 4,
        BoardRefused = 5,
        BoardTimeout = 6,
        ImuSilent = 7,
        NoPose = 8,
        PoseTooOld = 9,
        PoseImplausible = 10,
        EstimateUnsettled = 11,
        Moving = 12,
        ReferenceFinished = 13,
        Requested = 14,
        LawSingular = 15,
        BoardArmed = 16,
        VersionDiffers = 17,
        ConfigurationRefused = 18,
        StopInputOpen = 19,
        LineNoisy = 20,
        BatteryUnknown = 21,
        BatteryLow = 22,
        RealTimeUnknown = 23,
        RealTimeRefused = 24,
        DeadlineMissed = 25,
        ImuImplausible = 26,
        ImuStuck = 27,
        ImuNotStill = 28,
        BlindTooFar = 29,
        OutsideFence = 30,
        MotorSpeedMismatch = 31,
        Overspeed = 32,
        SetpointStale = 33,
        OperatorGone = 34,
        TimeUp = 35,
        StopNotObeyed = 36,
        BrakesLessThanConfigured = 37,
        SteeringReversed = 38,
        SteeringDiffers = 39,
        GyroDiffers = 40,
        BodyYawWrong = 41,
        AccelerometerDiffers = 42,
        PoseFrozen = 43,
        PoseHeight = 44,
        ImuTilted = 45,
        TiltDiffers = 46,
        SideslipImplausible = 47,
        EstimateInconsistent = 48,
        CaptureTimeUncertain = 49,
        RunsAtNeutral = 50,
        BatteryOpen = 51,
        ImuFault = 52,
        PosesTooRare = 53,
    }
    BoardRequest as "BOARD_REQUEST" {
        Arm = 1,
        Disarm = 2,
        EmergencyStop = 3,
    }
    LinkPhase as "LINK" {
        Disconnected = 1,
        Greeting = 2,
        VersionMismatch = 3,
        Configuring = 4,
        ConfigurationRefused = 5,
        Ready = 6,
    }
    SetpointRefusal as "SETPOINT_REFUSED" {
        NotFinite = 1,
        OutOfRange = 2,
        Future = 3,
        Old = 4,
        Superseded = 5,
        Incomplete = 6,
        NotExternal = 7,
    }
    SlowedBy as "SLOWED_BY" {
        Tyres = 1,
        Steering = 2,
        SteeringRate = 3,
        Speed = 4,
        Behind = 5,
        Geofence = 6,
    }
    PoseMissing as "POSE_MISSING" {
        Untracked = 1,
        Absent = 2,
        Stale = 3,
        Rejected = 4,
        Untrustworthy = 5,
    }
    BoardState as "STATE" {
        Booting = 1,
        Neutral = 2,
        Armed = 3,
        Driving = 4,
        Failsafe = 5,
        EmergencyStopped = 6,
        PoweringUp = 7,
        RunsAtNeutral = 8,
        Jogging = 9,
    }
    LinkState as "LINK" {
        Down = 1,
        Ready = 2,
        VersionDiffers = 3,
        ConfigurationRefused = 4,
        EmergencyStopped = 5,
    }
    PilotRequest as "REQUEST" {
        Arm = 1,
        Disarm = 2,
        EmergencyStop = 3,
        ArmHeld = 4,
        Hold = 5,
        OperatorGone = 6,
        TimeUp = 7,
        ArmJog = 8,
        Halt = 9,
        Carried = 10,
    }
    BoardMode as "MODE" {
        Boot = 1,
        Neutral = 2,
        Armed = 3,
        Driving = 4,
        Failsafe = 5,
        EmergencyStopped = 6,
        PoweringUp = 7,
        Jogging = 8,
    }
    StopCause as "STOP_CAUSE" {
        None = 1,
        Disarmed = 2,
        CommandTimeout = 3,
        PoseTooOld = 4,
        MotorSensor = 5,
        StopInput = 6,
        EmergencyStop = 7,
        HostRestarted = 8,
        RunsAtNeutral = 9,
        JogTimeout = 10,
        JogTooFast = 11,
        JogTooLong = 12,
    }
    ImuState as "IMU" {
        Silent = 1,
        Fresh = 2,
        Repeated = 3,
    }
    ResetCause as "RESET_CAUSE" {
        PowerOn = 1,
        External = 2,
        BrownOut = 3,
        Watchdog = 4,
        Unknown = 5,
    }
    RefusalReason as "REFUSAL" {
        None = 1,
        NotConfigured = 2,
        ConfigurationDiffers = 3,
        InvalidConfiguration = 4,
        Busy = 5,
        NotYetNeutral = 6,
        Moving = 7,
        StopInputOpen = 8,
        EmergencyStopLatched = 9,
        Stale = 10,
        OutOfSequence = 11,
        PoseTooOld = 12,
        NotArmed = 13,
        ReverseDisabled = 14,
        VersionDiffers = 15,
        OtherCar = 16,
    }
    RejectReason as "REJECTED" {
        NotFinite = 1,
        NotUnitQuaternion = 2,
        DuplicateId = 3,
        MeanError = 4,
        CaptureTime = 5,
        Jump = 6,
        Flip = 7,
    }
    CaptureTimeSource as "SOURCE" {
        MidExposureEcho = 1,
        MidExposureMinDelay = 2,
        FrameTimestamp = 3,
    }
    // The numbers of ROS's own log levels.
    Level as "LEVEL" {
        Debug = 10,
        Info = 20,
        Warning = 30,
        Error = 40,
    }
}
