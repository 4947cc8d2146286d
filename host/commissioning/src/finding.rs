//! The result of a step or why it has none, its measured values, and its plots.

use std::borrow::Cow;

use serde::{Deserialize, Deserializer, Serialize, Serializer, de::Error as _};
use singletrack_control::words;
use singletrack_core::reasons::Why;
use singletrack_protocol::StopCause;

use crate::{Bench, Interrupted};

/// The result of a step: what it found, what was expected, and what to do.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Finding {
    /// The step's name, which the procedure fills in.
    pub step: Cow<'static, str>,
    /// The verdict.
    pub verdict: Verdict,
    /// What was found, with numbers.
    pub found: String,
    /// What was expected; where the step leaves it empty, what the procedure says of the step.
    pub expected: String,
    /// What to do; empty if there is nothing.
    pub fix: String,
    /// What was measured.
    pub parameters: Vec<Parameter>,
}

impl Finding {
    pub(crate) fn new(verdict: Verdict, found: impl Into<String>, fix: impl Into<String>) -> Self {
        Self {
            step: "".into(),
            verdict,
            found: found.into(),
            expected: String::new(),
            fix: match verdict {
                Verdict::Good => String::new(),
                _ => fix.into(),
            },
            parameters: Vec::new(),
        }
    }

    pub(crate) fn good(found: impl Into<String>) -> Self {
        Self::new(Verdict::Good, found, "")
    }

    pub(crate) fn warning(found: impl Into<String>, fix: impl Into<String>) -> Self {
        Self::new(Verdict::Warning, found, fix)
    }

    /// Good, or a failure, which `fix` removes.
    pub(crate) fn check(is_good: bool, found: impl Into<String>, fix: &str) -> Self {
        Self::new(Verdict::Failed.unless(is_good), found, fix)
    }

    /// A warning if `has_fault`, which `fix` removes; good otherwise.
    pub(crate) fn warning_if(has_fault: bool, found: impl Into<String>, fix: &str) -> Self {
        Self::new(Verdict::Warning.unless(!has_fault), found, fix)
    }

    pub(crate) fn with(self, parameters: Vec<Parameter>) -> Self {
        Self { parameters, ..self }
    }
}

/// Why a step is not completed.
#[derive(Debug)]
pub enum Trouble {
    /// The procedure ends.
    Interrupted(Interrupted),
    /// The step fails.
    Failed {
        /// What was found.
        found: String,
        /// What to do.
        fix: String,
    },
    /// The operator skipped a question that the step needs.
    Skipped,
    /// The step ends early with what it has found so far.
    Found(Box<Finding>),
    /// The armed jog ended by itself.
    Ended {
        /// The board's reason.
        cause: StopCause,
        /// The reason for the operator.
        why: String,
    },
}

impl Trouble {
    /// What the step has found with it.
    pub(crate) fn finding(self) -> Result<Finding, Interrupted> {
        Ok(match self {
            Self::Interrupted(interrupted) => return Err(interrupted),
            Self::Failed { found, fix } => Finding::new(Verdict::Failed, found, fix),
            Self::Skipped => Finding::new(Verdict::Skipped, "skipped", ""),
            Self::Found(finding) => *finding,
            Self::Ended { cause, why } => {
                let mut found = format!("the jog ended: {why}");
                let mut advice = String::new();
                if cause != StopCause::None {
                    let stop = Why::of_word("board stop", cause.name());
                    found += &format!("; the board: {}", stop.text);
                    advice = stop.advice.unwrap_or_default();
                }
                let fix = format!("{advice} Run the bring-up again.");
                Finding::new(Verdict::Failed, found, fix.trim_start())
            }
        })
    }
}

impl From<Interrupted> for Trouble {
    fn from(interrupted: Interrupted) -> Self {
        Self::Interrupted(interrupted)
    }
}

pub(crate) fn failed(found: impl Into<String>, fix: impl Into<String>) -> Trouble {
    Trouble::Failed {
        found: found.into(),
        fix: fix.into(),
    }
}

/// Nothing, or a failure, which `fix` removes.
pub(crate) fn require(is_good: bool, found: impl Into<String>, fix: &str) -> Result<(), Trouble> {
    match is_good {
        true => Ok(()),
        false => Err(failed(found, fix)),
    }
}

/// What failed because of this word of the host, with its meaning and what to do.
pub(crate) fn stopped(what: &str, word: &str) -> Trouble {
    let why = Why::of_word("host", word);
    let advice = why.advice.unwrap_or_default();
    let fix = format!("{advice} Run this step again.");
    failed(format!("{what}: {}", why.text), fix.trim_start())
}

words! {
    /// The verdict of a finding.
    #[derive(PartialOrd, Ord)]
    pub enum Verdict: serde {
        /// What was checked is as it should be.
        Good = "good",
        /// Not checked: the operator skipped it, or the car has no such part.
        Skipped = "skipped",
        /// It works, but could be better.
        Warning = "warning",
        /// The next procedure must not begin.
        Failed = "failed",
    }
}

impl Verdict {
    /// Good instead, if it is.
    pub(crate) const fn unless(self, is_good: bool) -> Self {
        if is_good { Self::Good } else { self }
    }
}

/// An estimate with its 95 % interval.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Interval {
    /// The estimate.
    pub value: f64,
    /// Lower end of the 95 % interval.
    pub low: f64,
    /// Upper end of the 95 % interval.
    pub high: f64,
}

impl Interval {
    /// A symmetric interval.
    pub fn around(value: f64, half_width: f64) -> Self {
        Self::between(value, [value - half_width, value + half_width])
    }

    /// An interval with these ends, in either order.
    pub fn between(value: f64, [one, other]: [f64; 2]) -> Self {
        Self {
            value,
            low: one.min(other),
            high: one.max(other),
        }
    }

    /// Half of its width.
    pub fn half_width(&self) -> f64 {
        (self.high - self.low) / 2.0
    }

    /// Whether a value lies in it.
    pub fn contains(&self, value: f64) -> bool {
        (self.low..=self.high).contains(&value)
    }

    /// With an independent error that is within ±`bound` in 95 of 100 cases.
    pub fn widened(&self, bound: f64) -> Self {
        let Self { value, low, high } = *self;
        let [below, above] = [value - low, high - value].map(|side| side.hypot(bound));
        Self::between(value, [value - below, value + above])
    }

    /// In another unit, or of the other sign.
    pub fn scaled(&self, factor: f64) -> Self {
        let ends = [self.low, self.high].map(|end| end * factor);
        Self::between(self.value * factor, ends)
    }

    /// Moved by a known distance.
    pub fn shifted(&self, by: f64) -> Self {
        Self::between(self.value + by, [self.low + by, self.high + by])
    }
}

/// A parameter of the car that was measured.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Parameter {
    /// Its name, such as `servo-centre`; in one procedure each has one.
    pub name: Cow<'static, str>,
    /// Its unit, such as `us`.
    pub unit: Cow<'static, str>,
    /// The estimate, in the unit.
    #[serde(flatten)]
    pub estimate: Interval,
    /// The key of the configuration that takes it, such as `board.servo.centre_us`, with the
    /// value as TOML.
    #[serde(
        flatten,
        serialize_with = "key_and_toml",
        deserialize_with = "of_key_and_toml"
    )]
    pub key: Option<(Cow<'static, str>, toml_edit::Value)>,
    /// Why that value is not the estimate; empty if it is.
    #[serde(default, skip_serializing_if = "str::is_empty")]
    pub why: Cow<'static, str>,
}

impl Parameter {
    pub(crate) const fn new(name: &'static str, unit: &'static str, estimate: Interval) -> Self {
        Self {
            name: Cow::Borrowed(name),
            unit: Cow::Borrowed(unit),
            estimate,
            key: None,
            why: Cow::Borrowed(""),
        }
    }

    /// With the key that takes it, and the key's new value.
    pub(crate) fn written(self, key: &'static str, value: impl Into<toml_edit::Value>) -> Self {
        let key = Some((key.into(), value.into()));
        Self { key, ..self }
    }

    /// With the reason why the key takes another value.
    pub(crate) fn because(self, why: &'static str) -> Self {
        let why = Cow::Borrowed(why);
        Self { why, ..self }
    }
}

/// The keys of some parameters, each with its value.
pub(crate) fn keys(parameters: &[Parameter]) -> Vec<(&str, toml_edit::Value)> {
    let keys = parameters.iter().filter_map(|one| one.key.as_ref());
    let keys = keys.map(|(key, value)| (key.as_ref(), value.clone()));
    let mut keys: Vec<_> = keys.collect();
    // Two parameters that follow each other may be the parts of one value.
    keys.dedup_by_key(|(key, _)| *key);
    keys
}

/// Puts values in force, if there are any.
pub(crate) fn change(
    bench: &mut dyn Bench,
    values: &[(&str, toml_edit::Value)],
) -> Result<(), Trouble> {
    if values.is_empty() {
        return Ok(());
    }
    bench.change(values).map_err(|refused| {
        let keys: Vec<_> = values.iter().map(|(key, _)| *key).collect();
        let found = format!("{} can't be changed: {refused}", keys.join(", "));
        let fix = "Correct the configuration file as the message says, and run this step again.";
        failed(found, fix)
    })
}

/// A key and its value as two keys of the output, or as none if there is no key.
fn key_and_toml<S: Serializer>(
    key: &Option<(Cow<'static, str>, toml_edit::Value)>,
    serializer: S,
) -> Result<S::Ok, S::Error> {
    let key = key.as_ref();
    let entries = key.map(|(key, value)| {
        let toml = value.to_string().trim().to_owned();
        [("key", key.to_string()), ("toml", toml)]
    });
    serializer.collect_map(entries.into_iter().flatten())
}

fn of_key_and_toml<'de, D: Deserializer<'de>>(
    deserializer: D,
) -> Result<Option<(Cow<'static, str>, toml_edit::Value)>, D::Error> {
    #[derive(Deserialize)]
    struct Written {
        key: Option<Cow<'static, str>>,
        toml: Option<String>,
    }
    let Written { key, toml } = Written::deserialize(deserializer)?;
    let value = |key| {
        let toml = toml.ok_or_else(|| D::Error::missing_field("toml"))?;
        Ok((key, toml.parse().map_err(D::Error::custom)?))
    };
    key.map(value).transpose()
}

/// A plot of a measurement, for the page of the procedure.
#[derive(Clone, Debug, PartialEq)]
pub struct Plot {
    /// Its name, such as `latency`; in one procedure each has one.
    pub name: &'static str,
    /// What it shows, in a few words.
    pub title: &'static str,
    /// Quantity and unit of the horizontal and of the vertical axis. With one unit, it is as long on
    /// both.
    pub axes: [(&'static str, &'static str); 2],
    /// The lines.
    pub lines: Vec<PlotLine>,
}

impl Plot {
    /// The axes of places on the floor.
    pub(crate) const PLACES: [(&str, &str); 2] = [("x", "m"), ("y", "m")];
    /// The axes of a yaw rate.
    pub(crate) const YAW_RATE: [(&str, &str); 2] = [("time", "s"), ("yaw rate", "rad/s")];

    pub(crate) const fn new(
        name: &'static str,
        title: &'static str,
        axes: [(&'static str, &'static str); 2],
        lines: Vec<PlotLine>,
    ) -> Self {
        Self {
            name,
            title,
            axes,
            lines,
        }
    }
}

/// A line of a [`Plot`].
#[derive(Clone, Debug, PartialEq)]
pub struct PlotLine {
    /// Its name in the legend.
    pub name: &'static str,
    /// Whether its points are readings or a fit.
    pub kind: PlotKind,
    /// Its points; it is interrupted where one is not a number.
    pub points: Vec<[f64; 2]>,
}

impl PlotLine {
    pub(crate) const fn new(name: &'static str, kind: PlotKind, points: Vec<[f64; 2]>) -> Self {
        Self { name, kind, points }
    }
}

/// What a line of a [`Plot`] is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PlotKind {
    /// Readings.
    Measured,
    /// Other readings, to compare with.
    Other,
    /// A fit.
    Fitted,
}
