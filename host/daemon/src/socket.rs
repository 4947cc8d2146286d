//! The control socket: one JSON object a line, each way. Version 1.
//!
//! | to the daemon | from the daemon |
//! |---|---|
//! | `{"version":1,"command":"status"}` | `{"version":1,"ok":true,"status":{...}}` |
//! | `{"version":1,"command":"arm"}` | once it drives, or what is in the way |
//! | `{"version":1,"command":"disarm"}` | at once; the car slows down and stops |
//! | `{"version":1,"command":"stop"}` | at once; neutral until the board is reset |
//! | `{"version":1,"command":"watch","topics":["tick"]}` | `{"version":1,"ok":true}`, then every entry of the record as it is made, with a `topic` |
//!
//! What fails is answered with `{"version":1,"ok":false,"error":"..."}`. A
//! watcher that is too slow gets `{"version":1,"missed":N}`.

use core::fmt;
use std::{
    fs, io,
    os::unix::{
        fs::PermissionsExt,
        net::{UnixListener as StdListener, UnixStream as StdStream},
    },
    path::{Path, PathBuf},
    str::FromStr,
    sync::Arc,
    thread::{self, JoinHandle},
    time::Duration,
};

use serde::Deserialize;
use serde_json::{Value, json};
use singletrack_control::{Mode, Reason, Request};
use singletrack_record::Topic;
use tokio::{
    io::{AsyncBufReadExt, AsyncReadExt, AsyncWriteExt, BufReader},
    net::{UnixListener, UnixStream, unix::OwnedWriteHalf},
    runtime,
    sync::{Notify, Semaphore, broadcast::error::RecvError},
};

use crate::{clock::monotonic_ns, control_loop::ControlRequest, daemon::View};

/// The version of the protocol. Exact match.
pub const SOCKET_VERSION: u32 = 1;

/// The longest line that is read.
const LONGEST_LINE: u64 = 4_096;

/// The most clients at a time.
const CLIENTS: usize = 32;

/// How long a client that finds no place may take to say what it wants.
const REFUSAL_PATIENCE: Duration = Duration::from_secs(1);

/// How long an arm command waits for the car to drive.
const ARM_PATIENCE: Duration = Duration::from_secs(2);

/// How often it looks.
const ARM_LOOK: Duration = Duration::from_millis(5);

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
    listener: StdListener,
    file: SocketFile,
}

#[derive(Debug)]
struct SocketFile(PathBuf);

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
                use std::os::unix::fs::FileTypeExt;
                if !metadata.file_type().is_socket() {
                    return Err(SocketError::Occupied(path.to_owned()));
                }
                if StdStream::connect(path).is_ok() {
                    return Err(SocketError::InUse(path.to_owned()));
                }
                fs::remove_file(path).map_err(failure("remove the old socket"))?;
            }
            Err(error) if error.kind() == io::ErrorKind::NotFound => {}
            Err(error) => return Err(failure("look at it")(error)),
        }
        let listener = StdListener::bind(path).map_err(failure("listen"))?;
        let file = SocketFile(path.to_owned());
        fs::set_permissions(path, fs::Permissions::from_mode(PERMISSIONS))
            .map_err(failure("set its permissions"))?;
        listener
            .set_nonblocking(true)
            .map_err(failure("make it non-blocking"))?;
        Ok(Self { listener, file })
    }
}

/// The server's thread.
#[derive(Debug)]
pub(crate) struct SocketThread {
    stop: Arc<Notify>,
    thread: JoinHandle<()>,
}

impl SocketThread {
    pub(crate) fn start(socket: BoundSocket, view: View) -> io::Result<Self> {
        let stop = Arc::new(Notify::new());
        let stopped = Arc::clone(&stop);
        let runtime = runtime::Builder::new_current_thread()
            .enable_io()
            .enable_time()
            .build()?;
        let thread = thread::Builder::new()
            .name("socket".to_owned())
            .spawn(move || {
                let BoundSocket { listener, file } = socket;
                runtime.block_on(async {
                    match UnixListener::from_std(listener) {
                        Ok(listener) => {
                            tokio::spawn(accept(listener, view));
                            stopped.notified().await;
                        }
                        Err(error) => tracing::error!(%error, "no control socket"),
                    }
                });
                // The clients go before the file does.
                runtime.shutdown_background();
                drop(file);
            })?;
        Ok(Self { stop, thread })
    }

    pub(crate) fn stop(self) {
        self.stop.notify_one();
        if self.thread.join().is_err() {
            tracing::error!("the control socket's thread has panicked");
        }
    }
}

async fn accept(listener: UnixListener, view: View) {
    let places = Arc::new(Semaphore::new(CLIENTS));
    loop {
        match listener.accept().await {
            Ok((stream, _)) => {
                let view = view.clone();
                let place = Arc::clone(&places).try_acquire_owned();
                tokio::spawn(async move {
                    let result = match place {
                        Ok(_place) => serve(stream, &view).await,
                        Err(_) => refuse(stream, &view).await,
                    };
                    // A client may go as it likes.
                    if let Err(error) = result {
                        tracing::debug!(%error, "control client gone");
                    }
                });
            }
            Err(error) => {
                // Such as too many open files: others may close theirs.
                tracing::warn!(%error, "control client not accepted");
                tokio::time::sleep(Duration::from_millis(100)).await;
            }
        }
    }
}

/// However many are connected, a stop is heard.
async fn refuse(stream: UnixStream, view: &View) -> io::Result<()> {
    let (read, mut write) = stream.into_split();
    let mut line = Vec::new();
    let mut read = BufReader::new(read).take(LONGEST_LINE);
    let heard = tokio::time::timeout(REFUSAL_PATIENCE, read.read_until(b'\n', &mut line)).await;
    let answer = match (heard, Command::parse(&line)) {
        (Ok(Ok(_)), Ok(Command::Ask(question @ (Question::Stop | Question::Disarm)))) => {
            answer(question, view).await
        }
        _ => failure(format!("{CLIENTS} clients are connected; close one")),
    };
    send(&mut write, &answer).await
}

async fn serve(stream: UnixStream, view: &View) -> io::Result<()> {
    let (read, mut write) = stream.into_split();
    let mut read = BufReader::new(read);
    let mut line = Vec::new();
    loop {
        line.clear();
        let count = (&mut read)
            .take(LONGEST_LINE)
            .read_until(b'\n', &mut line)
            .await?;
        if count == 0 {
            return Ok(());
        }
        if !line.ends_with(b"\n") && count as u64 == LONGEST_LINE {
            let answer = failure(format!("a line is at most {LONGEST_LINE} bytes long"));
            return send(&mut write, &answer).await;
        }
        match Command::parse(&line) {
            Ok(Command::Watch { topics }) => {
                let mut rest = [0];
                // A watcher says nothing more; it may be gone long before there
                // is something to tell it.
                return tokio::select! {
                    watched = watch(&mut write, view, &topics) => watched,
                    gone = read.read(&mut rest) => gone.map(drop),
                };
            }
            Ok(Command::Ask(question)) => {
                send(&mut write, &answer(question, view).await).await?;
            }
            Err(error) => send(&mut write, &failure(error)).await?,
        }
    }
}

async fn send(write: &mut OwnedWriteHalf, answer: &Value) -> io::Result<()> {
    write.write_all(format!("{answer}\n").as_bytes()).await
}

fn failure(error: impl fmt::Display) -> Value {
    json!({ "version": SOCKET_VERSION, "ok": false, "error": error.to_string() })
}

/// What a client may send.
#[derive(Clone, Debug, PartialEq, Eq)]
enum Command {
    /// One line answers it.
    Ask(Question),
    /// A stream answers it. No topics: all.
    Watch { topics: Vec<Topic> },
}

/// What is answered in one line.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Question {
    Status,
    Arm,
    Disarm,
    Stop,
}

/// A line as it comes.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Line {
    version: u32,
    command: String,
    #[serde(default)]
    topics: Option<Vec<String>>,
}

impl Command {
    fn parse(line: &[u8]) -> Result<Self, String> {
        let line: Line = serde_json::from_slice(line).map_err(|error| {
            format!("{error}; write {{\"version\":{SOCKET_VERSION},\"command\":\"status\"}}")
        })?;
        if line.version != SOCKET_VERSION {
            return Err(format!(
                "version is {}: this daemon speaks version {SOCKET_VERSION}; use the singletrack of its release",
                line.version
            ));
        }
        if line.topics.is_some() && line.command != "watch" {
            return Err(format!("{} takes no topics; only watch does", line.command));
        }
        match line.command.as_str() {
            "status" => Ok(Self::Ask(Question::Status)),
            "arm" => Ok(Self::Ask(Question::Arm)),
            "disarm" => Ok(Self::Ask(Question::Disarm)),
            "stop" => Ok(Self::Ask(Question::Stop)),
            "watch" => Ok(Self::Watch {
                topics: line
                    .topics
                    .unwrap_or_default()
                    .iter()
                    .map(|topic| Topic::from_str(topic).map_err(|error| error.to_string()))
                    .collect::<Result<_, _>>()?,
            }),
            other => Err(format!(
                "command is {other:?}: use status, arm, disarm, stop or watch"
            )),
        }
    }
}

async fn answer(question: Question, view: &View) -> Value {
    let asked = |request| {
        let pushed = view.requests.push(ControlRequest::Pilot(request));
        pushed.map_err(|error| error.to_string())
    };
    let done = match question {
        Question::Status => {
            return json!({
                "version": SOCKET_VERSION,
                "ok": true,
                "status": view.snapshot().to_json(),
            });
        }
        Question::Arm => arm(view).await,
        Question::Disarm => asked(Request::Disarm),
        Question::Stop => asked(Request::EmergencyStop),
    };
    match done {
        // No mode: a disarm or a stop shows in it only after the next tick.
        Ok(()) => json!({ "version": SOCKET_VERSION, "ok": true }),
        Err(error) => failure(error),
    }
}

/// Asks for a drive and waits for it.
async fn arm(view: &View) -> Result<(), String> {
    let before = view.snapshot();
    if before.mode() != Mode::Ready {
        return Err(cannot_arm(before.mode(), before.reason()));
    }
    view.requests
        .push(ControlRequest::Pilot(Request::Arm))
        .map_err(|error| error.to_string())?;
    let asked_ns = monotonic_ns();
    let looks = ARM_PATIENCE.as_millis() / ARM_LOOK.as_millis();
    for _ in 0..looks {
        tokio::time::sleep(ARM_LOOK).await;
        if let Some(outcome) = view
            .snapshot()
            .tick
            .and_then(|tick| arm_outcome(asked_ns, tick.start_ns, tick.mode, tick.reason))
        {
            return outcome;
        }
    }
    Err("can't arm: the control thread does not answer".to_owned())
}

/// What a tick says about a request to arm; none while that is open.
fn arm_outcome(
    asked_ns: u64,
    tick_start_ns: u64,
    mode: Mode,
    reason: Option<Reason>,
) -> Option<Result<(), String>> {
    // A tick that began before may not have seen the request.
    if tick_start_ns <= asked_ns {
        return None;
    }
    match mode {
        Mode::Driving => Some(Ok(())),
        Mode::Arming => None,
        // The attempt has ended, even if nobody was looking while it was made.
        mode => Some(Err(cannot_arm(mode, reason))),
    }
}

fn cannot_arm(mode: Mode, reason: Option<Reason>) -> String {
    match reason {
        Some(reason) => format!("can't arm: mode {mode}: {reason}"),
        None => format!("can't arm: mode {mode}"),
    }
}

async fn watch(write: &mut OwnedWriteHalf, view: &View, topics: &[Topic]) -> io::Result<()> {
    let mut entries = view.board.watchers.subscribe();
    send(write, &json!({ "version": SOCKET_VERSION, "ok": true })).await?;
    loop {
        match entries.recv().await {
            Ok((topic, line)) => {
                if topics.is_empty() || topics.contains(&topic) {
                    write.write_all(line.as_bytes()).await?;
                    write.write_all(b"\n").await?;
                }
            }
            Err(RecvError::Lagged(missed)) => {
                send(
                    write,
                    &json!({ "version": SOCKET_VERSION, "missed": missed }),
                )
                .await?;
            }
            Err(RecvError::Closed) => return Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_that_are_no_commands_are_told_what_would_be() {
        for (line, part) in [
            ("", "write {"),
            ("status", "write {"),
            ("{\"version\":1}", "command"),
            ("{\"command\":\"status\"}", "version"),
            ("{\"version\":2,\"command\":\"status\"}", "version is 2"),
            ("{\"version\":1,\"command\":\"fly\"}", "use status, arm"),
            ("{\"version\":1,\"command\":\"arm\",\"now\":true}", "now"),
            (
                "{\"version\":1,\"command\":\"arm\",\"topics\":[\"tick\"]}",
                "takes no topics",
            ),
            (
                "{\"version\":1,\"command\":\"watch\",\"topics\":[\"ticks\"]}",
                "ticks",
            ),
        ] {
            let error = Command::parse(line.as_bytes()).unwrap_err();
            assert!(error.contains(part), "{line}: {error}");
        }
    }

    #[test]
    fn commands_are_read() {
        for (line, command) in [
            (
                "{\"version\":1,\"command\":\"status\"}",
                Command::Ask(Question::Status),
            ),
            (
                "{\"command\":\"stop\",\"version\":1}\r\n",
                Command::Ask(Question::Stop),
            ),
            (
                "{\"version\":1,\"command\":\"watch\",\"topics\":[\"tick\",\"log\"]}",
                Command::Watch {
                    topics: vec![Topic::Tick, Topic::Log],
                },
            ),
        ] {
            assert_eq!(Command::parse(line.as_bytes()), Ok(command));
        }
    }

    #[test]
    fn an_arm_is_answered_by_the_first_tick_after_it_that_is_not_arming() {
        let outcome = |start_ns, mode, reason| arm_outcome(100, start_ns, mode, reason);
        assert_eq!(outcome(100, Mode::Ready, None), None);
        assert_eq!(outcome(101, Mode::Arming, None), None);
        assert_eq!(outcome(101, Mode::Driving, None), Some(Ok(())));
        for (mode, reason, words) in [
            (Mode::Ready, Reason::BoardRefused, "ready: board-refused"),
            (Mode::Idle, Reason::ImuSilent, "idle: imu-silent"),
            (Mode::Disconnected, Reason::LinkDown, "link-down"),
        ] {
            let error = outcome(101, mode, Some(reason)).unwrap().unwrap_err();
            assert!(error.contains(words), "{error}");
        }
    }

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
        drop(StdListener::bind(&path).unwrap());
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
}
