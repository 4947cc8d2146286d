//! Rows of the running daemon.

use std::{
    io::{self, BufRead as _, BufReader, Write as _},
    os::{fd::AsFd as _, unix::net::UnixStream},
    path::{Path, PathBuf},
    time::Instant,
};

use singletrack_api::{ClientError, Request};
use singletrack_record::{ParseEntryError, Shown, Topic, Value};
use singletrackd::monotonic_ns;

use super::{Close, Next, PATIENCE, Row, Source, wall_ns};
use crate::operator::{
    dump::{DumpError, kind::Kind},
    readable::wait_to_read,
};

/// How long the daemon may take to answer.
const ANSWER_TIMEOUT: std::time::Duration = std::time::Duration::from_secs(5);
/// How much is read from the socket at once.
const READ_LENGTH: usize = 64 << 10;

/// The daemon's socket, and the entries that come over it.
pub(in crate::operator::dump) struct Live {
    path: PathBuf,
    stream: BufReader<UnixStream>,
    /// The beginning of a line.
    received: Vec<u8>,
    closed: bool,
    line: String,
    values: Vec<Value>,
    /// For each kind, which field is its time; none for those not asked for.
    times: Vec<Option<usize>>,
    start_ns: u64,
    start_wall_ns: Option<u64>,
    missed: u64,
}

impl Live {
    /// Subscribes to the `chosen` kinds, and waits until the daemon agrees.
    pub(in crate::operator::dump) fn connect(
        path: &Path,
        kinds: &[Kind],
        chosen: &[usize],
    ) -> Result<Self, DumpError> {
        let unreachable = |error: io::Error| {
            let path = path.display();
            DumpError::Other(format!(
                "can't reach the daemon at {path}: {error}; start singletrackd, or name its socket with \
                 --socket"
            ))
        };
        let mut stream = UnixStream::connect(path).map_err(unreachable)?;
        let topics: Vec<_> = chosen
            .iter()
            .filter_map(|index| kinds.get(*index))
            .map(|kind| kind.name.to_string())
            .collect();
        let request = Request::Watch { topics }.to_line();
        request
            .map_err(io::Error::other)
            .and_then(|line| stream.write_all(line.as_bytes()))
            .and_then(|()| stream.set_nonblocking(true))
            .map_err(unreachable)?;
        let times = kinds
            .iter()
            .zip(Topic::ALL)
            .map(|(kind, topic)| {
                let chosen = chosen.contains(&topic.index());
                chosen.then(|| kind.index(topic.time_field()))?
            })
            .collect();
        let mut live = Self {
            path: path.to_owned(),
            stream: BufReader::with_capacity(READ_LENGTH, stream),
            received: Vec::new(),
            closed: false,
            line: String::new(),
            values: Vec::new(),
            times,
            start_ns: monotonic_ns(),
            start_wall_ns: wall_ns(),
            missed: 0,
        };
        live.expect_agreement()?;
        Ok(live)
    }

    /// The daemon's first line accepts or refuses the subscription.
    fn expect_agreement(&mut self) -> Result<(), DumpError> {
        let asked = Instant::now();
        while !self.take_line()? {
            if self.closed || asked.elapsed() > ANSWER_TIMEOUT {
                return Err(DumpError::Lost(if self.closed {
                    ClientError::Ended
                } else {
                    ClientError::silent(&self.path, ANSWER_TIMEOUT)
                }));
            }
            self.wait()?;
        }
        let answer = serde_json::from_str::<serde_json::Value>(&self.line).map_err(|error| {
            self.invalid_entry(&ParseEntryError::NotJson {
                line: self.line.clone(),
                reason: error.to_string(),
            })
        })?;
        if answer["ok"] == true {
            return Ok(());
        }
        Err(match answer["error"].as_str() {
            Some(error) => {
                let path = self.path.display();
                DumpError::Other(format!("the daemon at {path} refuses: {error}"))
            }
            None => self.invalid_entry(&ParseEntryError::NoTopic {
                line: self.line.clone(),
            }),
        })
    }

    /// Moves a whole line to `line`; false if there is none yet.
    fn take_line(&mut self) -> Result<bool, DumpError> {
        match self.stream.read_until(b'\n', &mut self.received) {
            Ok(_) => {}
            Err(error) if error.kind() == io::ErrorKind::WouldBlock => return Ok(false),
            Err(error) => return Err(DumpError::Lost(error.into())),
        }
        // The last line before the end may not be whole.
        self.closed = self.received.pop_if(|byte| *byte == b'\n').is_none();
        if !self.closed {
            self.line = String::from_utf8_lossy(&self.received).into_owned();
            self.received.clear();
        }
        Ok(!self.closed)
    }

    /// The row that a line of an entry is; none if it was not asked for.
    fn row(&self, shown: &Shown) -> Option<Row> {
        let kind = shown.topic.index();
        let field = (*self.times.get(kind)?)?;
        let time_ns = match shown.values.get(field) {
            Some(Value::Unsigned(ns)) => Some(ns.wrapping_sub(self.start_ns).cast_signed()),
            _ => None,
        };
        Some(Row { kind, time_ns })
    }

    fn invalid_entry(&self, error: &ParseEntryError) -> DumpError {
        let path = self.path.display();
        DumpError::Other(format!(
            "can't understand the daemon at {path}: {error}; use the singletrack of its release"
        ))
    }
}

impl Source for Live {
    fn start_wall_ns(&self) -> Option<u64> {
        self.start_wall_ns
    }

    fn next(&mut self) -> Result<Next, DumpError> {
        loop {
            if !self.take_line()? {
                return Ok(if self.closed {
                    Next::End
                } else {
                    Next::Pending
                });
            }
            match Shown::from_json(&self.line) {
                Ok(shown) => {
                    if let Some(row) = self.row(&shown) {
                        self.values = shown.values;
                        return Ok(Next::Row(row));
                    }
                }
                // A newer daemon may have more topics than this program.
                Err(ParseEntryError::NoTopic { line }) if line.contains("\"topic\"") => {}
                Err(source) => match missed(&self.line) {
                    Some(count) => {
                        self.missed += count;
                        eprintln!(
                            "singletrack: {}: {count} entries of all topics missed: \
                             what is printed is not taken as fast as they come",
                            self.path.display()
                        );
                    }
                    None => return Err(self.invalid_entry(&source)),
                },
            }
        }
    }

    fn wait(&mut self) -> Result<(), DumpError> {
        wait_to_read([self.stream.get_ref().as_fd()], PATIENCE)
            .map(drop)
            .map_err(|error| DumpError::Lost(error.into()))
    }

    fn read_values(&mut self, values: &mut Vec<Value>) -> Result<(), DumpError> {
        values.clone_from(&self.values);
        Ok(())
    }

    fn write_json(&mut self, json: &mut String) -> Result<(), DumpError> {
        // As the daemon sent it: it may be of another release.
        json.push_str(&self.line);
        Ok(())
    }

    fn close(&self) -> Close {
        Close {
            missed: self.missed,
            ..Close::default()
        }
    }
}

/// How many entries the daemon says it could not send.
fn missed(line: &str) -> Option<u64> {
    serde_json::from_str::<serde_json::Value>(line).ok()?["missed"].as_u64()
}
