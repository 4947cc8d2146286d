//! A number of a log: its column, and how it becomes SI units.

use std::{f64::consts::PI, fmt, marker::PhantomData};

use serde::{
    Deserialize, Deserializer,
    de::{Error, MapAccess, Visitor, value::MapAccessDeserializer},
};

/// A column with unit, scale and offset.
///
/// In the map it is the name of the column, or a table: `{ column, unit, scale, offset }`. Of a bag
/// the column is a field of the messages, and the key may be `field`. The
/// value is the number in the log times `scale`, in `unit`, plus `offset`, which is in SI units.
/// A negative scale turns the sign.
#[derive(Clone, Debug, PartialEq)]
pub struct Quantity<D> {
    pub(in crate::import) column: String,
    pub(in crate::import) conversion: Conversion,
    dimension: PhantomData<D>,
}

/// From the number in a log to SI units.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(in crate::import) struct Conversion {
    factor: f64,
    offset: f64,
}

impl Conversion {
    pub(in crate::import) const NONE: Self = Self {
        factor: 1.0,
        offset: 0.0,
    };

    /// To NaN.
    pub(in crate::import) const UNMEASURED: Self = Self {
        factor: f64::NAN,
        offset: 0.0,
    };

    pub(in crate::import) fn si(self, number: f64) -> f64 {
        number * self.factor + self.offset
    }
}

/// What a number measures.
pub trait Dimension {
    /// The words for its units, and their factors to the first one, which is that of SI.
    const UNITS: &'static [(&'static str, f64)];
}

macro_rules! dimensions {
    ($($(#[doc = $about:literal])* $name:ident: $($unit:literal = $factor:expr),*;)*) => {
        $(
            $(#[doc = $about])*
            #[derive(Clone, Copy, Debug, PartialEq, Eq)]
            pub enum $name {}

            impl Dimension for $name {
                const UNITS: &'static [(&'static str, f64)] = &[$(($unit, $factor)),*];
            }
        )*
    };
}

dimensions! {
    /// A length.
    Length: "m" = 1.0, "cm" = 1e-2, "mm" = 1e-3;
    /// An angle.
    Angle: "rad" = 1.0, "mrad" = 1e-3, "deg" = PI / 180.0;
    /// A speed.
    Speed: "m/s" = 1.0, "mm/s" = 1e-3, "km/h" = 1.0 / 3.6;
    /// An angular velocity.
    AngularVelocity: "rad/s" = 1.0, "mrad/s" = 1e-3, "deg/s" = PI / 180.0;
    /// An acceleration.
    Acceleration: "m/s2" = 1.0, "mm/s2" = 1e-3, "g" = 9.80665;
}

/// A quantity as a table.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Table {
    #[serde(alias = "field")]
    column: String,
    unit: Option<String>,
    #[serde(default = "one")]
    scale: f64,
    #[serde(default)]
    offset: f64,
}

const fn one() -> f64 {
    1.0
}

impl Table {
    fn quantity<D: Dimension, E: Error>(self) -> Result<Quantity<D>, E> {
        if !self.scale.is_finite() || self.scale == 0.0 {
            let scale = self.scale;
            let message = format!("scale is {scale}: use a finite number that is not 0");
            return Err(E::custom(message));
        }
        if !self.offset.is_finite() {
            let offset = self.offset;
            return Err(E::custom(format!(
                "offset is {offset}: use a finite number"
            )));
        }
        let factor = match &self.unit {
            None => 1.0,
            Some(unit) => {
                let mut units = D::UNITS.iter();
                let known = units.find(|(name, _)| name == unit);
                let (_, factor) = known.ok_or_else(|| {
                    let names: Vec<_> = D::UNITS.iter().map(|(name, _)| *name).collect();
                    let names = names.join(", ");
                    E::custom(format!(
                        "unit is {unit:?}: use one of {names}, or a scale to the first one"
                    ))
                })?;
                *factor
            }
        };
        Ok(Quantity {
            column: self.column,
            conversion: Conversion {
                factor: self.scale * factor,
                offset: self.offset,
            },
            dimension: PhantomData,
        })
    }
}

impl<'de, D: Dimension> Deserialize<'de> for Quantity<D> {
    fn deserialize<S: Deserializer<'de>>(deserializer: S) -> Result<Self, S::Error> {
        struct Either<D>(PhantomData<D>);

        impl<'de, D: Dimension> Visitor<'de> for Either<D> {
            type Value = Quantity<D>;

            fn expecting(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
                formatter.write_str(
                    "the name of a column, or a table with column, unit, scale and offset",
                )
            }

            fn visit_str<E: Error>(self, column: &str) -> Result<Quantity<D>, E> {
                let table = Table {
                    column: column.to_owned(),
                    unit: None,
                    scale: one(),
                    offset: 0.0,
                };
                table.quantity()
            }

            fn visit_map<A: MapAccess<'de>>(self, table: A) -> Result<Quantity<D>, A::Error> {
                Table::deserialize(MapAccessDeserializer::new(table))?.quantity()
            }
        }

        deserializer.deserialize_any(Either(PhantomData))
    }
}
