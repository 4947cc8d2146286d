//! Where the control socket is, and whose it is.

use std::{
    fs, io,
    os::unix::{
        fs::{FileTypeExt, PermissionsExt},
        net::UnixListener,
    },
    path::{Path, PathBuf},
};

use socket2::{Domain, SockAddr, Socket, Type};

/// Owner and group may connect.
const PERMISSIONS: u32 = 0o660;

/// Why there is no control socket.
#[derive(Debug, thiserror::Error)]
pub enum SocketError {
    /// A daemon listens there.
    #[error("{}: another singletrackd listens there; stop it, or choose another socket.path", .0.display())]
    InUse(PathBuf),
    /// Something else is there.
    #[error("{}: there is something that is no socket; remove it, or choose another socket.path", .0.display())]
    Occupied(PathBuf),
    /// Its folder can't be made.
    #[error(
        "can't make {}, the folder of socket.path: {source}; choose a socket.path in a folder that you \
         may write to, such as one in $XDG_RUNTIME_DIR, or set socket.enabled = false",
        path.display()
    )]
    Folder {
        /// The folder.
        path: PathBuf,
        /// What the system says.
        source: io::Error,
    },
    /// The system says no.
    #[error(
        "{}: can't {action}: {source}; choose a socket.path in a folder that you may write to, such as \
         one in $XDG_RUNTIME_DIR, or set socket.enabled = false",
        path.display()
    )]
    Io {
        /// What was attempted.
        action: &'static str,
        /// The path.
        path: PathBuf,
        /// What the system says.
        source: io::Error,
    },
}

/// A listening socket, which removes its file.
#[derive(Debug)]
pub(crate) struct BoundSocket {
    pub(super) listener: UnixListener,
    pub(super) file: SocketFile,
}

/// Removed when it is dropped.
#[derive(Debug)]
pub(super) struct SocketFile(PathBuf);

impl Drop for SocketFile {
    fn drop(&mut self) {
        // If someone else has removed it, so much the better.
        let _ = fs::remove_file(&self.0);
    }
}

impl BoundSocket {
    /// Listens at `path`, whose folder is made if it is missing; a socket that
    /// a killed daemon left is replaced.
    pub(crate) fn bind(path: &Path) -> Result<Self, SocketError> {
        let failure = |action| {
            move |source| SocketError::Io {
                action,
                path: path.to_owned(),
                source,
            }
        };
        if let Some(folder) = path.parent() {
            fs::create_dir_all(folder).map_err(|source| SocketError::Folder {
                path: folder.to_owned(),
                source,
            })?;
        }
        match fs::symlink_metadata(path) {
            Ok(metadata) => {
                if !metadata.file_type().is_socket() {
                    return Err(SocketError::Occupied(path.to_owned()));
                }
                if has_listener(path).map_err(failure("look who listens"))? {
                    return Err(SocketError::InUse(path.to_owned()));
                }
                fs::remove_file(path).map_err(failure("remove the old socket"))?;
            }
            Err(error) if error.kind() == io::ErrorKind::NotFound => {}
            Err(error) => return Err(failure("look at it")(error)),
        }
        let listener = UnixListener::bind(path).map_err(failure("listen"))?;
        let file = SocketFile(path.to_owned());
        fs::set_permissions(path, fs::Permissions::from_mode(PERMISSIONS))
            .map_err(failure("set its permissions"))?;
        listener
            .set_nonblocking(true)
            .map_err(failure("make it non-blocking"))?;
        Ok(Self { listener, file })
    }
}

/// Whether a process listens there, even one that has been stopped and accepts
/// nobody: a connection that waits for its turn would wait for good.
fn has_listener(path: &Path) -> io::Result<bool> {
    let socket = Socket::new(Domain::UNIX, Type::STREAM, None)?;
    socket.set_nonblocking(true)?;
    match socket.connect(&SockAddr::unix(path)?) {
        Ok(()) => Ok(true),
        Err(error) => match error.kind() {
            io::ErrorKind::ConnectionRefused | io::ErrorKind::NotFound => Ok(false),
            // Its queue is full.
            io::ErrorKind::WouldBlock => Ok(true),
            _ => Err(error),
        },
    }
}

#[cfg(test)]
mod tests {
    use std::os::unix::net::UnixStream;

    use super::*;

    #[test]
    fn a_missing_folder_is_made_and_one_that_can_not_be_is_named() {
        let folder = tempfile::tempdir().unwrap();
        let socket = BoundSocket::bind(&folder.path().join("a/b/control.sock")).unwrap();
        drop(socket);
        let file = folder.path().join("file");
        fs::write(&file, "").unwrap();
        let error = BoundSocket::bind(&file.join("sub/control.sock"))
            .unwrap_err()
            .to_string();
        assert!(
            error.contains("file/sub, the folder of socket.path")
                && error.contains("XDG_RUNTIME_DIR"),
            "{error}"
        );
    }

    #[test]
    fn a_dead_daemons_socket_is_replaced_and_a_living_ones_is_not() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("control.sock");
        drop(UnixListener::bind(&path).unwrap());
        assert!(path.exists());
        let socket = BoundSocket::bind(&path).unwrap();
        let mode = fs::metadata(&path).unwrap().permissions().mode();
        assert_eq!(mode & 0o777, PERMISSIONS);
        assert!(matches!(
            BoundSocket::bind(&path),
            Err(SocketError::InUse(_))
        ));
        drop(socket);
        assert!(!path.exists());
        fs::write(&path, "precious").unwrap();
        assert!(matches!(
            BoundSocket::bind(&path),
            Err(SocketError::Occupied(_))
        ));
        assert_eq!(fs::read_to_string(&path).unwrap(), "precious");
    }

    #[test]
    fn a_daemon_that_has_been_stopped_and_accepts_nobody_is_found_at_once() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("control.sock");
        let stopped = Socket::new(Domain::UNIX, Type::STREAM, None).unwrap();
        stopped.bind(&SockAddr::unix(&path).unwrap()).unwrap();
        stopped.listen(0).unwrap();
        // Its queue takes one.
        let _waiting = UnixStream::connect(&path).unwrap();
        assert!(matches!(
            BoundSocket::bind(&path),
            Err(SocketError::InUse(_))
        ));
    }
}
