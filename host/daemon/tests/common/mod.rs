//! Helpers of several tests.

use std::{
    net::Ipv4Addr,
    path::Path,
    time::{Duration, Instant},
};

use singletrack_core::Config;

/// The example, with everything in this folder: a daemon that finds no board and no cameras, and
/// needs no priority.
pub(crate) fn config(folder: &Path) -> Config {
    let mut config = Config::from_toml(include_str!("../../singletrackd.example.toml")).unwrap();
    config.serial.port = folder.join("board");
    config.motion_capture.server = Ipv4Addr::LOCALHOST;
    config.motion_capture.command_port = Some(9);
    config.control.realtime_priority = 0;
    config.record.directory = folder.join("records");
    config.state.directory = folder.join("state");
    config.socket.path = folder.join("control.sock");
    config
}

/// Waits until `condition` holds. Returns how long that took.
pub(crate) fn wait_for(what: &str, mut condition: impl FnMut() -> bool) -> Duration {
    let begin = Instant::now();
    while !condition() {
        assert!(begin.elapsed() < Duration::from_secs(20), "never: {what}");
        std::thread::sleep(Duration::from_millis(1));
    }
    begin.elapsed()
}
