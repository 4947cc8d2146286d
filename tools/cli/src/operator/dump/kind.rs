//! What a row can be, and the names that people give to topics and fields.

use singletrack_record::{Topic, Value};

use super::DumpError;

/// The field that every row has beside its own: seconds since the start of the
/// record, of the capture, or of listening.
pub(super) const TIME: &str = "time_s";

/// A topic of a record, or a type of frame on the line.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Kind {
    /// Its name on the command line and in JSON.
    pub(super) name: &'static str,
    /// The paths of its fields, in order.
    pub(super) fields: Vec<String>,
    /// Those that a table shows unless asked for others; empty for all.
    pub(super) brief: Vec<&'static str>,
}

/// Where a column or a condition finds its value.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Place {
    /// It is the row's time.
    Time,
    /// It is the field with this index.
    Field(usize),
}

impl Place {
    /// The value in a row with this time and these fields.
    pub(super) fn value<'a>(self, time: &'a Value, values: &'a [Value]) -> &'a Value {
        match self {
            Self::Time => time,
            Self::Field(index) => values.get(index).unwrap_or(&Value::Absent),
        }
    }
}

impl Kind {
    /// The topics of a record.
    pub(super) fn topics() -> Vec<Self> {
        Topic::ALL
            .into_iter()
            .map(|topic| Self {
                name: topic.name(),
                fields: topic.fields(),
                brief: brief(topic),
            })
            .collect()
    }

    /// Where a field is, if it has one of that name.
    pub(super) fn place(&self, name: &str) -> Option<Place> {
        if name == TIME {
            return Some(Place::Time);
        }
        self.index(name).map(Place::Field)
    }

    /// Which of its fields has that name.
    pub(super) fn index(&self, name: &str) -> Option<usize> {
        self.fields.iter().position(|field| field == name)
    }
}

/// What a table shows of telemetry beside its time.
pub(super) const TELEMETRY: &[&str] = &[
    "mode",
    "stop_cause",
    "last_sequence",
    "imu",
    "forward_acceleration_mm_s2",
    "left_acceleration_mm_s2",
    "yaw_rate_mrad_s",
    "motor_speed_mm_s",
    "servo_us",
    "esc_us",
];

/// What a table shows of a topic unless asked for more.
fn brief(topic: Topic) -> Vec<&'static str> {
    match topic {
        Topic::Tick => vec![
            "index",
            "mode",
            "reason",
            "held",
            "point.x_m",
            "point.y_m",
            "reference.position.x_m",
            "reference.position.y_m",
            "estimate.yaw_rad",
            "estimate.speed_m_s",
            "actuation.steering_rad",
            "lateness_ns",
            "capture_to_command_ns",
        ],
        Topic::Telemetry => [&["receive_time_ns"], TELEMETRY].concat(),
        Topic::Pose => vec![
            "frame_number",
            "receive_time_ns",
            "state",
            "rejected",
            "pose.x_m",
            "pose.y_m",
            "pose.yaw_rad",
            "pose.mean_error_m",
            "pose.capture_time_ns",
        ],
        // Which is a page of text.
        Topic::Configuration => vec!["time_ns", "number"],
        _ => Vec::new(),
    }
}

/// The kinds with these names, in the order of `kinds`.
pub(super) fn choose(kinds: &[Kind], names: &[String]) -> Result<Vec<usize>, DumpError> {
    for name in names {
        if !kinds.iter().any(|kind| kind.name == name) {
            let known: Vec<_> = kinds.iter().map(|kind| kind.name).collect();
            return Err(DumpError::Other(format!(
                "there is no topic {name:?}{}: use {}",
                near(name, known.iter().copied()),
                known.join(", ")
            )));
        }
    }
    Ok(kinds
        .iter()
        .enumerate()
        .filter(|(_, kind)| names.iter().any(|name| name == kind.name))
        .map(|(index, _)| index)
        .collect())
}

/// Refuses a field that none of the kinds has.
pub(super) fn check_field<'a>(
    kinds: impl Iterator<Item = &'a Kind> + Clone,
    name: &str,
) -> Result<(), DumpError> {
    if kinds.clone().any(|kind| kind.place(name).is_some()) {
        return Ok(());
    }
    let mut known: Vec<&str> = Vec::new();
    for field in kinds.clone().flat_map(|kind| &kind.fields) {
        if !known.contains(&field.as_str()) {
            known.push(field);
        }
    }
    known.push(TIME);
    let topics: Vec<_> = kinds.map(|kind| kind.name).collect();
    Err(DumpError::Other(format!(
        "{} has no field {name:?}{}; its fields are {}",
        topics.join(", "),
        near(name, known.iter().copied()),
        known.join(", ")
    )))
}

/// A question for the name that was probably meant, if one is near.
fn near<'a>(name: &str, known: impl Iterator<Item = &'a str> + Clone) -> String {
    nearest(name, known).map_or_else(String::new, |name| format!(" (did you mean {name:?}?)"))
}

/// The name that was probably meant: one that contains it, or one that
/// differs by little, in whole or in its last part.
fn nearest<'a>(name: &str, known: impl Iterator<Item = &'a str> + Clone) -> Option<String> {
    const ALIKE: f64 = 0.6;
    let contained = |known: &&str| known.contains(name) || name.contains(*known);
    if let Some(known) = known.clone().find(contained) {
        return Some(known.to_owned());
    }
    let alike = |known: &str| {
        let last = known.rsplit('.').next().unwrap_or(known);
        strsim::normalized_damerau_levenshtein(name, known)
            .max(strsim::normalized_damerau_levenshtein(name, last))
    };
    known
        .map(|known| (known, alike(known)))
        .filter(|(_, alike)| *alike >= ALIKE)
        .max_by(|(_, a), (_, b)| a.total_cmp(b))
        .map(|(known, _)| known.to_owned())
}

#[cfg(test)]
mod tests {
    use super::nearest;

    #[test]
    fn the_field_that_was_meant_is_found() {
        let known = [
            "index",
            "estimate.yaw_rad",
            "yaw_rate_mrad_s",
            "lateness_ns",
        ];
        for (name, expected) in [
            ("yaw_rate", Some("yaw_rate_mrad_s")),
            ("yaw_rda", Some("estimate.yaw_rad")),
            ("latenes_ns", Some("lateness_ns")),
            ("colour", None),
        ] {
            assert_eq!(
                nearest(name, known.into_iter()).as_deref(),
                expected,
                "{name}"
            );
        }
    }
}
