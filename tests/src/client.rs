//! The daemon's control socket, as any client sees it: a JSON object a line.

use std::{
    io::{BufRead, BufReader, Write},
    net::SocketAddr,
    os::unix::net::UnixStream,
    path::Path,
    time::Duration,
};

use serde_json::{Value, json};

use crate::{Failure, Outcome};

/// A connection to the daemon's control socket.
#[derive(Debug)]
pub struct Client {
    read: BufReader<UnixStream>,
    write: UnixStream,
}

/// An answer may wait for the car to be armed, which takes two seconds at most.
const PATIENCE: Duration = Duration::from_secs(4);

/// The version of the socket's protocol.
const VERSION: u32 = 1;

impl Client {
    /// Connects.
    ///
    /// # Errors
    ///
    /// Nobody listens.
    pub fn connect(path: &Path) -> Outcome<Self> {
        let connect = || -> std::io::Result<Self> {
            let write = UnixStream::connect(path)?;
            write.set_read_timeout(Some(PATIENCE))?;
            let read = BufReader::new(write.try_clone()?);
            Ok(Self { read, write })
        };
        connect().map_err(Failure::system(format!(
            "cannot connect to {}",
            path.display()
        )))
    }

    fn send(&mut self, request: &Value) -> Outcome {
        self.write
            .write_all(format!("{request}\n").as_bytes())
            .map_err(Failure::system(format!("cannot send {request}")))
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

    fn ask(&mut self, command: &str) -> Outcome<Answer> {
        self.send(&json!({ "version": VERSION, "command": command }))?;
        let answer = self.receive()?;
        if answer["version"] == VERSION && answer["ok"].is_boolean() {
            Ok(Answer(answer))
        } else {
            Err(Failure::new(format!("not an answer: {answer}")))
        }
    }

    /// How the daemon is.
    ///
    /// # Errors
    ///
    /// No answer.
    pub fn status(&mut self) -> Outcome<Status> {
        let Answer(mut answer) = self.ask("status")?;
        match answer["status"].take() {
            status @ Value::Object(_) => Ok(Status(status)),
            _ => Err(Failure::new(format!("no status: {answer}"))),
        }
    }

    /// Asks for a drive; the answer comes when it drives, or says why not.
    ///
    /// # Errors
    ///
    /// No answer.
    pub fn arm(&mut self) -> Outcome<Answer> {
        self.ask("arm")
    }

    /// Asks for a stop along a ramp.
    ///
    /// # Errors
    ///
    /// No answer.
    pub fn disarm(&mut self) -> Outcome<Answer> {
        self.ask("disarm")
    }

    /// Asks for an emergency stop.
    ///
    /// # Errors
    ///
    /// No answer.
    pub fn stop(&mut self) -> Outcome<Answer> {
        self.ask("stop")
    }

    /// Watches what the board says of itself, five times a second.
    ///
    /// # Errors
    ///
    /// No answer.
    pub fn watch_board(self) -> Outcome<Watch> {
        self.watch("status")
    }

    /// Watches every tick.
    ///
    /// # Errors
    ///
    /// No answer.
    pub fn watch_ticks(self) -> Outcome<Watch> {
        self.watch("tick")
    }

    fn watch(mut self, topic: &str) -> Outcome<Watch> {
        self.send(&json!({ "version": VERSION, "command": "watch", "topics": [topic] }))?;
        Answer(self.receive()?).accepted()?;
        Ok(Watch(self))
    }
}

/// What the daemon answers to a command.
#[derive(Clone, Debug)]
pub struct Answer(Value);

impl Answer {
    /// The command must have been accepted.
    ///
    /// # Errors
    ///
    /// The daemon's reason.
    pub fn accepted(&self) -> Outcome {
        if self.0["ok"] == true {
            Ok(())
        } else {
            Err(Failure::new(format!("refused: {}", self.text())))
        }
    }

    /// Whether the daemon has refused.
    #[must_use]
    pub fn is_refused(&self) -> bool {
        self.0["ok"] == false
    }

    /// The whole answer.
    #[must_use]
    pub fn text(&self) -> String {
        self.0.to_string()
    }
}

/// How the daemon is.
#[derive(Clone, Debug)]
pub struct Status(Value);

impl Status {
    fn word(&self, pointer: &str) -> &str {
        self.0
            .pointer(pointer)
            .and_then(Value::as_str)
            .unwrap_or_default()
    }

    /// The pilot's mode.
    #[must_use]
    pub fn mode(&self) -> &str {
        self.word("/mode")
    }

    /// Why the car does not drive, or stopped; empty without a reason.
    #[must_use]
    pub fn reason(&self) -> &str {
        self.word("/reason")
    }

    /// Where the session with the board stands.
    #[must_use]
    pub fn link(&self) -> &str {
        self.word("/link")
    }

    /// Why the board last went to neutral, as it said itself.
    #[must_use]
    pub fn stop_cause(&self) -> &str {
        self.word("/board/stop_cause")
    }

    /// A figure by its JSON pointer.
    ///
    /// # Errors
    ///
    /// There is no such figure.
    pub fn figure(&self, pointer: &str) -> Outcome<f64> {
        self.0
            .pointer(&format!("/figures{pointer}"))
            .and_then(Value::as_f64)
            .ok_or_else(|| Failure::new(format!("no figure {pointer} in {}", self.0)))
    }

    /// Where the live view is, and how many look at it.
    ///
    /// # Errors
    ///
    /// There is none.
    pub fn live(&self) -> Outcome<(SocketAddr, u64)> {
        let live = &self.0["live"];
        let address = live["address"].as_str().and_then(|text| text.parse().ok());
        address
            .zip(live["viewers"].as_u64())
            .ok_or_else(|| Failure::new(format!("no live view in {}", self.0)))
    }

    /// From where P should be to where the daemon believes it to be, in m.
    ///
    /// # Errors
    ///
    /// The status does not say.
    pub fn tracking_error_m(&self) -> Outcome<f64> {
        let place = |name: &str, axis: usize| self.0[name][axis].as_f64();
        let along = |axis| Some(place("point_m", axis)? - place("reference_m", axis)?);
        along(0)
            .zip(along(1))
            .map(|(x, y)| x.hypot(y))
            .ok_or_else(|| Failure::new(format!("no point or no reference in {}", self.0)))
    }

    /// In short, for whoever looks into a failure.
    #[must_use]
    pub fn text(&self) -> String {
        let short = json!({
            "mode": self.0["mode"], "reason": self.0["reason"], "link": self.0["link"],
            "board": self.0["board"], "frames": self.0["figures"]["frames"],
        });
        short.to_string()
    }
}

/// A stream of what the daemon records.
#[derive(Debug)]
pub struct Watch(Client);

impl Watch {
    /// Waits for the next entry, and takes a figure from it.
    ///
    /// # Errors
    ///
    /// Nothing comes, or it has no such figure.
    pub fn next(&mut self, figure: &str) -> Outcome<f64> {
        let entry = self.0.receive()?;
        find(&entry, figure).ok_or_else(|| Failure::new(format!("no {figure} in {entry}")))
    }

    /// Waits for the next entry, and takes those figures from it that it has.
    ///
    /// # Errors
    ///
    /// Nothing comes.
    pub fn next_of<const N: usize>(&mut self, figures: [&str; N]) -> Outcome<[Option<f64>; N]> {
        let entry = self.0.receive()?;
        Ok(figures.map(|figure| find(&entry, figure)))
    }
}

/// The record's entries nest; the name is there once. True is 1, false 0.
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
