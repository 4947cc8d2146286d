//! `[record]`, `[socket]` and `[live]`: where the daemon writes and listens.

use std::{
    net::{IpAddr, Ipv4Addr},
    path::PathBuf,
};

use serde::{Deserialize, Serialize};

use super::ConfigError;

/// The record of every tick.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct RecordSection {
    /// Whether there is one.
    pub enabled: bool,
    /// Where the files go; made if it does not exist.
    pub directory: PathBuf,
}

impl Default for RecordSection {
    fn default() -> Self {
        Self {
            enabled: true,
            directory: PathBuf::from("/var/log/singletrackd"),
        }
    }
}

/// The control socket.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SocketSection {
    /// Whether there is one.
    pub enabled: bool,
    /// Where it is.
    pub path: PathBuf,
}

impl Default for SocketSection {
    fn default() -> Self {
        Self {
            enabled: true,
            path: PathBuf::from("/run/singletrackd/control.sock"),
        }
    }
}

/// The live view over WebSocket, for Foxglove, Lichtblick and PlotJuggler.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct LiveSection {
    /// Whether there is one.
    pub enabled: bool,
    /// Where it listens. It asks nobody who he is: what is not a loopback address
    /// shows the car to the network.
    pub address: IpAddr,
    /// On which port; 0 for any that is free.
    pub port: u16,
}

impl Default for LiveSection {
    fn default() -> Self {
        Self {
            enabled: false,
            address: IpAddr::V4(Ipv4Addr::LOCALHOST),
            port: 8_765,
        }
    }
}

/// What the address of a Unix-domain socket holds, without the closing zero.
const LONGEST_SOCKET_PATH: usize = 107;

impl RecordSection {
    pub(super) fn validate(&self) -> Result<(), ConfigError> {
        if self.enabled && self.directory.as_os_str().is_empty() {
            return Err(ConfigError::value(
                "record.directory",
                "empty",
                "name a folder for the records, or set record.enabled = false",
            ));
        }
        Ok(())
    }
}

impl SocketSection {
    pub(super) fn validate(&self) -> Result<(), ConfigError> {
        let length = self.path.as_os_str().len();
        if self.enabled && !(1..=LONGEST_SOCKET_PATH).contains(&length) {
            return Err(ConfigError::value(
                "socket.path",
                self.path.display(),
                format!(
                    "it must be 1 to {LONGEST_SOCKET_PATH} bytes long, or set socket.enabled = false"
                ),
            ));
        }
        Ok(())
    }
}
