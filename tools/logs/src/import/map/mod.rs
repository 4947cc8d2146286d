//! The map of a log: which columns or topics it has, and what they mean.

mod quantity;

use std::{fmt::Display, fs, path::Path};

use serde::Deserialize;
use singletrack_control::interpolate;

use super::log::{ImportError, Interpolation};

pub(super) use quantity::Conversion;
pub use quantity::{Acceleration, Angle, AngularVelocity, Dimension, Length, Quantity, Speed};

/// The longest delay, s. A time of the record is never before its zero.
const LONGEST_DELAY_S: f64 = 0.9;

/// A map; unknown keys are refused.
///
/// `docs/import.md` describes every key, and `tools/real/dart-map.toml` is an example.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Map {
    /// What is between the cells of a row.
    #[serde(default = "comma")]
    pub delimiter: char,
    /// The period of the ticks of the record, in ms.
    #[serde(default = "tick_ms")]
    pub tick_ms: u32,
    /// The time of a row.
    #[serde(default)]
    pub time: TimeSection,
    /// The pose from the motion capture.
    pub pose: PoseSection,
    /// The inertial sensor, if the log has one.
    pub imu: Option<ImuSection>,
    /// The speed of the motor, which the estimator needs.
    pub motor: MotorSection,
    /// When the car is driven; always, if left out.
    pub driving: Option<DrivingSection>,
    /// The steering command.
    pub steering: SteeringSection,
    /// The speed command, if the log has one.
    pub speed_command: Option<CommandSection>,
}

/// The pose from the motion capture.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PoseSection {
    /// The topic of a bag whose messages have these values. The names of the columns are then those
    /// of fields.
    pub topic: Option<String>,
    /// The time of such a message: a field, `header.stamp` if left out, or `receive`.
    pub stamp: Option<String>,
    /// Position along the x axis of the cameras, in m.
    pub x: Quantity<Length>,
    /// Position along the y axis of the cameras, in m.
    pub y: Quantity<Length>,
    /// Yaw, counter-clockwise from above, in rad.
    pub yaw: Quantity<Angle>,
    /// The column that says whether the cameras saw the body; 0 and `false` are no.
    pub tracked: Option<String>,
    /// From the measurement to the time of the row, in s.
    #[serde(default)]
    pub delay_s: f64,
    /// How often the cameras expose. Given, the jitter of the rows' times is taken away: exposures
    /// are regular, their messages are not. Left out, a row's time is believed as it is.
    pub exposures_hz: Option<f64>,
    /// A row has a pose only if this column differs from the row before.
    pub new_when_changes: Option<String>,
    /// What a row is whose cells of the pose are all empty.
    #[serde(default)]
    pub empty_rows: EmptyRows,
    /// Where the logged point is, forward and left of the point that the record shall have, in m.
    #[serde(default)]
    pub point_m: [f64; 2],
    /// The logged yaw of a car that points along x, in rad.
    #[serde(default)]
    pub yaw_rad: f64,
}

/// What a row is whose cells of the pose are all empty.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum EmptyRows {
    /// A pose that is not finite: the cameras did not see the body.
    #[default]
    Rejected,
    /// No pose: the row belongs to other sensors.
    NoSample,
}

/// The inertial sensor.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ImuSection {
    /// The topic of a bag whose messages have these values. The names of the columns are then those
    /// of fields.
    pub topic: Option<String>,
    /// The time of such a message: a field, `header.stamp` if left out, or `receive`.
    pub stamp: Option<String>,
    /// Acceleration forward, without gravity, in m/s². A gyro alone has neither.
    pub forward_acceleration: Option<Quantity<Acceleration>>,
    /// Acceleration to the left, without gravity, in m/s².
    pub left_acceleration: Option<Quantity<Acceleration>>,
    /// Angular velocity about the vertical, counter-clockwise from above, in rad/s.
    pub yaw_rate: Quantity<AngularVelocity>,
    /// From the measurement to the time of the row, in s.
    #[serde(default)]
    pub delay_s: f64,
    /// A row has a sample only if this column differs from the row before.
    pub new_when_changes: Option<String>,
    /// Interpolates to this number of samples a second.
    pub interpolate_hz: Option<u32>,
    /// The longest time between two samples that is interpolated, in s.
    pub longest_gap_s: Option<f64>,
}

/// The speed of the motor.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MotorSection {
    /// The topic of a bag whose messages have these values. The names of the columns are then those
    /// of fields.
    pub topic: Option<String>,
    /// The time of such a message: a field, `header.stamp` if left out, or `receive`.
    pub stamp: Option<String>,
    /// Speed of the driven axle as the motor or an encoder measures it, in m/s.
    pub speed: Quantity<Speed>,
    /// From the measurement to the time of the row, in s.
    #[serde(default)]
    pub delay_s: f64,
    /// A row has a sample only if this column differs from the row before.
    pub new_when_changes: Option<String>,
    /// Interpolates: at the times of the inertial samples, or without an IMU to this number of samples
    /// a second.
    pub interpolate_hz: Option<u32>,
    /// The longest time between two samples that is interpolated, in s.
    pub longest_gap_s: Option<f64>,
}

/// When the car is driven.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DrivingSection {
    /// The topic of a bag whose messages have these values. The names of the columns are then those
    /// of fields.
    pub topic: Option<String>,
    /// The time of such a message: a field, `header.stamp` if left out, or `receive`.
    pub stamp: Option<String>,
    /// The column; 0 and `false` are not driving. An empty cell is as the row before.
    #[serde(alias = "field")]
    pub column: String,
}

/// The speed command.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CommandSection {
    /// The topic of a bag whose messages have these values. The names of the columns are then those
    /// of fields.
    pub topic: Option<String>,
    /// The time of such a message: a field, `header.stamp` if left out, or `receive`.
    pub stamp: Option<String>,
    /// The commanded speed, in m/s. An empty cell is as the row before.
    pub speed: Quantity<Speed>,
    /// From the command to the time of the row, in s.
    #[serde(default)]
    pub delay_s: f64,
}

const fn comma() -> char {
    ','
}

const fn tick_ms() -> u32 {
    10
}

/// The longest gap that is interpolated, in s, unless the map says another one.
const LONGEST_GAP_S: f64 = 0.3;

impl Map {
    /// Reads the map in a file.
    ///
    /// # Errors
    ///
    /// It can't be read, is not a map, or has an invalid value; the error names the key.
    pub fn read(path: &Path) -> Result<Self, ImportError> {
        let text = fs::read_to_string(path).map_err(ImportError::read(path))?;
        Self::from_toml(&text, path)
    }

    /// Parses a map; `path` is the file in messages.
    ///
    /// # Errors
    ///
    /// As [`read`](Self::read).
    pub fn from_toml(text: &str, path: &Path) -> Result<Self, ImportError> {
        let map: Self = toml::from_str(text).map_err(|error| match error.message() {
            "missing field `motor`" => {
                let why = " has no section [motor]: add it with the column of the speed of motor or \
                           wheels, which the estimator needs; a log without one can't be imported";
                ImportError::file(path, why)
            }
            _ => ImportError::file(path, format!(": {error}")),
        })?;
        map.check()
            .map_err(|why| ImportError::file(path, format!(": {why}")))?;
        Ok(map)
    }

    /// Checks that the map is one for the kind of log: it names columns, or topics and fields.
    /// `path` is its file in messages.
    pub(super) fn check_kind(&self, is_bag: bool, path: &Path) -> Result<(), ImportError> {
        let time = if is_bag {
            self.time.check_bag()
        } else {
            self.time.check_rows()
        };
        let all = [
            Some(self.pose.messages()),
            self.imu.as_ref().map(ImuSection::messages),
            Some(self.motor.messages()),
            self.driving.as_ref().map(DrivingSection::messages),
            Some(self.steering.messages()),
            self.speed_command.as_ref().map(CommandSection::messages),
        ];
        let mut all = all.into_iter().flatten();
        time.and_then(|()| all.try_for_each(|messages| messages.check(is_bag)))
            .map_err(|why| ImportError::file(path, format!(": {why}")))
    }

    fn check(&self) -> Result<(), String> {
        let (delimiter, tick_ms) = (self.delimiter, self.tick_ms);
        let is_good = delimiter.is_ascii() && !matches!(delimiter, '"' | '\r' | '\n');
        let fix = "use an ASCII character such as \",\", \";\" or \"\\t\"";
        require(is_good, "delimiter", format_args!("{delimiter:?}"), fix)?;
        let is_good = (1..=1_000).contains(&tick_ms);
        require(is_good, "tick_ms", tick_ms, "use 1 to 1000")?;
        self.time.check()?;
        self.pose.check()?;
        if let Some(imu) = &self.imu {
            check_sensor("imu", imu.delay_s, imu.interpolate_hz, imu.longest_gap_s)?;
            let accelerations = [&imu.forward_acceleration, &imu.left_acceleration];
            let [forward, left] = accelerations.map(Option::is_some);
            let fix = "give both accelerations, or for a gyro alone none";
            for (key, given, other) in [
                ("imu.forward_acceleration", forward, left),
                ("imu.left_acceleration", left, forward),
            ] {
                require(given || !other, key, "missing", fix)?;
            }
        }
        let (rate_hz, gap_s) = (self.motor.interpolate_hz, self.motor.longest_gap_s);
        check_sensor("motor", self.motor.delay_s, rate_hz, gap_s)?;
        self.steering.check()?;
        match &self.speed_command {
            Some(command) => check_delay("speed_command.delay_s", command.delay_s),
            None => Ok(()),
        }
    }
}

impl PoseSection {
    fn check(&self) -> Result<(), String> {
        check_delay("pose.delay_s", self.delay_s)?;
        let [forward, left] = self.point_m;
        check_finite("pose.point_m", forward)?;
        check_finite("pose.point_m", left)?;
        check_finite("pose.yaw_rad", self.yaw_rad)?;
        let rate = self.exposures_hz.unwrap_or(1.0);
        let is_good = (1.0..=1_000.0).contains(&rate);
        require(is_good, "pose.exposures_hz", rate, "use 1 to 1000")
    }
}

macro_rules! with_messages {
    ($($section:ident $name:literal),*) => {
        $(
            impl $section {
                pub(super) fn messages(&self) -> Messages<'_> {
                    Messages {
                        section: $name,
                        topic: self.topic.as_deref(),
                        stamp: self.stamp.as_deref(),
                    }
                }
            }
        )*
    };
}

with_messages! {
    PoseSection "pose", ImuSection "imu", MotorSection "motor", DrivingSection "driving",
    SteeringSection "steering", CommandSection "speed_command"
}

pub(super) fn interpolation(
    rate_hz: Option<u32>,
    longest_gap_s: Option<f64>,
) -> Option<Interpolation> {
    rate_hz.map(|rate_hz| Interpolation {
        rate_hz,
        longest_gap_ns: nanoseconds(longest_gap_s.unwrap_or(LONGEST_GAP_S)),
    })
}

/// A duration of the map, which is not negative, rounded to a nanosecond.
pub(super) const fn nanoseconds(seconds: f64) -> u64 {
    (seconds * 1e9).round() as u64
}

/// What is wrong with a value of the map, and what to do.
fn invalid(key: &str, value: impl Display, fix: &str) -> String {
    format!("{key} is {value}: {fix}")
}

/// Fails if a value is not good.
fn require(is_good: bool, key: &str, value: impl Display, fix: &str) -> Result<(), String> {
    is_good
        .then_some(())
        .ok_or_else(|| invalid(key, value, fix))
}

fn check_finite(key: &str, value: f64) -> Result<(), String> {
    require(value.is_finite(), key, value, "use a finite number")
}

fn check_positive(key: &str, value: f64) -> Result<(), String> {
    let is_good = value.is_finite() && value > 0.0;
    require(is_good, key, value, "use a number above 0")
}

fn check_delay(key: &str, value: f64) -> Result<(), String> {
    let fix = format!("use 0 to {LONGEST_DELAY_S}, in s");
    require((0.0..=LONGEST_DELAY_S).contains(&value), key, value, &fix)
}

/// Checks what the sections of both sensors of the board have.
fn check_sensor(
    section: &str,
    delay_s: f64,
    rate_hz: Option<u32>,
    longest_gap_s: Option<f64>,
) -> Result<(), String> {
    check_delay(&format!("{section}.delay_s"), delay_s)?;
    let [rate_key, gap_key] =
        ["interpolate_hz", "longest_gap_s"].map(|key| format!("{section}.{key}"));
    let rate = rate_hz.unwrap_or(1);
    let is_good = (1..=1_000).contains(&rate);
    require(is_good, &rate_key, rate, "use 1 to 1000")?;
    match longest_gap_s {
        Some(gap_s) if rate_hz.is_none() => {
            let fix = format!(
                "leave it out, or add {rate_key}: only samples that are \
                               interpolated have a longest gap"
            );
            Err(invalid(&gap_key, gap_s, &fix))
        }
        Some(gap_s) => check_positive(&gap_key, gap_s),
        None => Ok(()),
    }
}

/// The time of a row: of a CSV file in a column, of a bag in each message.
#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TimeSection {
    /// The column of a CSV file.
    pub column: Option<String>,
    /// Its unit.
    pub unit: Option<TimeUnit>,
    /// Whether it counts from the start of 1970, UTC. Otherwise its zero has no meaning.
    pub unix: Option<bool>,
    /// The longest time between two rows that is not taken for an error of the log, in s; 10 if it is
    /// not given.
    pub longest_gap_s: Option<f64>,
}

/// The longest time between two rows, in s, unless the map says another one.
const LONGEST_PAUSE_S: f64 = 10.0;

/// The unit of a time, with the power of ten by which a number in it is multiplied to be in ns.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
pub enum TimeUnit {
    /// Seconds.
    #[default]
    #[serde(rename = "s")]
    Seconds = 9,
    /// Milliseconds.
    #[serde(rename = "ms")]
    Milliseconds = 6,
    /// Microseconds.
    #[serde(rename = "us")]
    Microseconds = 3,
    /// Nanoseconds.
    #[serde(rename = "ns")]
    Nanoseconds = 0,
}

impl TimeSection {
    pub(super) fn check(&self) -> Result<(), String> {
        let gap_s = self.longest_gap_s.unwrap_or(LONGEST_PAUSE_S);
        check_positive("time.longest_gap_s", gap_s)
    }

    /// The longest time between two rows, in ns.
    pub(in crate::import) fn longest_gap_ns(&self) -> u64 {
        nanoseconds(self.longest_gap_s.unwrap_or(LONGEST_PAUSE_S))
    }

    /// Fails if the section is not one for a CSV file.
    pub(super) fn check_rows(&self) -> Result<(), String> {
        let fix = "name the column of the time of a row";
        require(self.column.is_some(), "time.column", "missing", fix)?;
        let fix = "give the unit of that column: \"s\", \"ms\", \"us\" or \"ns\"";
        require(self.unit.is_some(), "time.unit", "missing", fix)?;
        let fix = "set it to true if the time counts from 1970, to false if not";
        require(self.unix.is_some(), "time.unix", "missing", fix)
    }

    /// Fails if the section is not one for a bag.
    fn check_bag(&self) -> Result<(), String> {
        let fix = "remove it: the messages of a bag have times of their own, see `stamp`";
        if let Some(column) = &self.column {
            return Err(invalid("time.column", format!("{column:?}"), fix));
        }
        require(self.unit.is_none(), "time.unit", "given", fix)?;
        require(self.unix.is_none(), "time.unix", "given", fix)
    }
}

/// The steering command.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SteeringSection {
    /// The topic of a bag whose messages have these values. The names of the columns are then those
    /// of fields.
    pub topic: Option<String>,
    /// The time of such a message: a field, `header.stamp` if left out, or `receive`.
    pub stamp: Option<String>,
    /// The column. An empty cell is as the row before.
    #[serde(alias = "field")]
    pub column: String,
    /// The angle of a command of 1, in rad, if the angle is linear in the command.
    pub radians_per_unit: Option<f64>,
    /// The angle of a command of 0, in rad, if the angle is linear in the command.
    pub offset_rad: Option<f64>,
    /// Pairs of command and angle in rad, in the order of the commands. Between them the angle is
    /// linear; beyond them it is that of the first or the last pair.
    pub table: Option<Vec<[f64; 2]>>,
    /// From the command to the time of the row, in s.
    #[serde(default)]
    pub delay_s: f64,
}

impl SteeringSection {
    fn check(&self) -> Result<(), String> {
        check_delay("steering.delay_s", self.delay_s)?;
        match (&self.table, self.radians_per_unit) {
            (None, None) => {
                let fix = "give steering.table or steering.radians_per_unit";
                return Err(invalid("[steering]", "without an angle", fix));
            }
            (Some(_), Some(_)) => {
                let fix = "give steering.table or steering.radians_per_unit, not both";
                return Err(invalid("[steering]", "with two angles", fix));
            }
            (None, Some(radians)) => {
                const KEY: &str = "steering.radians_per_unit";
                check_finite(KEY, radians)?;
                let fix = "use the angle of a command of 1";
                require(radians != 0.0, KEY, radians, fix)?;
            }
            (Some(table), None) => check_table(table)?,
        }
        let (key, offset_rad) = ("steering.offset_rad", self.offset_rad.unwrap_or_default());
        let is_good = self.table.is_none() || self.offset_rad.is_none();
        let fix = "add it to the angles of the table instead";
        require(is_good, key, offset_rad, fix)?;
        check_finite(key, offset_rad)
    }

    /// The steering angle of a command, in rad.
    pub fn angle(&self, command: f64) -> f64 {
        match &self.table {
            Some(table) => interpolate(table, command),
            None => {
                let [radians, offset] = [self.radians_per_unit, self.offset_rad];
                command * radians.unwrap_or_default() + offset.unwrap_or_default()
            }
        }
    }
}

fn check_table(table: &[[f64; 2]]) -> Result<(), String> {
    const KEY: &str = "steering.table";
    let length = format!("a table of {} pairs", table.len());
    require(table.len() >= 2, KEY, length, "give at least 2")?;
    let is_finite = |pair: &&[f64; 2]| pair.iter().all(|one| one.is_finite());
    if let Some(pair) = table.iter().find(|pair| !is_finite(pair)) {
        return Err(invalid(KEY, format!("{pair:?}"), "use finite numbers"));
    }
    let mut pairs = table.iter().zip(table.iter().skip(1));
    match pairs.find(|([before, _], [after, _])| after <= before) {
        None => Ok(()),
        Some(([before, _], [after, _])) => {
            let value = format!("a table with {after} after {before}");
            let fix = "put the pairs in the order of the commands";
            Err(invalid(KEY, value, fix))
        }
    }
}

/// The messages of a section; without a topic if the map is one for CSV files.
#[derive(Clone, Copy, Debug)]
pub(in crate::import) struct Messages<'a> {
    /// The section, such as `pose`.
    pub(in crate::import) section: &'static str,
    topic: Option<&'a str>,
    stamp: Option<&'a str>,
}

impl<'a> Messages<'a> {
    /// The topic; the map is checked before to have one.
    pub(in crate::import) fn topic(self) -> &'a str {
        self.topic.unwrap_or_default()
    }

    /// The field with the time of a message; `None` if that is when it was received, as the bag has it.
    pub(in crate::import) fn stamp(self) -> Option<&'a str> {
        let field = self.stamp.unwrap_or("header.stamp");
        (field != "receive").then_some(field)
    }

    fn check(self, is_bag: bool) -> Result<(), String> {
        let [topic_key, stamp_key] =
            ["topic", "stamp"].map(|key| format!("{}.{key}", self.section));
        let csv = "remove it: a CSV file has no topics";
        match (self.topic, self.stamp) {
            (None, _) if is_bag => {
                let fix = "name the topic whose messages have the fields of this section";
                Err(invalid(&topic_key, "missing", fix))
            }
            (Some(topic), _) if !is_bag => Err(invalid(&topic_key, format!("{topic:?}"), csv)),
            (_, Some(stamp)) if !is_bag => Err(invalid(&stamp_key, format!("{stamp:?}"), csv)),
            _ => Ok(()),
        }
    }
}
