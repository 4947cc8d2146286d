//! Creates the file of the control socket and listens on it and on TCP; and the gate of the TCP port, which
//! lets connections through that begin with the token.

use std::{
    fs, io,
    net::{Ipv4Addr, SocketAddr, TcpListener},
    os::unix::{
        fs::{FileTypeExt, PermissionsExt},
        net::UnixListener,
    },
    path::{Path, PathBuf},
    sync::Arc,
    time::Duration,
};

use serde::Deserialize;
use singletrack_api::access::{Token, TokenFile, WaitingRoom, linger};
use singletrack_api::{Answer, Code, SOCKET_VERSION};
use singletrack_core::config::SocketSection;
use socket2::{Domain, SockAddr, Socket, Type};
use tokio::{
    io::{AsyncBufReadExt, AsyncReadExt, AsyncWriteExt},
    time::{sleep, timeout},
};

use super::stream::{Connection, send};

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

/// The first line of a client.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct FirstLine {
    version: u32,
    command: String,
    token: String,
}

/// Whether a line gives this token.
fn is_given_by(token: &Token, line: &[u8]) -> bool {
    serde_json::from_slice::<FirstLine>(line).is_ok_and(|line| {
        line.version == SOCKET_VERSION && line.command == "token" && token.is(&line.token)
    })
}

/// The place of the token of the daemon that listens on `socket`.
fn token_path(socket: &Path) -> PathBuf {
    let mut path = socket.as_os_str().to_owned();
    path.push(".token");
    path.into()
}

/// The largest number of connections at a time that have not given the token. They take no place
/// of a client who may connect, and a newer one takes the place of the oldest.
const STRANGERS: usize = 16;

/// The longest wait for the first line, and its longest length in bytes.
const FIRST_LINE_TIMEOUT: Duration = Duration::from_secs(2);
const LONGEST_FIRST_LINE: u64 = 256;

/// From a wrong token to its answer.
const REFUSAL_DELAY: Duration = Duration::from_millis(500);

/// A listening port, its token, and the file of the token.
#[derive(Debug)]
pub(super) struct BoundPort {
    pub(super) listener: TcpListener,
    pub(super) gate: Arc<Gate>,
    pub(super) file: TokenFile,
}

/// Lets those through who know the token.
#[derive(Debug)]
pub(super) struct Gate {
    token: Token,
    token_path: PathBuf,
    strangers: WaitingRoom,
}

impl BoundPort {
    /// Listens on `port` of 127.0.0.1, and writes the token beside the Unix socket `beside`.
    fn bind(port: u16, beside: &Path) -> Result<Self, String> {
        let during =
            |action: &'static str| move |error: io::Error| format!("can't {action}: {error}");
        let listener =
            TcpListener::bind((Ipv4Addr::LOCALHOST, port)).map_err(during("listen on its port"))?;
        listener
            .set_nonblocking(true)
            .map_err(during("make it non-blocking"))?;
        let address = listener.local_addr().map_err(during("read its port"))?;
        let token = Token::random().map_err(during("make a token"))?;
        let token_path = token_path(beside);
        let file = TokenFile::create(token_path.clone(), address, &token)
            .map_err(during("write the file of the token"))?;
        tracing::info!(%address, token = %token_path.display(), "control socket on TCP");
        Ok(Self {
            listener,
            gate: Arc::new(Gate::new(token, token_path)),
            file,
        })
    }
}

impl Gate {
    fn new(token: Token, token_path: PathBuf) -> Self {
        Self {
            token,
            token_path,
            strangers: WaitingRoom::new(STRANGERS),
        }
    }

    /// Whether a client has given the token. The connection of any other one is to be closed.
    pub(super) async fn passes(
        &self,
        connection: &mut Connection,
        peer: SocketAddr,
    ) -> io::Result<bool> {
        let mut place = self.strangers.enter();
        let Connection { read, write } = connection;
        let mut line = Vec::new();
        let mut first = (&mut *read).take(LONGEST_FIRST_LINE);
        let first_line = timeout(FIRST_LINE_TIMEOUT, first.read_until(b'\n', &mut line));
        let Some(first_line) = place.until_lost(first_line).await else {
            return Ok(false);
        };
        let count = first_line.unwrap_or(Ok(0))?;
        if count > 0 && is_given_by(&self.token, &line) {
            send(write, &Answer::done()).await?;
            return Ok(true);
        }
        tracing::warn!(%peer, "a connection to the control socket on TCP without the token");
        if place.until_lost(sleep(REFUSAL_DELAY)).await.is_none() {
            return Ok(false);
        }
        let error = format!(
            "the first line must be {{\"version\":{SOCKET_VERSION},\"command\":\"token\",\
             \"token\":\"...\"}}, with the token from {}",
            self.token_path.display()
        );
        send(write, &Answer::failure(Code::Token, error)).await?;
        write.shutdown().await?;
        place.until_lost(linger(read)).await;
        Ok(false)
    }
}

#[cfg(test)]
mod tests {
    use std::os::unix::net::UnixStream;

    use serde_json::Value;

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

    #[test]
    fn only_the_whole_token_in_its_own_command_is_right() {
        let folder = tempfile::tempdir().unwrap();
        let path = token_path(&folder.path().join("control.sock"));
        let address = SocketAddr::from(([127, 0, 0, 1], 8_766));
        let token = Token::random().unwrap();
        let _file = TokenFile::create(path.clone(), address, &token).unwrap();
        let content: Value = serde_json::from_slice(&fs::read(&path).unwrap()).unwrap();
        let right = content["token"].as_str().unwrap();
        let given = |line: &str| is_given_by(&token, line.replace("RIGHT", right).as_bytes());
        assert!(given(r#"{"version":3,"command":"token","token":"RIGHT"}"#));
        for line in [
            "",
            "RIGHT",
            r#"{"version":3,"command":"token"}"#,
            r#"{"version":3,"command":"token","token":""}"#,
            r#"{"version":3,"command":"token","token":"RIGHTf"}"#,
            r#"{"version":3,"command":"token","token":" RIGHT"}"#,
            r#"{"version":3,"command":"token","token":null}"#,
            r#"{"version":1,"command":"token","token":"RIGHT"}"#,
            r#"{"version":3,"command":"stop","token":"RIGHT"}"#,
            r#"{"version":3,"command":"token","token":"","token":"RIGHT"}"#,
            r#"POST / {"version":3,"command":"token","token":"RIGHT"}"#,
        ] {
            assert!(!given(line), "{line}");
        }
        let cut = r#"{"version":3,"command":"token","token":"CUT"}"#.replace("CUT", &right[1..]);
        assert!(!given(&cut));
        let upper = right.to_ascii_uppercase();
        let upper = format!(r#"{{"version":3,"command":"token","token":"{upper}"}}"#);
        assert!(!given(&upper));
    }
}
