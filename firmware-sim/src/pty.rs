//! A pseudo-terminal that looks like the board's serial port.

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

/// Why there is no pseudo-terminal.
#[derive(Debug, thiserror::Error)]
pub enum PtyError {
    /// The system gives none.
    #[error("cannot open a pseudo-terminal: {0}")]
    Open(#[source] io::Error),
    /// Something else is at the place of the link.
    #[error("cannot link {link} to the pseudo-terminal: something that is no link is there; remove it or choose another path", link = link.display())]
    Occupied {
        /// The path asked for.
        link: PathBuf,
    },
    /// The link cannot be made.
    #[error("cannot link {link} to the pseudo-terminal: {source}", link = link.display())]
    Link {
        /// The path asked for.
        link: PathBuf,
        /// What the system says.
        source: io::Error,
    },
}

/// A pseudo-terminal that looks like the board's serial port; dropped, it
/// hangs up.
///
/// It passes every byte value unchanged. It holds the host's end open itself:
/// otherwise its own end would read errors whenever no host is there.
#[derive(Debug)]
pub struct Pty {
    master: OwnedFd,
    host_end: OwnedFd,
    device: PathBuf,
    link: Option<PathBuf>,
}

impl Pty {
    /// Opens one, and links `link` to its device, replacing a link that is there.
    ///
    /// # Errors
    ///
    /// When the system gives none, or the link cannot be made.
    pub fn open(link: Option<&Path>) -> Result<Self, PtyError> {
        let (master, host_end, device) =
            open_raw().map_err(|error| PtyError::Open(error.into()))?;
        if let Some(link) = link {
            replace_link(link, &device)?;
        }
        Ok(Self {
            master,
            host_end,
            device,
            link: link.map(Path::to_owned),
        })
    }

    /// Where a host finds it: the link if there is one, else the device.
    #[must_use]
    pub fn path(&self) -> &Path {
        self.link.as_deref().unwrap_or(&self.device)
    }

    /// Takes what the host has written; zero when there is nothing.
    ///
    /// # Errors
    ///
    /// What the system says.
    pub fn read(&self, buffer: &mut [u8]) -> io::Result<usize> {
        match rustix::io::read(&self.master, buffer) {
            Ok(count) => Ok(count),
            Err(Errno::AGAIN | Errno::INTR) => Ok(0),
            Err(error) => Err(error.into()),
        }
    }

    /// Gives bytes to the host; returns how many there was room for.
    ///
    /// # Errors
    ///
    /// What the system says.
    pub fn write(&self, bytes: &[u8]) -> io::Result<usize> {
        match rustix::io::write(&self.master, bytes) {
            Ok(count) => Ok(count),
            Err(Errno::AGAIN | Errno::INTR) => Ok(0),
            Err(error) => Err(error.into()),
        }
    }

    /// Lets the next host open the port although the last one took it for
    /// itself: a real port forgets that when it is closed, but this one is
    /// never closed.
    pub fn clear_exclusive(&self) {
        // A port that cannot be freed is one that the next host reports.
        let _ = ioctl_tiocnxcl(&self.host_end);
    }
}

impl Drop for Pty {
    fn drop(&mut self) {
        if let Some(link) = &self.link
            && std::fs::read_link(link).is_ok_and(|target| target == self.device)
        {
            // Nobody is left to tell.
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
    Ok((
        master,
        host_end,
        PathBuf::from(OsStr::from_bytes(device.as_bytes())),
    ))
}

fn replace_link(link: &Path, device: &Path) -> Result<(), PtyError> {
    match std::fs::symlink_metadata(link) {
        Ok(metadata) if !metadata.is_symlink() => {
            return Err(PtyError::Occupied {
                link: link.to_owned(),
            });
        }
        _ => {}
    }
    let error = |source| PtyError::Link {
        link: link.to_owned(),
        source,
    };
    // Made beside and moved over, so that a host never finds it missing.
    let mut temporary = link.as_os_str().to_owned();
    temporary.push(format!(".{}", std::process::id()));
    let temporary = PathBuf::from(temporary);
    std::os::unix::fs::symlink(device, &temporary).map_err(error)?;
    std::fs::rename(&temporary, link).map_err(|source| {
        // The first error is the one to report.
        let _ = std::fs::remove_file(&temporary);
        error(source)
    })
}
