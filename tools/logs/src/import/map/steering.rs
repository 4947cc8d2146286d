//! From the steering command of a log to the steering angle, and the messages that a section is
//! about.

use serde::Deserialize;
use singletrack_control::interpolate;

use super::{check_delay, check_finite, invalid, require};

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
    pub(super) fn check(&self) -> Result<(), String> {
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
    pub(super) topic: Option<&'a str>,
    pub(super) stamp: Option<&'a str>,
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

    pub(super) fn check(self, is_bag: bool) -> Result<(), String> {
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
