//! `[serial]`: the line to the board.

use core::num::NonZeroU32;
use std::path::PathBuf;

use singletrack_settings::{Declared as _, section};

use super::ConfigError;

/// The rate of the firmware, in baud.
const BAUD: NonZeroU32 = NonZeroU32::new(115_200).unwrap();

section! {
    /// The serial line to the board.
    "serial", restart => pub SerialSection: Eq;
    [new];

    /// The board's device. Use a link that stays the same when the board is plugged in again:
    /// /dev/serial/by-id/..., or one that a udev rule makes.
    port: PathBuf, example "/dev/serial/by-id/usb-Arduino_Uno-if00";
    /// Rate of the line, in baud; that of the firmware.
    baud: u32 = BAUD.get(), in 9_600..=2_000_000;
}

impl SerialSection {
    /// The rate, which [`validate`](Self::validate) has found in its range.
    pub(crate) fn baud(&self) -> NonZeroU32 {
        NonZeroU32::new(self.baud).unwrap_or(BAUD)
    }

    pub(super) fn validate(&self) -> Result<(), ConfigError> {
        if self.port.as_os_str().is_empty() {
            return Err(ConfigError::value(
                "serial.port",
                "empty",
                "name the board's device, such as \"/dev/ttyACM0\"",
            ));
        }
        Ok(self.check()?)
    }
}
