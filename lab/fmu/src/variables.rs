//! The variables of the units: names, values at the start, and how outputs are read; and their description
//! for importers, `modelDescription.xml`.

use std::{
    borrow::Cow,
    ffi::{CStr, CString},
    fmt::Write as _,
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
        let is_own = move |it: &&Variable| it.5.is_none_or(|unit| unit == self);
        VARIABLES.iter().filter(is_own)
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

/// A variable: name, role, value at the start, unit (or empty), meaning, and the only unit of this
/// library that has it.
#[derive(Debug)]
pub(crate) struct Variable(
    pub(crate) &'static str,
    pub(crate) Role,
    pub(crate) Value,
    pub(crate) &'static str,
    pub(crate) &'static str,
    pub(crate) Option<Unit>,
);

/// No set-point of a car is faster, in m/s.
const FASTEST: f64 = 100.0;
const ZERO: Value = Number(0.0);
const EMPTY: Value = Text(Cow::Borrowed(c""));
const CAR: Option<Unit> = Some(Unit::Car);
const SYSTEM: Option<Unit> = Some(Unit::System);

#[rustfmt::skip]
static VARIABLES: [Variable; 33] = [
    Variable("time", Time, ZERO, "s", "Time", None),
    Variable("configuration", Parameter, EMPTY, "", "Keys of the daemon's configuration that differ from the simulated car's, as TOML", None),
    Variable("truth", Parameter, EMPTY, "", "What is true of the car and differs from the configuration, as TOML", None),
    Variable("start_x", Parameter, ZERO, "m", "Position of the centre of mass along x at the start", None),
    Variable("start_y", Parameter, ZERO, "m", "Position of the centre of mass along y at the start", None),
    Variable("start_yaw", Parameter, ZERO, "rad", "Yaw at the start", None),
    Variable("servo_us", Input(0.0..=2500.0), Number(1500.0), "us", "Pulse for the servo, taken every 20 ms; 0 is none", CAR),
    Variable("esc_us", Input(0.0..=2500.0), Number(1500.0), "us", "Pulse for the ESC, taken every 20 ms; 0 is none. It drives after truth.esc.arming_ms (1000) of neutral", CAR),
    Variable("velocity_x", Input(-FASTEST..=FASTEST), ZERO, "m/s", "Wanted velocity of P along x, unless the configuration has a reference", SYSTEM),
    Variable("velocity_y", Input(-FASTEST..=FASTEST), ZERO, "m/s", "Wanted velocity of P along y, unless the configuration has a reference", SYSTEM),
    Variable("seed", Parameter, Count(1), "", "Seed of all noise", SYSTEM),
    Variable("x", Output(|it| Number(it.truth.x)), ZERO, "m", "Position of the centre of mass along x", None),
    Variable("y", Output(|it| Number(it.truth.y)), ZERO, "m", "Position of the centre of mass along y", None),
    Variable("yaw", Output(|it| Number(it.truth.yaw)), ZERO, "rad", "Yaw, not wrapped", None),
    Variable("yaw_rate", Output(|it| Number(it.truth.yaw_rate)), ZERO, "rad/s", "Yaw rate", None),
    Variable("sideslip", Output(|it| Number(it.truth.sideslip)), ZERO, "rad", "Angle from the car's axis to the velocity of the centre of mass", None),
    Variable("steering", Output(|it| Number(it.truth.steering)), ZERO, "rad", "Steering angle of the front wheels, left positive", None),
    Variable("speed", Output(|it| Number(it.truth.speed)), ZERO, "m/s", "Speed of the centre of mass", None),
    Variable("wheel_speed", Output(|it| Number(it.truth.wheel_speed)), ZERO, "m/s", "Speed of the rear wheels", None),
    Variable("battery_v", Output(|it| Number(it.truth.battery_v)), ZERO, "V", "Voltage of the battery", None),
    Variable("point_x", Output(|it| Number(it.point[0])), ZERO, "m", "Position of P along x", None),
    Variable("point_y", Output(|it| Number(it.point[1])), ZERO, "m", "Position of P along y", None),
    Variable("estimate_x", Output(|it| it.number(|it| Some(it.estimate?.position.x))), ZERO, "m", "Estimate of x", SYSTEM),
    Variable("estimate_y", Output(|it| it.number(|it| Some(it.estimate?.position.y))), ZERO, "m", "Estimate of y", SYSTEM),
    Variable("estimate_yaw", Output(|it| it.number(|it| Some(it.estimate?.yaw))), ZERO, "rad", "Estimate of yaw", SYSTEM),
    Variable("estimate_yaw_rate", Output(|it| it.number(|it| Some(it.estimate?.yaw_rate))), ZERO, "rad/s", "Estimate of yaw_rate", SYSTEM),
    Variable("estimate_sideslip", Output(|it| it.number(|it| Some(it.estimate?.sideslip))), ZERO, "rad", "Estimate of sideslip", SYSTEM),
    Variable("estimate_speed", Output(|it| it.number(|it| Some(it.estimate?.speed))), ZERO, "m/s", "Estimate of speed", SYSTEM),
    Variable("command_steering", Output(|it| it.number(|it| Some(it.actuation.steering))), ZERO, "rad", "Commanded steering angle", SYSTEM),
    Variable("command_speed", Output(|it| it.number(|it| Some(it.actuation.speed))), ZERO, "m/s", "Commanded speed of the centre of mass", SYSTEM),
    Variable("driving", Output(|it| Flag(it.tick.is_some_and(|it| it.mode == Mode::Driving))), Flag(false), "", "Whether the car follows its reference", SYSTEM),
    Variable("mode", Output(|it| it.word(|it| Some(it.mode.name()))), EMPTY, "", "Mode of the pilot", SYSTEM),
    Variable("reason", Output(|it| it.word(|it| it.reason.map(Reason::name))), EMPTY, "", "Why the drive ended; empty before", SYSTEM),
];

/// The file `modelDescription.xml` of a unit.
#[must_use]
pub fn description(unit: Unit) -> String {
    let (name, token, version) = (unit.name(), unit.token(), env!("CARGO_PKG_VERSION"));
    let variables: Vec<&Variable> = unit.variables().collect();
    let mut units: Vec<&str> = variables.iter().map(|it| it.3).collect();
    units.sort_unstable();
    units.dedup();
    let units = units.iter().filter(|unit| !unit.is_empty());
    let units: String = units
        .map(|unit| format!("    <Unit name=\"{unit}\"/>\n"))
        .collect();
    let described: String = variables.iter().enumerate().map(element).collect();
    let mut structure = String::new();
    for kind in ["Output", "InitialUnknown"] {
        for (reference, variable) in variables.iter().enumerate() {
            if matches!(variable.1, Output(_)) {
                // Formatting into a text can't fail.
                let _ = writeln!(structure, "    <{kind} valueReference=\"{reference}\"/>");
            }
        }
    }
    format!(
        r#"<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="3.0" modelName="{name}" instantiationToken="{token}"
    version="{version}" license="MIT OR Apache-2.0" generationTool="Singletrack {version}">
  <CoSimulation modelIdentifier="{name}" canHandleVariableCommunicationStepSize="true"/>
  <UnitDefinitions>
{units}  </UnitDefinitions>
  <LogCategories>
    <Category name="error" description="Calls that were not obeyed, and why"/>
  </LogCategories>
  <DefaultExperiment startTime="0" stopTime="10" stepSize="0.01"/>
  <ModelVariables>
{described}  </ModelVariables>
  <ModelStructure>
{structure}  </ModelStructure>
</fmiModelDescription>
"#
    )
}

/// The element of a variable.
fn element((reference, variable): (usize, &&Variable)) -> String {
    let Variable(name, role, start, unit, meaning, ..) = variable;
    let kind = start.kind();
    let mut attributes =
        format!("name=\"{name}\" valueReference=\"{reference}\" description=\"{meaning}\"");
    attributes += match role {
        Time => " causality=\"independent\"",
        Parameter => " causality=\"parameter\" variability=\"fixed\"",
        Input(_) => " causality=\"input\"",
        Output(_) => " causality=\"output\"",
    };
    if !unit.is_empty() {
        attributes += &format!(" unit=\"{unit}\"");
    }
    if let Input(range) = role {
        attributes += &format!(" min=\"{}\" max=\"{}\"", range.start(), range.end());
    }
    let is_set = matches!(role, Parameter | Input(_));
    match start {
        Value::Number(start) if is_set => attributes += &format!(" start=\"{start}\""),
        Value::Count(start) => attributes += &format!(" start=\"{start}\""),
        Value::Text(_) if is_set => {
            return format!(
                "    <{kind} {attributes}>\n      <Start value=\"\"/>\n    </{kind}>\n"
            );
        }
        _ => {}
    }
    format!("    <{kind} {attributes}/>\n")
}
