//! A measured value and its uncertainty.

use std::borrow::Cow;

use serde::{Deserialize, Deserializer, Serialize, Serializer, de::Error as _};

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
    #[must_use]
    pub fn around(value: f64, half_width: f64) -> Self {
        Self {
            value,
            low: value - half_width,
            high: value + half_width,
        }
    }

    /// An interval with these ends, in either order.
    #[must_use]
    pub fn between(value: f64, [one, other]: [f64; 2]) -> Self {
        Self {
            value,
            low: one.min(other),
            high: one.max(other),
        }
    }

    /// Half of its width.
    #[must_use]
    pub fn half_width(&self) -> f64 {
        (self.high - self.low) / 2.0
    }

    /// Whether a value lies in it.
    #[must_use]
    pub fn contains(&self, value: f64) -> bool {
        (self.low..=self.high).contains(&value)
    }

    /// With an independent error that is within ±`bound` in 95 of 100 cases.
    #[must_use]
    pub fn widened(&self, bound: f64) -> Self {
        Self {
            value: self.value,
            low: self.value - (self.value - self.low).hypot(bound),
            high: self.value + (self.high - self.value).hypot(bound),
        }
    }

    /// In another unit, or of the other sign.
    #[must_use]
    pub fn scaled(&self, factor: f64) -> Self {
        Self::between(
            self.value * factor,
            [self.low, self.high].map(|end| end * factor),
        )
    }

    /// Moved by a known distance.
    #[must_use]
    pub fn shifted(&self, by: f64) -> Self {
        Self {
            value: self.value + by,
            low: self.low + by,
            high: self.high + by,
        }
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
}

impl Parameter {
    pub(crate) fn new(
        name: &'static str,
        unit: &'static str,
        estimate: Interval,
        key: Option<(&'static str, toml_edit::Value)>,
    ) -> Self {
        Self {
            name: Cow::Borrowed(name),
            unit: Cow::Borrowed(unit),
            estimate,
            key: key.map(|(key, value)| (key.into(), value)),
        }
    }
}

/// The keys of some parameters, each with its value.
pub(crate) fn keys(parameters: &[Parameter]) -> Vec<(&str, toml_edit::Value)> {
    let keys = parameters.iter().filter_map(|one| one.key.as_ref());
    keys.map(|(key, value)| (key.as_ref(), value.clone()))
        .collect()
}

/// As two keys; as none if there is no key.
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
