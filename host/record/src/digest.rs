//! A number for the outputs of a drive.

use std::fmt;

use singletrack_pilot::Output;

use crate::{
    TickRecord,
    message::{self, Represents as _, TickMessage},
};

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

impl TickRecord {
    /// The tick with this output and without its events, as it is encoded; `None` if it can't be.
    pub(crate) fn output_bytes(&self, output: &Output) -> Option<Vec<u8>> {
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tick::tests::full;

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
