//! From the steering command of a log to the steering angle.

use serde::Deserialize;
use singletrack_control::interpolate;

use super::{InvalidValue, check_delay, check_finite};

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

/// The steering angle as a function of the command.
#[derive(Clone, Debug, PartialEq)]
pub enum SteeringMap {
    /// A straight line.
    Linear {
        /// The angle of a command of 1 less that of 0, in rad.
        radians_per_unit: f64,
        /// The angle of a command of 0, in rad.
        offset_rad: f64,
    },
    /// Pairs of command and angle in rad, in the order of the commands.
    Table(Vec<[f64; 2]>),
}

impl SteeringSection {
    pub(super) fn check(&self) -> Result<(), InvalidValue> {
        check_delay("steering.delay_s", self.delay_s)?;
        match (&self.table, self.radians_per_unit) {
            (None, None) => {
                let fix = "give steering.table or steering.radians_per_unit";
                return Err(InvalidValue::new("[steering]", "without an angle", fix));
            }
            (Some(_), Some(_)) => {
                let fix = "give steering.table or steering.radians_per_unit, not both";
                return Err(InvalidValue::new("[steering]", "with two angles", fix));
            }
            (None, Some(radians)) => {
                check_finite("steering.radians_per_unit", radians)?;
                if radians == 0.0 {
                    let fix = "use the angle of a command of 1";
                    return Err(InvalidValue::new("steering.radians_per_unit", radians, fix));
                }
            }
            (Some(table), None) => check_table(table)?,
        }
        match self.offset_rad {
            Some(offset_rad) if self.table.is_some() => {
                let fix = "add it to the angles of the table instead";
                Err(InvalidValue::new("steering.offset_rad", offset_rad, fix))
            }
            Some(offset_rad) => check_finite("steering.offset_rad", offset_rad),
            None => Ok(()),
        }
    }

    /// The angle as a function of the command.
    #[must_use]
    pub fn map(&self) -> SteeringMap {
        match &self.table {
            Some(table) => SteeringMap::Table(table.clone()),
            None => SteeringMap::Linear {
                radians_per_unit: self.radians_per_unit.unwrap_or_default(),
                offset_rad: self.offset_rad.unwrap_or_default(),
            },
        }
    }
}

fn check_table(table: &[[f64; 2]]) -> Result<(), InvalidValue> {
    const KEY: &str = "steering.table";
    if table.len() < 2 {
        let value = format!("a table of {} pairs", table.len());
        return Err(InvalidValue::new(KEY, value, "give at least 2"));
    }
    if let Some(pair) = table
        .iter()
        .find(|pair| !pair.iter().all(|one| one.is_finite()))
    {
        return Err(InvalidValue::new(
            KEY,
            format!("{pair:?}"),
            "use finite numbers",
        ));
    }
    let mut pairs = table.iter().zip(table.iter().skip(1));
    match pairs.find(|([before, _], [after, _])| after <= before) {
        None => Ok(()),
        Some(([before, _], [after, _])) => {
            let value = format!("a table with {after} after {before}");
            Err(InvalidValue::new(
                KEY,
                value,
                "put the pairs in the order of the commands",
            ))
        }
    }
}

impl SteeringMap {
    /// The steering angle of a command, in rad.
    #[must_use]
    pub fn angle(&self, command: f64) -> f64 {
        match self {
            Self::Linear {
                radians_per_unit,
                offset_rad,
            } => command * radians_per_unit + offset_rad,
            Self::Table(table) => interpolate(table, command),
        }
    }
}
