//! `[serial]`: the line to the board.

use core::num::NonZeroU32;
use std::path::PathBuf;

use serde::{Deserialize, Serialize};

use super::{ConfigError, check};

/// The serial port that the board is at.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SerialSection {
    /// The device; a link that stays the same when the board is plugged in
    /// again.
    pub port: PathBuf,
    /// Rate of the line, in baud: the firmware's.
    #[serde(default = "SerialSection::default_baud")]
    pub baud: u32,
}

impl SerialSection {
    const DEFAULT_BAUD: NonZeroU32 = match NonZeroU32::new(115_200) {
        Some(baud) => baud,
        None => NonZeroU32::MIN,
    };

    fn default_baud() -> u32 {
        Self::DEFAULT_BAUD.get()
    }

    /// The port at the firmware's rate.
    #[must_use]
    pub fn new(port: impl Into<PathBuf>) -> Self {
        Self {
            port: port.into(),
            baud: Self::default_baud(),
        }
    }

    /// The rate, which [`validate`](Self::validate) has seen not to be zero.
    pub(crate) fn baud(&self) -> NonZeroU32 {
        NonZeroU32::new(self.baud).unwrap_or(Self::DEFAULT_BAUD)
    }

    pub(super) fn validate(&self) -> Result<(), ConfigError> {
        if self.port.as_os_str().is_empty() {
            return Err(ConfigError::value(
                "serial.port",
                "empty",
                "name the board's device, such as \"/dev/ttyACM0\"",
            ));
        }
        check::within("serial.baud", self.baud, 9_600..=2_000_000)
    }
}
