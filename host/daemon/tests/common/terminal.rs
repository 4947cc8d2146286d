//! A pseudo-terminal in place of the board's port.

#![allow(dead_code, reason = "each test file uses its own part")]

use std::{
    ffi::OsStr,
    os::{fd::OwnedFd, unix::ffi::OsStrExt},
    path::{Path, PathBuf},
};

use rustix::{
    fs::{OFlags, fcntl_setfl},
    pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt},
    termios::{OptionalActions, tcgetattr, tcsetattr},
};

/// The board's end of a pseudo-terminal. Dropping it hangs up the line.
pub(crate) struct Terminal {
    master: OwnedFd,
    device: PathBuf,
}

impl Terminal {
    pub(crate) fn open() -> Self {
        let master =
            openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY | OpenptFlags::CLOEXEC).unwrap();
        grantpt(&master).unwrap();
        unlockpt(&master).unwrap();
        let mut settings = tcgetattr(&master).unwrap();
        settings.make_raw();
        tcsetattr(&master, OptionalActions::Now, &settings).unwrap();
        fcntl_setfl(&master, OFlags::NONBLOCK).unwrap();
        let name = ptsname(&master, Vec::new()).unwrap();
        let device = PathBuf::from(OsStr::from_bytes(name.as_bytes()));
        Self { master, device }
    }

    pub(crate) fn device(&self) -> &Path {
        &self.device
    }

    /// Makes `link` a symbolic link to the device.
    pub(crate) fn link(&self, link: &Path) {
        let _ = std::fs::remove_file(link);
        std::os::unix::fs::symlink(&self.device, link).unwrap();
    }

    /// The bytes that wait.
    pub(crate) fn read(&self) -> Vec<u8> {
        let mut all = Vec::new();
        let mut buffer = [0; 4_096];
        while let Ok(count @ 1..) = rustix::io::read(&self.master, &mut buffer) {
            all.extend_from_slice(&buffer[..count]);
        }
        all
    }

    pub(crate) fn write(&self, bytes: &[u8]) {
        assert_eq!(rustix::io::write(&self.master, bytes), Ok(bytes.len()));
    }
}
