//! Replay of a record: the same inputs to the same pilot must give the same outputs, bit
//! for bit.

use std::{collections::BTreeMap, fmt};

use singletrack_pilot::{Event, Output, Pilot, PilotConfig, Underway};

use crate::{
    Entry, TickRecord, Topic, Value,
    message::{self, Represents as _, TickMessage},
};

/// A pilot that steps through the ticks of a record.
#[derive(Clone, Debug)]
pub struct Replay {
    pilot: Pilot,
    configurations: BTreeMap<u32, PilotConfig>,
    next: u64,
}

/// Why a record can't be replayed beyond a tick.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ReplayError {
    /// Ticks are missing, and with them the inputs of the pilot.
    #[error(
        "ticks {first} to {} are not in the record, and the outputs after them depend on their events",
        first + count - 1
    )]
    Missing {
        /// The first missing tick.
        first: u64,
        /// The number of missing ticks.
        count: u64,
    },
    /// A tick is repeated, or follows a later one.
    #[error("tick {found} is in the place of tick {expected}")]
    OutOfOrder {
        /// The index found.
        found: u64,
        /// The index expected.
        expected: u64,
    },
    /// A configuration of the pilot is missing.
    #[error("configuration {0} came into force, and is not in the record")]
    Configuration(u32),
    /// The pilot refused a configuration.
    #[error("configuration {number} came into force, and is refused now: {reason}")]
    Refused {
        /// Its number.
        number: u32,
        /// The error of the pilot.
        reason: Underway,
    },
}

impl Replay {
    /// A pilot in its state before the first tick. `configuration` has number 1.
    pub fn new(configuration: PilotConfig) -> Self {
        Self {
            pilot: Pilot::new(configuration),
            configurations: BTreeMap::new(),
            next: 0,
        }
    }

    /// Adds a configuration that came into force later.
    pub fn configuration(&mut self, number: u32, configuration: PilotConfig) {
        self.configurations.insert(number, configuration);
    }

    /// Steps the pilot with the inputs of this tick. The first tick has index 0, and none
    /// may be missing.
    ///
    /// # Errors
    ///
    /// When a tick or a configuration is missing, or the pilot refuses a configuration.
    pub fn tick(&mut self, recorded: &TickRecord) -> Result<Output, ReplayError> {
        let (found, expected) = (recorded.index, self.next);
        if found > expected {
            return Err(ReplayError::Missing {
                first: expected,
                count: found - expected,
            });
        }
        if found < expected {
            return Err(ReplayError::OutOfOrder { found, expected });
        }
        for event in &recorded.events {
            // It came into force before the pilot took any event of the tick.
            if let Event::Reconfigured(number) = *event {
                let configuration = self.configurations.get(&number);
                self.pilot
                    .reconfigure(configuration.ok_or(ReplayError::Configuration(number))?)
                    .map_err(|reason| ReplayError::Refused { number, reason })?;
            }
        }
        self.next += 1;
        Ok(self.pilot.step(recorded.pilot_time, &recorded.events))
    }
}

/// A field of a tick that differs in the replay.
#[derive(Clone, Debug, PartialEq)]
pub struct Difference {
    /// Its path: see [`crate::Topic::fields`].
    pub field: String,
    /// The recorded value.
    pub recorded: Value,
    /// The replayed value.
    pub replayed: Value,
}

impl fmt::Display for Difference {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let shown = |value: &Value| match value {
            Value::Absent => "absent".to_owned(),
            // Numbers with the same text can differ in their bits.
            Value::Float(value) => format!("{value:?} ({:016x})", value.to_bits()),
            other => other.to_string(),
        };
        let (recorded, replayed) = (shown(&self.recorded), shown(&self.replayed));
        write!(
            formatter,
            "{}: recorded {recorded}, replayed {replayed}",
            self.field
        )
    }
}

impl TickRecord {
    /// Whether `output` equals the recorded output, bit for bit.
    pub fn is_output(&self, output: &Output) -> bool {
        // Bytes are compared because `==` takes -0 for 0 and NaN for different from itself.
        matches!(
            (self.output_bytes(&self.output), self.output_bytes(output)),
            (Some(a), Some(b)) if a == b
        )
    }

    /// The fields in which `output` differs from the recorded output.
    pub fn differences(&self, output: &Output) -> Vec<Difference> {
        let values = |tick: Self| Entry::Tick(tick).values();
        let replayed = values(Self {
            output: *output,
            ..self.clone()
        });
        Topic::Tick
            .fields()
            .into_iter()
            .zip(values(self.clone()).into_iter().zip(replayed))
            .filter(|(_, (recorded, replayed))| !same(recorded, replayed))
            .map(|(field, (recorded, replayed))| Difference {
                field,
                recorded,
                replayed,
            })
            .collect()
    }

    /// The tick with this output and without its events, as it is encoded; `None` if it can't be.
    fn output_bytes(&self, output: &Output) -> Option<Vec<u8>> {
        let tick = Self {
            events: heapless::Vec::new(),
            output: *output,
            ..*self
        };
        // Longer than nearly every tick without its events.
        let mut bytes = Vec::with_capacity(1 << 10);
        let encoded = message::encode(&TickMessage::of(&tick), &mut bytes);
        encoded.is_ok().then_some(bytes)
    }
}

fn same(one: &Value, other: &Value) -> bool {
    match (one, other) {
        (Value::Float(one), Value::Float(other)) => one.to_bits() == other.to_bits(),
        _ => one == other,
    }
}

/// FNV-1a, 64 bits, of the outputs of ticks in their order, as a record encodes them: two drives with
/// one digest have the same bits. It is no protection against forgery.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Digest(u64);

impl Default for Digest {
    fn default() -> Self {
        Self(0xcbf2_9ce4_8422_2325)
    }
}

impl Digest {
    /// Adds the next tick.
    pub fn add(&mut self, tick: &TickRecord) {
        for byte in tick.output_bytes(&tick.output).unwrap_or_default() {
            self.0 = (self.0 ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3);
        }
    }
}

/// Sixteen hexadecimal digits.
impl fmt::Display for Digest {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(formatter, "{:016x}", self.0)
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::panic, reason = "a test may fail")]

    use super::*;
    use crate::tick::tests::full;

    #[test]
    fn a_single_bit_is_a_difference() {
        let tick = full();
        assert!(tick.is_output(&tick.output));
        assert_eq!(tick.differences(&tick.output), []);

        let mut output = tick.output;
        let estimate = output.estimate.as_mut().unwrap();
        estimate.yaw = f64::from_bits(estimate.yaw.to_bits() ^ 1);
        assert!(!tick.is_output(&output));
        let [difference] = &tick.differences(&output)[..] else {
            panic!("one field differs");
        };
        assert_eq!(
            difference.to_string(),
            "estimate.yaw_rad: recorded 0.30000000000000004 (3fd3333333333334), \
             replayed 0.3000000000000001 (3fd3333333333335)"
        );
    }

    #[test]
    fn zeros_of_two_signs_differ_and_a_nan_is_itself() {
        let mut tick = full();
        tick.output.actuation.speed = 0.0;
        let mut output = tick.output;
        output.actuation.speed = -0.0;
        assert!(!tick.is_output(&output));
        assert_eq!(tick.differences(&output).len(), 1);
        tick.output.actuation.speed = f64::NAN;
        assert!(tick.is_output(&tick.output));
        assert_eq!(tick.differences(&tick.output), []);
    }

    #[test]
    fn every_bit_and_the_order_count() {
        let digest = |ticks: &[&TickRecord]| {
            let mut digest = Digest::default();
            ticks.iter().for_each(|tick| digest.add(tick));
            digest.to_string()
        };
        let one = full();
        let mut other = one.clone();
        other.output.actuation.speed = f64::from_bits(other.output.actuation.speed.to_bits() ^ 1);
        assert_eq!(digest(&[]), "cbf29ce484222325");
        assert_eq!(digest(&[&one]), digest(&[&one.clone()]));
        assert_ne!(digest(&[&one]), digest(&[&other]));
        assert_ne!(digest(&[&one, &other]), digest(&[&other, &one]));
    }
}
