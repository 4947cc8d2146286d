//! A client of the daemon's control socket: one JSON object per line.

use std::{
    io::{BufRead, BufReader, Write},
    os::unix::net::UnixStream,
    path::Path,
    time::Duration,
};

use serde_json::{Value, json};
use singletrack_api::{Request, SOCKET_VERSION};

use crate::{Failure, Outcome};

/// A connection to the daemon's control socket.
#[derive(Debug)]
pub struct Client {
    read: BufReader<UnixStream>,
    write: UnixStream,
}

/// Timeout of an answer, which is no requirement: arming waits for two seconds at most, and simulates
/// the drive before, which on a slow machine takes seconds of processor time in this build.
const TIMEOUT: Duration = Duration::from_secs(20);

impl Client {
    /// Connects.
    ///
    /// # Errors
    ///
    /// Fails if the daemon does not listen.
    pub fn connect(path: &Path) -> Outcome<Self> {
        let connect = || -> std::io::Result<Self> {
            let write = UnixStream::connect(path)?;
            write.set_read_timeout(Some(TIMEOUT))?;
            let read = BufReader::new(write.try_clone()?);
            Ok(Self { read, write })
        };
        connect().map_err(Failure::system(format!(
            "can't connect to {}",
            path.display()
        )))
    }

    fn send(&mut self, request: &Request) -> Outcome {
        let line = request.to_line();
        self.send_lines(&line.map_err(|error| Failure::new(error.to_string()))?)
    }

    /// A request that a test has written: its command, and its keys.
    fn written(command: &str, keys: &Value) -> Outcome<Request> {
        let mut line = json!({ "version": SOCKET_VERSION, "command": command });
        if let (Some(line), Some(keys)) = (line.as_object_mut(), keys.as_object()) {
            line.extend(keys.clone());
        }
        Request::parse(line.to_string().as_bytes()).map_err(|error| Failure::new(error.to_string()))
    }

    /// Sends lines as they are, each with its end.
    ///
    /// # Errors
    ///
    /// Fails if they can't be sent.
    pub fn send_lines(&mut self, lines: &str) -> Outcome {
        let failed = |error| {
            let first = lines.lines().next().unwrap_or_default();
            Failure::system(format!("can't send {first}"))(error)
        };
        self.write.write_all(lines.as_bytes()).map_err(failed)
    }

    fn receive(&mut self) -> Outcome<Value> {
        let mut line = String::new();
        let count = self
            .read
            .read_line(&mut line)
            .map_err(Failure::system("no answer on the control socket"))?;
        if count == 0 {
            return Err(Failure::new("the daemon has closed the control socket"));
        }
        serde_json::from_str(&line)
            .map_err(|error| Failure::new(format!("not JSON: {error}: {line}")))
    }

    fn request(&mut self, request: &Request) -> Outcome<Answer> {
        self.send(request)?;
        let answer = self.receive()?;
        if answer["version"] == SOCKET_VERSION && answer["ok"].is_boolean() {
            Ok(Answer(answer))
        } else {
            Err(Failure::new(format!("not an answer: {answer}")))
        }
    }

    /// Requests the daemon's status.
    ///
    /// # Errors
    ///
    /// Fails without an answer.
    pub fn status(&mut self) -> Outcome<Status> {
        let Answer(mut answer) = self.request(&Request::Status {})?;
        match answer["status"].take() {
            status @ Value::Object(_) => Ok(Status(status)),
            _ => Err(Failure::new(format!("no status: {answer}"))),
        }
    }

    /// Requests arming; the answer comes when the car drives, or with the reason why
    /// not.
    ///
    /// # Errors
    ///
    /// Fails without an answer.
    pub fn arm(&mut self) -> Outcome<Answer> {
        self.arm_attended(&json!({ "attendance": "unattended" }))
    }

    /// Requests arming with other attendance; for `"hold"` the connection holds the drive.
    ///
    /// # Errors
    ///
    /// Fails without an answer.
    pub fn arm_attended(&mut self, attendance: &Value) -> Outcome<Answer> {
        self.request(&Self::written("arm", attendance)?)
    }

    /// Replaces the reference.
    ///
    /// # Errors
    ///
    /// Fails without an answer.
    pub fn set_reference(&mut self, reference: &Value) -> Outcome<Answer> {
        self.request(&Request::SetReference {
            reference: reference.clone(),
        })
    }

    /// Renews a drive that this connection holds; there is no answer.
    ///
    /// # Errors
    ///
    /// Fails if it can't be sent.
    pub fn hold(&mut self) -> Outcome {
        self.send(&Request::Hold {})
    }

    /// Gives a set-point with these keys; there is an answer only if it is rejected.
    ///
    /// # Errors
    ///
    /// Fails if it can't be sent.
    pub fn setpoint(&mut self, keys: &Value) -> Outcome {
        self.send(&Self::written("setpoint", keys)?)
    }

    /// The next line of the daemon, such as a report about a held drive.
    ///
    /// # Errors
    ///
    /// Fails without a line.
    pub fn line(&mut self) -> Outcome<Value> {
        self.receive()
    }

    /// Requests a controlled stop.
    ///
    /// # Errors
    ///
    /// Fails without an answer.
    pub fn disarm(&mut self) -> Outcome<Answer> {
        self.request(&Request::DISARM)
    }

    /// Requests an emergency stop.
    ///
    /// # Errors
    ///
    /// Fails without an answer.
    pub fn stop(&mut self) -> Outcome<Answer> {
        self.request(&Request::Stop {})
    }

    /// Has the daemon read its configuration again.
    ///
    /// # Errors
    ///
    /// Fails without an answer.
    pub fn reload(&mut self) -> Outcome<Answer> {
        self.request(&Request::Reload {})
    }

    /// Reports the state of a procedure, as its command does.
    ///
    /// # Errors
    ///
    /// Fails without an answer.
    pub fn report_procedure(&mut self, procedure: &str, result: &str) -> Outcome<Answer> {
        self.request(&Request::Commissioned {
            procedure: procedure.to_owned(),
            result: result.to_owned(),
            uncalibrated: false,
        })
    }

    /// Subscribes to the board's status, five times a second.
    ///
    /// # Errors
    ///
    /// Fails without an answer.
    pub fn watch_board(self) -> Outcome<Watch> {
        self.watch("status")
    }

    /// Subscribes to every tick.
    ///
    /// # Errors
    ///
    /// Fails without an answer.
    pub fn watch_ticks(self) -> Outcome<Watch> {
        self.watch("tick")
    }

    /// Subscribes to the board's telemetry.
    ///
    /// # Errors
    ///
    /// Fails without an answer.
    pub fn watch_telemetry(self) -> Outcome<Watch> {
        self.watch("telemetry")
    }

    /// Subscribes to the state of every tick: the lines follow.
    ///
    /// # Errors
    ///
    /// Fails without an answer.
    pub fn watch_states(&mut self) -> Outcome {
        let topics = vec!["state".to_owned()];
        self.request(&Request::Watch { topics })?.accepted()
    }

    fn watch(mut self, topic: &str) -> Outcome<Watch> {
        let topics = vec![topic.to_owned()];
        self.send(&Request::Watch { topics })?;
        Answer(self.receive()?).accepted()?;
        Ok(Watch(self))
    }
}

/// The daemon's answer to a command.
#[derive(Clone, Debug)]
pub struct Answer(Value);

impl Answer {
    /// Checks that the command was accepted.
    ///
    /// # Errors
    ///
    /// Fails with the daemon's reason.
    pub fn accepted(&self) -> Outcome {
        if self.0["ok"] == true {
            Ok(())
        } else {
            Err(Failure::new(format!("refused: {}", self.text())))
        }
    }

    /// Whether the command was refused.
    pub fn is_refused(&self) -> bool {
        self.0["ok"] == false
    }

    /// The complete answer.
    pub fn text(&self) -> String {
        self.0.to_string()
    }
}

/// The daemon's status.
#[derive(Clone, Debug)]
pub struct Status(Value);

impl Status {
    fn word(&self, pointer: &str) -> &str {
        self.0
            .pointer(pointer)
            .and_then(Value::as_str)
            .unwrap_or_default()
    }

    /// The pilot's mode; `disconnected` before the first tick.
    pub fn mode(&self) -> &str {
        let mode = self.0.pointer("/state/mode");
        mode.and_then(Value::as_str).unwrap_or("disconnected")
    }

    /// The reason for not driving, or for the last stop; empty if none.
    pub fn reason(&self) -> &str {
        self.word("/state/reason")
    }

    /// State of the link to the board.
    pub fn link(&self) -> &str {
        self.word("/state/link")
    }

    /// Whether the configuration is proved on this car; `None` before the board has given its
    /// number.
    pub fn proved(&self) -> Option<bool> {
        self.0["proved"].as_bool()
    }

    /// The board's last stop cause.
    pub fn stop_cause(&self) -> &str {
        self.word("/board/stop_cause")
    }

    /// A number of the status, by its JSON pointer.
    ///
    /// # Errors
    ///
    /// There is none.
    pub fn number(&self, pointer: &str) -> Outcome<f64> {
        self.0
            .pointer(pointer)
            .and_then(Value::as_f64)
            .ok_or_else(|| Failure::new(format!("no number {pointer} in {}", self.0)))
    }

    /// A figure by its JSON pointer.
    ///
    /// # Errors
    ///
    /// Fails if there is no such figure.
    pub fn figure(&self, pointer: &str) -> Outcome<f64> {
        self.0
            .pointer(&format!("/figures{pointer}"))
            .and_then(Value::as_f64)
            .ok_or_else(|| Failure::new(format!("no figure {pointer} in {}", self.0)))
    }

    /// Distance from the reference of P to its estimate, in m.
    ///
    /// # Errors
    ///
    /// Fails if the status lacks one of them.
    pub fn tracking_error_m(&self) -> Outcome<f64> {
        let place = |name: &str, axis: usize| self.0["state"][name][axis].as_f64();
        let along = |axis| Some(place("point_m", axis)? - place("reference_m", axis)?);
        along(0)
            .zip(along(1))
            .map(|(x, y)| x.hypot(y))
            .ok_or_else(|| Failure::new(format!("no point or no reference in {}", self.0)))
    }

    /// A summary for the report of a failure.
    pub fn text(&self) -> String {
        let short = json!({
            "mode": self.mode(), "reason": self.reason(), "link": self.link(),
            "board": self.0["board"], "frames": self.0["figures"]["frames"],
        });
        short.to_string()
    }
}

/// A subscription to the daemon's records.
#[derive(Debug)]
pub struct Watch(Client);

impl Watch {
    /// Waits for the next entry, and returns one of its figures.
    ///
    /// # Errors
    ///
    /// Fails if no entry comes, or it has no such figure.
    pub fn next(&mut self, figure: &str) -> Outcome<f64> {
        let entry = self.0.receive()?;
        find(&entry, figure).ok_or_else(|| Failure::new(format!("no {figure} in {entry}")))
    }

    /// Waits for the next entry, and returns those of the figures that it has.
    ///
    /// # Errors
    ///
    /// Fails if no entry comes.
    pub fn next_of<const N: usize>(&mut self, figures: [&str; N]) -> Outcome<[Option<f64>; N]> {
        let entry = self.0.receive()?;
        Ok(figures.map(|figure| find(&entry, figure)))
    }
}

/// Finds a value by name in nested entries; names are unique. True is 1, false 0.
fn find(value: &Value, name: &str) -> Option<f64> {
    let object = value.as_object()?;
    let figure = |value: &Value| {
        let truth = value.as_bool().map(|truth| f64::from(u8::from(truth)));
        value.as_f64().or(truth)
    };
    object
        .get(name)
        .and_then(figure)
        .or_else(|| object.values().find_map(|value| find(value, name)))
}
