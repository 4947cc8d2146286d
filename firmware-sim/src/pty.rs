//! A pseudo-terminal in place of the board's serial port.

use std::{
    ffi::OsStr,
    io,
    os::{fd::OwnedFd, unix::ffi::OsStrExt},
    path::{Path, PathBuf},
};

use rustix::{
    fs::{OFlags, fcntl_setfl},
    io::Errno,
    pty::{OpenptFlags, grantpt, ioctl_tiocgptpeer, openpt, ptsname, unlockpt},
    termios::{OptionalActions, ioctl_tiocnxcl, tcgetattr, tcsetattr},
};

/// Why there is no pseudo-terminal, or no link to it.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub struct PtyError(String);

/// A pseudo-terminal in place of the board's serial port. Dropping it hangs up.
///
/// All byte values pass unchanged. It keeps the host's end open, because its own
/// end would otherwise return errors while no host is connected.
#[derive(Debug)]
pub struct Pty {
    master: OwnedFd,
    host_end: OwnedFd,
    device: PathBuf,
    link: Option<PathBuf>,
}

impl Pty {
    /// Opens a pseudo-terminal and links `link` to its device, replacing an existing
    /// link.
    ///
    /// # Errors
    ///
    /// Fails if the system provides none, or the link can't be created.
    pub fn open(link: Option<&Path>) -> Result<Self, PtyError> {
        let (master, host_end, device) = open_raw().map_err(|error| {
            let error = io::Error::from(error);
            PtyError(format!("can't open a pseudo-terminal: {error}"))
        })?;
        if let Some(link) = link {
            replace_link(link, &device).map_err(|error| {
                let link = link.display();
                PtyError(format!("can't link {link} to the pseudo-terminal: {error}"))
            })?;
        }
        Ok(Self {
            master,
            host_end,
            device,
            link: link.map(Path::to_owned),
        })
    }

    /// Path for the host: the link if there is one, else the device.
    pub fn path(&self) -> &Path {
        self.link.as_deref().unwrap_or(&self.device)
    }

    /// Reads bytes from the host; zero if there are none.
    ///
    /// # Errors
    ///
    /// The system's error.
    pub fn read(&self, buffer: &mut [u8]) -> io::Result<usize> {
        now(rustix::io::read(&self.master, buffer))
    }

    /// Writes bytes to the host; returns the number written.
    ///
    /// # Errors
    ///
    /// The system's error.
    pub fn write(&self, bytes: &[u8]) -> io::Result<usize> {
        now(rustix::io::write(&self.master, bytes))
    }

    /// Clears exclusive mode. A real port loses it when it is closed, but this one
    /// is never closed.
    pub fn clear_exclusive(&self) {
        // If this fails, the next host reports the error.
        let _ = ioctl_tiocnxcl(&self.host_end);
    }
}

/// What was done without waiting.
fn now(done: rustix::io::Result<usize>) -> io::Result<usize> {
    match done {
        Err(Errno::AGAIN | Errno::INTR) => Ok(0),
        done => Ok(done?),
    }
}

impl Drop for Pty {
    fn drop(&mut self) {
        if let Some(link) = &self.link
            && std::fs::read_link(link).is_ok_and(|target| target == self.device)
        {
            // No one can handle an error here.
            let _ = std::fs::remove_file(link);
        }
    }
}

fn open_raw() -> rustix::io::Result<(OwnedFd, OwnedFd, PathBuf)> {
    let flags = OpenptFlags::RDWR | OpenptFlags::NOCTTY | OpenptFlags::CLOEXEC;
    let master = openpt(flags)?;
    grantpt(&master)?;
    unlockpt(&master)?;
    let device = ptsname(&master, Vec::new())?;
    let host_end = ioctl_tiocgptpeer(&master, flags)?;
    let mut settings = tcgetattr(&host_end)?;
    settings.make_raw();
    tcsetattr(&host_end, OptionalActions::Now, &settings)?;
    fcntl_setfl(&master, OFlags::NONBLOCK)?;
    let device = PathBuf::from(OsStr::from_bytes(device.as_bytes()));
    Ok((master, host_end, device))
}

fn replace_link(link: &Path, device: &Path) -> io::Result<()> {
    if std::fs::symlink_metadata(link).is_ok_and(|metadata| !metadata.is_symlink()) {
        return Err(io::Error::other(
            "the path exists and is not a link; remove it or choose another path",
        ));
    }
    // Created beside and renamed, so that the link always exists.
    let mut temporary = link.as_os_str().to_owned();
    temporary.push(format!(".{}", std::process::id()));
    let temporary = PathBuf::from(temporary);
    std::os::unix::fs::symlink(device, &temporary)?;
    std::fs::rename(&temporary, link).inspect_err(|_| {
        // The first error is the one to report.
        let _ = std::fs::remove_file(&temporary);
    })
}
