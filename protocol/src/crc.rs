//! The two checksums, in forms that suit an 8-bit processor.
//!
//! On the AVR every constant is in SRAM; the usual table of 256 entries would take
//! a quarter of it. CRC-16/X-25 is therefore computed by nibbles in registers, and
//! CRC-32, which is needed once per configuration, by bits.

/// Running CRC-16/X-25.
///
/// Two bytes instead of a 16-bit number, because the board computes in bytes.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Crc16 {
    low: u8,
    high: u8,
}

impl Crc16 {
    /// State after a message and its checksum: 0xF0B8, low byte first.
    const RESIDUE: [u8; 2] = [0xB8, 0xF0];

    pub(crate) const fn new() -> Self {
        Self {
            low: 0xFF,
            high: 0xFF,
        }
    }

    #[inline(always)]
    pub(crate) const fn update(&mut self, byte: u8) {
        // Reflected polynomial 0x8408. Its two nibble steps reduce to shifts
        // because it is sparse: x^16 + x^12 + x^5 + 1.
        let mut mixed = byte ^ self.low;
        mixed ^= mixed << 4;
        self.low = self.high ^ (mixed >> 4) ^ (mixed << 3);
        self.high = mixed ^ (mixed >> 5);
    }

    /// The checksum in the order of transmission, low byte first.
    pub(crate) const fn finish(self) -> [u8; 2] {
        [!self.low, !self.high]
    }

    /// Whether the last two bytes were the checksum of all bytes before them.
    pub(crate) const fn is_residue(self) -> bool {
        self.low == Self::RESIDUE[0] && self.high == Self::RESIDUE[1]
    }
}

/// CRC-32/ISO-HDLC of `bytes`, as in Ethernet and zip.
pub(crate) fn crc32(bytes: &[u8]) -> u32 {
    let mut crc = u32::MAX;
    for &byte in bytes {
        crc ^= u32::from(byte);
        for _ in 0..8 {
            crc = if crc & 1 == 0 {
                crc >> 1
            } else {
                (crc >> 1) ^ 0xEDB8_8320
            };
        }
    }
    !crc
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::{Crc16, crc32};

    fn crc16(bytes: &[u8]) -> u16 {
        let mut crc = Crc16::new();
        for &byte in bytes {
            crc.update(byte);
        }
        u16::from_le_bytes(crc.finish())
    }

    #[test]
    fn check_values_match_the_catalogue() {
        assert_eq!(crc16(b"123456789"), 0x906E);
        assert_eq!(crc32(b"123456789"), 0xCBF4_3926);
    }

    proptest! {
        #[test]
        fn both_agree_with_an_independent_implementation(bytes: [u8; 41], length in 0_usize..=41) {
            let bytes = &bytes[..length];
            prop_assert_eq!(crc16(bytes), crc::Crc::<u16>::new(&crc::CRC_16_IBM_SDLC).checksum(bytes));
            prop_assert_eq!(crc32(bytes), crc::Crc::<u32>::new(&crc::CRC_32_ISO_HDLC).checksum(bytes));
        }

        #[test]
        fn a_message_and_its_checksum_leave_the_residue(bytes: [u8; 20], wrong in 1_u16..) {
            for (flip, good) in [(0, true), (wrong, false)] {
                let mut crc = Crc16::new();
                for byte in bytes.into_iter().chain((crc16(&bytes) ^ flip).to_le_bytes()) {
                    crc.update(byte);
                }
                prop_assert_eq!(crc.is_residue(), good);
            }
        }
    }
}
