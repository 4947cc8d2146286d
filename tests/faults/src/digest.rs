//! A hash of the events of a drive.

use crate::observation::Observation;

/// FNV-1a over words.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Digest(u64);

impl Default for Digest {
    fn default() -> Self {
        Self(0xcbf2_9ce4_8422_2325)
    }
}

impl Digest {
    fn word(&mut self, word: u64) {
        self.0 = (self.0 ^ word).wrapping_mul(0x0000_0100_0000_01b3);
        self.0 ^= self.0 >> 29;
    }

    fn text(&mut self, text: &str) {
        for byte in text.bytes() {
            self.word(byte.into());
        }
    }

    /// Hashes the events of a step.
    pub(crate) fn add(&mut self, observation: &Observation<'_>) {
        for pulse in observation.pulses {
            self.word(pulse.time_us);
            self.word(u64::from(pulse.servo_us) << 16 | u64::from(pulse.esc_us));
        }
        for received in observation.board_received {
            self.word(received.time_us);
        }
        if let Some(tick) = observation.tick {
            self.word(observation.now_us);
            self.word(tick.events.len() as u64);
            let output = &tick.output;
            self.text(output.mode.name());
            self.text(output.reason.map_or("", |reason| reason.name()));
            self.word(output.actuation.speed.to_bits());
            self.word(output.actuation.steering.to_bits());
            self.word(observation.truth.x.to_bits());
            self.word(observation.truth.y.to_bits());
        }
    }

    pub(crate) const fn value(self) -> u64 {
        self.0
    }
}
