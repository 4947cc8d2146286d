//! Decisions of a test, read from bytes; frames of the serial line with arbitrary packets, and the
//! calibration of board and session.

use crc::{CRC_16_IBM_SDLC, Crc};
use singletrack_protocol::{
    Configuration, EscCalibration, EscKind, FailsafeAction, ImuAxes, LONGEST_ROLL_OUT_MS,
    ServoCalibration, SpeedLoop,
};

/// The sequence of decisions in a fuzzer's bytes.
///
/// Changing one byte changes one decision and keeps the later ones. At the end
/// every decision is zero.
#[derive(Clone, Debug)]
pub(crate) struct Choices<'a>(&'a [u8]);

impl<'a> Choices<'a> {
    pub(crate) const fn new(data: &'a [u8]) -> Self {
        Self(data)
    }

    pub(crate) const fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// The remaining bytes.
    pub(crate) fn rest(&mut self) -> &'a [u8] {
        core::mem::take(&mut self.0)
    }

    /// Up to `count` bytes.
    fn take(&mut self, count: usize) -> &'a [u8] {
        let (taken, rest) = self.0.split_at(count.min(self.0.len()));
        self.0 = rest;
        taken
    }

    fn array<const N: usize>(&mut self) -> [u8; N] {
        let mut array = [0; N];
        for (slot, byte) in array.iter_mut().zip(self.take(N)) {
            *slot = *byte;
        }
        array
    }

    /// Bytes preceded by their length, up to 255.
    pub(crate) fn bytes(&mut self) -> &'a [u8] {
        let count = self.byte();
        self.take(count.into())
    }

    pub(crate) fn byte(&mut self) -> u8 {
        u8::from_le_bytes(self.array())
    }

    pub(crate) fn flag(&mut self) -> bool {
        self.byte() & 1 != 0
    }

    pub(crate) fn u16(&mut self) -> u16 {
        u16::from_le_bytes(self.array())
    }

    pub(crate) fn i16(&mut self) -> i16 {
        i16::from_le_bytes(self.array())
    }

    pub(crate) fn u32(&mut self) -> u32 {
        u32::from_le_bytes(self.array())
    }

    pub(crate) fn i32(&mut self) -> i32 {
        i32::from_le_bytes(self.array())
    }

    pub(crate) fn u64(&mut self) -> u64 {
        u64::from_le_bytes(self.array())
    }

    /// Any bit pattern, including infinities and NaN.
    pub(crate) fn f32(&mut self) -> f32 {
        f32::from_le_bytes(self.array())
    }

    /// Any bit pattern, including infinities and NaN.
    pub(crate) fn f64(&mut self) -> f64 {
        f64::from_le_bytes(self.array())
    }

    /// One of the options.
    pub(crate) fn one_of<T: Copy, const N: usize>(&mut self, options: [T; N]) -> T {
        const { assert!(N > 0) };
        options[usize::from(self.byte()) % N]
    }
}

const CHECKSUM: Crc<u16> = Crc::<u16>::new(&CRC_16_IBM_SDLC);

/// A frame with a valid checksum, for any type byte and payload.
///
/// The payload may exceed those of all messages, up to 255 bytes.
pub(crate) fn frame(kind: u8, payload: &[u8]) -> Vec<u8> {
    let mut packet = vec![kind];
    packet.extend_from_slice(payload);
    let checksum = CHECKSUM.checksum(&packet);
    packet.extend_from_slice(&checksum.to_le_bytes());
    let mut frame = vec![0; cobs::max_encoding_length(packet.len()) + 1];
    let length = cobs::encode(&packet, &mut frame);
    // The final zero is already there.
    frame.truncate(length + 1);
    frame
}

/// A valid configuration.
pub(crate) const CONFIGURATION: Configuration = Configuration {
    servo: ServoCalibration {
        centre_us: 1_500,
        gain_us_per_rad: 800,
        min_us: 1_080,
        max_us: 1_920,
        slew_us_per_20ms: 96,
    },
    esc: EscCalibration {
        kind: EscKind::Car,
        neutral_us: 1_500,
        deadband_us: 30,
        min_us: 1_200,
        max_us: 1_700,
        slew_us_per_20ms: 40,
        brake_us: 1_350,
    },
    speed: SpeedLoop {
        pulse_distance_um: 3_000,
        feed_forward_us_per_m_s: 80,
        proportional_us_per_m_s: 80,
        integral_us_per_m: 250,
        integral_limit_us: 60,
        max_forward_mm_s: 1_500,
        max_reverse_mm_s: 0,
    },
    failsafe: FailsafeAction::Coast,
    max_pose_age_ms: 950,
    stop_input: false,
    kill_output: false,
    max_roll_out_ms: LONGEST_ROLL_OUT_MS,
    car_id: 0,
    imu_axes: ImuAxes::AS_PRINTED,
};

#[cfg(test)]
mod tests {
    use singletrack_protocol::{Decoder, Disarm, Message, Packet, Sequence};

    #[test]
    fn frames_match_the_protocol() {
        let disarm = Disarm {
            request: Sequence(7),
        };
        assert_eq!(super::frame(0x12, &[7]), disarm.encode().as_bytes());
        let mut decoder = Decoder::new();
        let packets: Vec<_> = super::frame(0xEE, &[0, 1, 0])
            .into_iter()
            .filter_map(|byte| {
                let Packet { kind, payload } = decoder.push(byte)?.unwrap();
                Some((kind, payload.to_vec()))
            })
            .collect();
        assert_eq!(packets, [(0xEE, vec![0, 1, 0])]);
    }
}
