//! Creates the file of the control socket and listens on it.

use std::{
    fs, io,
    os::unix::{
        fs::{FileTypeExt, PermissionsExt},
        net::UnixListener,
    },
    path::{Path, PathBuf},
};

use singletrack_core::config::SocketSection;
use socket2::{Domain, SockAddr, Socket, Type};

use super::tcp::BoundPort;

/// Owner and group may connect.
const PERMISSIONS: u32 = 0o660;

/// What to do about a path that can't be used.
const FIX: &str = "choose a socket.path in a folder that you may write to, such as one in \
                   $XDG_RUNTIME_DIR, or set socket.enabled = false";

/// A listening socket and its file, and the port on which it listens too, if any.
#[derive(Debug)]
pub(crate) struct BoundSocket {
    pub(super) listener: UnixListener,
    pub(super) file: SocketFile,
    pub(super) port: Option<BoundPort>,
}

/// The file of the socket, removed when this value is dropped.
#[derive(Debug)]
pub(super) struct SocketFile(PathBuf);

impl Drop for SocketFile {
    fn drop(&mut self) {
        // An error means that the file is gone already.
        let _ = fs::remove_file(&self.0);
    }
}

impl BoundSocket {
    /// Listens on the socket of the configuration, and on its port if there is one.
    pub(crate) fn open(config: &SocketSection) -> Result<Self, String> {
        // The socket first: its path belongs to one daemon, and so does the file of the token.
        let mut socket = Self::bind(&config.path)?;
        if let Some(port) = config.tcp_port {
            let bound = BoundPort::bind(port, &config.path).map_err(|error| {
                format!(
                    "socket.tcp_port is {port}: {error}; choose another port, or remove \
                     socket.tcp_port"
                )
            });
            socket.port = Some(bound?);
        }
        Ok(socket)
    }

    /// Listens on `path`. Creates its folder if necessary, and replaces the socket that a
    /// killed daemon left.
    fn bind(path: &Path) -> Result<Self, String> {
        let name = &path.display();
        let failure = |action: &'static str| {
            move |error: io::Error| format!("{name}: can't {action}: {error}; {FIX}")
        };
        if let Some(folder) = path.parent() {
            fs::create_dir_all(folder).map_err(|error| {
                let folder = folder.display();
                format!("can't create {folder}, the folder of socket.path: {error}; {FIX}")
            })?;
        }
        match fs::symlink_metadata(path) {
            Ok(metadata) => {
                if !metadata.file_type().is_socket() {
                    return Err(format!(
                        "{name}: this file is not a socket; remove it, or choose another socket.path"
                    ));
                }
                if has_listener(path).map_err(failure("check who listens"))? {
                    return Err(format!(
                        "{name}: another singletrackd listens there; stop it, or choose another \
                         socket.path"
                    ));
                }
                fs::remove_file(path).map_err(failure("remove the old socket"))?;
            }
            Err(error) if error.kind() == io::ErrorKind::NotFound => {}
            Err(error) => return Err(failure("read its metadata")(error)),
        }
        let listener = UnixListener::bind(path).map_err(failure("listen"))?;
        let file = SocketFile(path.to_owned());
        fs::set_permissions(path, fs::Permissions::from_mode(PERMISSIONS))
            .map_err(failure("set its permissions"))?;
        listener
            .set_nonblocking(true)
            .map_err(failure("make it non-blocking"))?;
        Ok(Self {
            listener,
            file,
            port: None,
        })
    }
}

/// Whether a process listens on the path. The connection is non-blocking: a stopped process
/// accepts no client, and a client in its queue would wait for ever.
fn has_listener(path: &Path) -> io::Result<bool> {
    let socket = Socket::new(Domain::UNIX, Type::STREAM, None)?;
    socket.set_nonblocking(true)?;
    match socket.connect(&SockAddr::unix(path)?) {
        Ok(()) => Ok(true),
        Err(error) => match error.kind() {
            io::ErrorKind::ConnectionRefused | io::ErrorKind::NotFound => Ok(false),
            // The queue of the listener is full.
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
    fn a_missing_folder_is_created_or_named_in_the_error() {
        let folder = tempfile::tempdir().unwrap();
        let socket = BoundSocket::bind(&folder.path().join("a/b/control.sock")).unwrap();
        drop(socket);
        let file = folder.path().join("file");
        fs::write(&file, "").unwrap();
        let error = BoundSocket::bind(&file.join("sub/control.sock")).unwrap_err();
        assert!(
            error.contains("file/sub, the folder of socket.path")
                && error.contains("XDG_RUNTIME_DIR"),
            "{error}"
        );
    }

    #[test]
    fn the_socket_of_a_dead_daemon_is_replaced_and_that_of_a_live_one_is_not() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("control.sock");
        drop(UnixListener::bind(&path).unwrap());
        assert!(path.exists());
        let socket = BoundSocket::bind(&path).unwrap();
        let mode = fs::metadata(&path).unwrap().permissions().mode();
        assert_eq!(mode & 0o777, PERMISSIONS);
        let error = BoundSocket::bind(&path).unwrap_err();
        assert!(error.contains("another singletrackd listens"), "{error}");
        drop(socket);
        assert!(!path.exists());
        fs::write(&path, "precious").unwrap();
        let error = BoundSocket::bind(&path).unwrap_err();
        assert!(error.contains("not a socket"), "{error}");
        assert_eq!(fs::read_to_string(&path).unwrap(), "precious");
    }

    #[test]
    fn a_stopped_daemon_that_accepts_no_client_is_detected_at_once() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("control.sock");
        let stopped = Socket::new(Domain::UNIX, Type::STREAM, None).unwrap();
        stopped.bind(&SockAddr::unix(&path).unwrap()).unwrap();
        stopped.listen(0).unwrap();
        // The queue holds one client.
        let _waiting = UnixStream::connect(&path).unwrap();
        let error = BoundSocket::bind(&path).unwrap_err();
        assert!(error.contains("another singletrackd listens"), "{error}");
    }
}
