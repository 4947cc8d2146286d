//! The variables of the units: names, values at the start, and how outputs are read.

use std::{
    borrow::Cow,
    ffi::{CStr, CString},
    ops::RangeInclusive,
};

use singletrack_pilot::{Mode, Output as Tick, Reason};
use singletrack_sim::Truth;

use Role::{Input, Output, Parameter, Time};
use Value::{Count, Flag, Number, Text};

/// A functional mock-up unit of this library.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Unit {
    /// The simulated car: from the pulses of servo and ESC to its motion.
    Car,
    /// Host, board, cameras and car: from a set-point to the car's motion.
    System,
}

impl Unit {
    /// All units.
    pub const ALL: [Self; 2] = [Self::Car, Self::System];

    /// The name of the unit, and of its library.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Car => "singletrack_car",
            Self::System => "singletrack_system",
        }
    }

    /// The token of an importer whose description is that of this version.
    pub(crate) fn token(self) -> String {
        format!("{} {}", self.name(), env!("CARGO_PKG_VERSION"))
    }

    /// The variables; the value reference of one is its place.
    pub(crate) fn variables(self) -> impl Iterator<Item = &'static Variable> {
        let (inputs, outputs): (&[_], &[_]) = match self {
            Self::Car => (&CAR_INPUTS, &[]),
            Self::System => (&SYSTEM_INPUTS, &SYSTEM_OUTPUTS),
        };
        let parts: [&'static [Variable]; 4] = [&PARAMETERS, inputs, &TRUTH, outputs];
        parts.into_iter().flatten()
    }
}

/// The value of a variable.
#[derive(Clone, Debug)]
pub(crate) enum Value {
    Number(f64),
    Count(u64),
    Flag(bool),
    Text(Cow<'static, CStr>),
}

impl Value {
    /// The name of its type in FMI.
    pub(crate) const fn kind(&self) -> &'static str {
        match self {
            Number(_) => "Float64",
            Count(_) => "UInt64",
            Flag(_) => "Boolean",
            Text(_) => "String",
        }
    }
}

/// What the outputs are read from.
pub(crate) struct Seen<'a> {
    pub(crate) truth: Truth,
    /// Where P is, in m.
    pub(crate) point: [f64; 2],
    /// The last tick of the whole system.
    pub(crate) tick: Option<&'a Tick>,
}

impl Seen<'_> {
    /// A value of the last tick; zero without one.
    fn number(&self, read: fn(&Tick) -> Option<f64>) -> Value {
        Number(self.tick.and_then(read).unwrap_or_default())
    }

    /// A word of the last tick; empty without one.
    fn word(&self, read: fn(&Tick) -> Option<&'static str>) -> Value {
        let word = self.tick.and_then(read).unwrap_or_default();
        Text(Cow::Owned(CString::new(word).unwrap_or_default()))
    }
}

/// What a variable is for.
#[derive(Debug)]
pub(crate) enum Role {
    Time,
    /// Set before the first step.
    Parameter,
    /// Set before any step, within this range.
    Input(RangeInclusive<f64>),
    Output(fn(&Seen<'_>) -> Value),
}

/// A variable: name, role, value at the start, unit (or empty) and meaning.
#[derive(Debug)]
pub(crate) struct Variable(
    pub(crate) &'static str,
    pub(crate) Role,
    pub(crate) Value,
    pub(crate) &'static str,
    pub(crate) &'static str,
);

/// No set-point of a car is faster, in m/s.
const FASTEST: f64 = 100.0;
const ZERO: Value = Number(0.0);
const EMPTY: Value = Text(Cow::Borrowed(c""));

#[rustfmt::skip]
static PARAMETERS: [Variable; 6] = [
    Variable("time", Time, ZERO, "s", "Time"),
    Variable("configuration", Parameter, EMPTY, "", "Keys of the daemon's configuration that differ from the simulated car's, as TOML"),
    Variable("truth", Parameter, EMPTY, "", "What is true of the car and differs from the configuration, as TOML"),
    Variable("start_x", Parameter, ZERO, "m", "Position of the centre of mass along x at the start"),
    Variable("start_y", Parameter, ZERO, "m", "Position of the centre of mass along y at the start"),
    Variable("start_yaw", Parameter, ZERO, "rad", "Yaw at the start"),
];

#[rustfmt::skip]
static CAR_INPUTS: [Variable; 2] = [
    Variable("servo_us", Input(0.0..=2500.0), Number(1500.0), "us", "Pulse for the servo, taken every 20 ms; 0 is none"),
    Variable("esc_us", Input(0.0..=2500.0), Number(1500.0), "us", "Pulse for the ESC, taken every 20 ms; 0 is none. It drives after truth.esc.arming_ms (1000) of neutral"),
];

#[rustfmt::skip]
static SYSTEM_INPUTS: [Variable; 3] = [
    Variable("velocity_x", Input(-FASTEST..=FASTEST), ZERO, "m/s", "Wanted velocity of P along x, unless the configuration has a reference"),
    Variable("velocity_y", Input(-FASTEST..=FASTEST), ZERO, "m/s", "Wanted velocity of P along y, unless the configuration has a reference"),
    Variable("seed", Parameter, Count(1), "", "Seed of all noise"),
];

#[rustfmt::skip]
static TRUTH: [Variable; 11] = [
    Variable("x", Output(|it| Number(it.truth.x)), ZERO, "m", "Position of the centre of mass along x"),
    Variable("y", Output(|it| Number(it.truth.y)), ZERO, "m", "Position of the centre of mass along y"),
    Variable("yaw", Output(|it| Number(it.truth.yaw)), ZERO, "rad", "Yaw, not wrapped"),
    Variable("yaw_rate", Output(|it| Number(it.truth.yaw_rate)), ZERO, "rad/s", "Yaw rate"),
    Variable("sideslip", Output(|it| Number(it.truth.sideslip)), ZERO, "rad", "Angle from the car's axis to the velocity of the centre of mass"),
    Variable("steering", Output(|it| Number(it.truth.steering)), ZERO, "rad", "Steering angle of the front wheels, left positive"),
    Variable("speed", Output(|it| Number(it.truth.speed)), ZERO, "m/s", "Speed of the centre of mass"),
    Variable("wheel_speed", Output(|it| Number(it.truth.wheel_speed)), ZERO, "m/s", "Speed of the rear wheels"),
    Variable("battery_v", Output(|it| Number(it.truth.battery_v)), ZERO, "V", "Voltage of the battery"),
    Variable("point_x", Output(|it| Number(it.point[0])), ZERO, "m", "Position of P along x"),
    Variable("point_y", Output(|it| Number(it.point[1])), ZERO, "m", "Position of P along y"),
];

#[rustfmt::skip]
static SYSTEM_OUTPUTS: [Variable; 11] = [
    Variable("estimate_x", Output(|it| it.number(|it| Some(it.estimate?.position.x))), ZERO, "m", "Estimate of x"),
    Variable("estimate_y", Output(|it| it.number(|it| Some(it.estimate?.position.y))), ZERO, "m", "Estimate of y"),
    Variable("estimate_yaw", Output(|it| it.number(|it| Some(it.estimate?.yaw))), ZERO, "rad", "Estimate of yaw"),
    Variable("estimate_yaw_rate", Output(|it| it.number(|it| Some(it.estimate?.yaw_rate))), ZERO, "rad/s", "Estimate of yaw_rate"),
    Variable("estimate_sideslip", Output(|it| it.number(|it| Some(it.estimate?.sideslip))), ZERO, "rad", "Estimate of sideslip"),
    Variable("estimate_speed", Output(|it| it.number(|it| Some(it.estimate?.speed))), ZERO, "m/s", "Estimate of speed"),
    Variable("command_steering", Output(|it| it.number(|it| Some(it.actuation.steering))), ZERO, "rad", "Commanded steering angle"),
    Variable("command_speed", Output(|it| it.number(|it| Some(it.actuation.speed))), ZERO, "m/s", "Commanded speed of the centre of mass"),
    Variable("driving", Output(|it| Flag(it.tick.is_some_and(|it| it.mode == Mode::Driving))), Flag(false), "", "Whether the car follows its reference"),
    Variable("mode", Output(|it| it.word(|it| Some(it.mode.name()))), EMPTY, "", "Mode of the pilot"),
    Variable("reason", Output(|it| it.word(|it| it.reason.map(Reason::name))), EMPTY, "", "Why the drive ended; empty before"),
];
