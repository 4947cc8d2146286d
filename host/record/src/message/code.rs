//! Names as numbers: `uint8` on the wire, constants in the schema, words in JSON.

use serde::{Deserialize, Deserializer, Serialize, Serializer, de::Error};
use singletrack_mocap::{CaptureTimeSource, RejectReason};
use singletrack_pilot::{BoardRequest, BoardState, LinkState, Mode, PoseMissing, Reason, Request};
use singletrack_protocol::{BoardMode, ImuState, RefusalReason, ResetCause, StopCause};

use super::field::{Definition, Field};
use crate::{
    Level, LinkPhase,
    value::{Value, Visitor},
};

/// A type with a handful of values, each of which has a number and a word.
pub(crate) trait Coded: Copy + PartialEq + 'static {
    /// What the constants begin with.
    const PREFIX: &'static str;
    /// All values; 0 is kept for "none".
    const ALL: &'static [Self];

    /// The number. Never changes its meaning.
    fn code(self) -> u8;

    /// The word.
    fn word(self) -> &'static str;
}

fn declare<C: Coded>(optional: bool, name: &str, definition: &mut Definition) {
    if optional {
        definition.plain("uint8", &format!("{}_NONE=0", C::PREFIX));
    }
    for value in C::ALL {
        let word = value.word().to_uppercase().replace('-', "_");
        definition.plain("uint8", &format!("{}_{word}={}", C::PREFIX, value.code()));
    }
    definition.plain("uint8", name);
}

fn from_code<C: Coded, E: Error>(code: u8) -> Result<C, E> {
    C::ALL
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

/// Gives each value of an enumeration its number and its word. The match makes
/// sure that none is forgotten. The first stands where a message is absent.
macro_rules! codes {
    ($($type:ident as $prefix:literal { $($value:ident = $code:literal $word:literal,)* })*) => {
        $(
            impl Coded for $type {
                const PREFIX: &'static str = $prefix;
                const ALL: &'static [Self] = &[$(Self::$value,)*];

                fn code(self) -> u8 {
                    match self {
                        $(Self::$value => $code,)*
                    }
                }

                fn word(self) -> &'static str {
                    match self {
                        $(Self::$value => $word,)*
                    }
                }
            }

            impl Field for Code<$type> {
                fn declare(name: &'static str, definition: &mut Definition) {
                    declare::<$type>(false, name, definition);
                }

                fn absent() -> Self {
                    codes!(@first $($type::$value,)*)
                }

                fn visit(&self, name: &'static str, visitor: &mut dyn Visitor) {
                    visitor.value(name, Value::Text(self.0.word().into()));
                }
            }
        )*
    };
    (@first $first:expr, $($rest:expr,)*) => { Code($first) };
}

/// Which kind of event it is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum EventKind {
    Pose,
    PoseMissing,
    Board,
    Link,
    Request,
    ArmRefused,
    Health,
    Line,
    RealTime,
    Setpoint,
    Reconfigured,
}

/// What a frame of the motion capture says of the car.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum PoseKind {
    NoFrames,
    Unbound,
    Valid,
    Untracked,
    Absent,
    Rejected,
    LockedOut,
    Stale,
}

/// What the model definitions say of the car's name.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum BindingKind {
    Unresolved,
    Bound,
    Missing,
    Ambiguous,
}

codes! {
    Mode as "MODE" {
        Disconnected = 1 "disconnected",
        Idle = 2 "idle",
        Ready = 3 "ready",
        Arming = 4 "arming",
        Driving = 5 "driving",
        Stopping = 6 "stopping",
        Fault = 7 "fault",
        Slowing = 8 "slowing",
    }
    Reason as "REASON" {
        LinkDown = 1 "link-down",
        BoardBooting = 2 "board-booting",
        BoardFailsafe = 3 "board-failsafe",
        EmergencyStop = 4 "emergency-stop",
        BoardRefused = 5 "board-refused",
        BoardTimeout = 6 "board-timeout",
        ImuSilent = 7 "imu-silent",
        NoPose = 8 "no-pose",
        PoseTooOld = 9 "pose-too-old",
        PoseImplausible = 10 "pose-implausible",
        EstimateUnsettled = 11 "estimate-unsettled",
        Moving = 12 "moving",
        ReferenceFinished = 13 "reference-finished",
        Requested = 14 "requested",
        LawSingular = 15 "law-singular",
        BoardArmed = 16 "board-armed",
        VersionDiffers = 17 "version-differs",
        ConfigurationRefused = 18 "configuration-refused",
        StopInputOpen = 19 "stop-input-open",
        LineNoisy = 20 "line-noisy",
        BatteryUnknown = 21 "battery-unknown",
        BatteryLow = 22 "battery-low",
        RealTimeUnknown = 23 "real-time-unknown",
        RealTimeRefused = 24 "real-time-refused",
        DeadlineMissed = 25 "deadline-missed",
        ImuImplausible = 26 "imu-implausible",
        ImuStuck = 27 "imu-stuck",
        ImuNotStill = 28 "imu-not-still",
        BlindTooFar = 29 "blind-too-far",
        OutsideFence = 30 "outside-fence",
        MotorSpeedMismatch = 31 "motor-speed-mismatch",
        Overspeed = 32 "overspeed",
        SetpointStale = 33 "setpoint-stale",
    }
    BoardRequest as "BOARD_REQUEST" {
        Arm = 1 "arm",
        Disarm = 2 "disarm",
        EmergencyStop = 3 "emergency-stop",
    }
    LinkPhase as "LINK" {
        Disconnected = 1 "disconnected",
        Greeting = 2 "greeting",
        VersionMismatch = 3 "version-mismatch",
        Configuring = 4 "configuring",
        ConfigurationRefused = 5 "configuration-refused",
        Ready = 6 "ready",
    }
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
    }
    PoseMissing as "POSE_MISSING" {
        Untracked = 1 "untracked",
        Absent = 2 "absent",
        Stale = 3 "stale",
        Rejected = 4 "rejected",
        Untrustworthy = 5 "untrustworthy",
    }
    BoardState as "STATE" {
        Booting = 1 "booting",
        Neutral = 2 "neutral",
        Armed = 3 "armed",
        Driving = 4 "driving",
        Failsafe = 5 "failsafe",
        EmergencyStopped = 6 "emergency-stopped",
    }
    LinkState as "LINK" {
        Down = 1 "down",
        Ready = 2 "ready",
        VersionDiffers = 3 "version-differs",
        ConfigurationRefused = 4 "configuration-refused",
        EmergencyStopped = 5 "emergency-stopped",
    }
    Request as "REQUEST" {
        Arm = 1 "arm",
        Disarm = 2 "disarm",
        EmergencyStop = 3 "emergency-stop",
    }
    BoardMode as "MODE" {
        Boot = 1 "boot",
        Neutral = 2 "neutral",
        Armed = 3 "armed",
        Driving = 4 "driving",
        Failsafe = 5 "failsafe",
        EmergencyStopped = 6 "emergency-stopped",
    }
    StopCause as "STOP_CAUSE" {
        None = 1 "none",
        Disarmed = 2 "disarmed",
        CommandTimeout = 3 "command-timeout",
        PoseTooOld = 4 "pose-too-old",
        MotorSensor = 5 "motor-sensor",
        StopInput = 6 "stop-input",
        EmergencyStop = 7 "emergency-stop",
        HostRestarted = 8 "host-restarted",
    }
    ImuState as "IMU" {
        Silent = 1 "silent",
        Fresh = 2 "fresh",
        Repeated = 3 "repeated",
    }
    ResetCause as "RESET_CAUSE" {
        PowerOn = 1 "power-on",
        External = 2 "external",
        BrownOut = 3 "brown-out",
        Watchdog = 4 "watchdog",
        Unknown = 5 "unknown",
    }
    RefusalReason as "REFUSAL" {
        None = 1 "none",
        NotConfigured = 2 "not-configured",
        ConfigurationDiffers = 3 "configuration-differs",
        InvalidConfiguration = 4 "invalid-configuration",
        Busy = 5 "busy",
        NotYetNeutral = 6 "not-yet-neutral",
        Moving = 7 "moving",
        StopInputOpen = 8 "stop-input-open",
        EmergencyStopLatched = 9 "emergency-stop-latched",
        Stale = 10 "stale",
        OutOfSequence = 11 "out-of-sequence",
        PoseTooOld = 12 "pose-too-old",
        NotArmed = 13 "not-armed",
        ReverseDisabled = 14 "reverse-disabled",
        VersionDiffers = 15 "version-differs",
    }
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
    RejectReason as "REJECTED" {
        NotFinite = 1 "not-finite",
        NotUnitQuaternion = 2 "not-unit-quaternion",
        DuplicateId = 3 "duplicate-id",
        MeanError = 4 "mean-error",
        CaptureTime = 5 "capture-time",
        Jump = 6 "jump",
        Flip = 7 "flip",
    }
    BindingKind as "BINDING" {
        Unresolved = 1 "unresolved",
        Bound = 2 "bound",
        Missing = 3 "missing",
        Ambiguous = 4 "ambiguous",
    }
    CaptureTimeSource as "SOURCE" {
        MidExposureEcho = 1 "mid-exposure-echo",
        MidExposureMinDelay = 2 "mid-exposure-min-delay",
        FrameTimestamp = 3 "frame-timestamp",
    }
    // The numbers of ROS's own log levels.
    Level as "LEVEL" {
        Debug = 10 "debug",
        Info = 20 "info",
        Warning = 30 "warning",
        Error = 40 "error",
    }
}
