//! Frames on the line itself: a serial port, or a capture of its bytes.

use std::{
    fs::File,
    io::{self, Read},
    iter,
    os::fd::AsFd as _,
    path::Path,
    thread,
    time::Instant,
};

use singletrack_record::{Value, write_json_object};
use singletrackd::serial_port::{self, ReadHalf};

use super::{
    Close, Direction, Next, PATIENCE, Row, Source,
    frames::{Found, Frames},
    wall_ns,
};
use crate::operator::{
    dump::{
        DumpError,
        kind::{Kind, TIME},
    },
    readable::wait_to_read,
};

/// How much is read at once.
const READ_LENGTH: usize = 64 << 10;
/// A board whose clock went back by more than this has restarted.
const RESTART_US: i32 = -1_000_000;

/// The frames of a line.
pub(in crate::operator::dump) struct Line {
    name: String,
    input: Input,
    clock: Clock,
    frames: Frames,
    received: Vec<u8>,
    at: usize,
    follow: bool,
    /// There is no more to read.
    ended: bool,
    hung_up: bool,
    at_row: Option<(Row, Found)>,
    kinds: Vec<Kind>,
    values: Vec<Value>,
}

enum Input {
    Serial(ReadHalf),
    File(File),
}

/// What dates the frames.
enum Clock {
    /// When they arrived.
    Arrival {
        start: Instant,
        start_wall_ns: Option<u64>,
    },
    /// The board's own clock, since the first that told it: that, what it last
    /// said, and what that makes since the first.
    Board { last_us: Option<u32>, since_us: i64 },
}

impl Line {
    /// Opens a serial port, and never writes to it.
    pub(in crate::operator::dump) fn serial(
        path: &Path,
        baud: u32,
        direction: Direction,
        kinds: Vec<Kind>,
    ) -> Result<Self, DumpError> {
        // The half that writes is closed unused.
        let (read, _) = serial_port::open(path, baud)?;
        let name = path.display().to_string();
        Ok(Self::new(name, Input::Serial(read), direction, kinds))
    }

    /// Takes the line's bytes from a capture: a file, or standard input.
    pub(in crate::operator::dump) fn capture(
        name: String,
        file: io::Result<File>,
        direction: Direction,
        kinds: Vec<Kind>,
        follow: bool,
    ) -> Result<Self, DumpError> {
        match file {
            Ok(file) => Ok(Self {
                follow,
                ..Self::new(name, Input::File(file), direction, kinds)
            }),
            Err(error) => Err(unreadable(&name, &error)),
        }
    }

    fn new(name: String, input: Input, direction: Direction, kinds: Vec<Kind>) -> Self {
        let clock = match input {
            Input::Serial(_) => Clock::Arrival {
                start: Instant::now(),
                start_wall_ns: wall_ns(),
            },
            Input::File(_) => Clock::Board {
                last_us: None,
                since_us: 0,
            },
        };
        Self {
            name,
            input,
            clock,
            frames: Frames::new(direction),
            received: Vec::new(),
            at: 0,
            follow: false,
            ended: false,
            hung_up: false,
            at_row: None,
            kinds,
            values: Vec::new(),
        }
    }

    /// The next frame in what has been received.
    fn search(&mut self) -> Option<Found> {
        while let Some(byte) = self.received.get(self.at) {
            self.at += 1;
            if let Some(found) = self.frames.push(*byte) {
                return Some(found);
            }
        }
        self.ended.then(|| self.frames.finish())?
    }
}

/// The bytes of the line can't be read.
fn unreadable(name: &str, error: &io::Error) -> DumpError {
    DumpError::Other(format!("can't read {name}: {error}"))
}

impl Clock {
    /// When a frame came, in ns since the start.
    fn date(&mut self, found: &Found) -> Option<i64> {
        match self {
            Self::Arrival { start, .. } => i64::try_from(start.elapsed().as_nanos()).ok(),
            Self::Board { last_us, since_us } => {
                if let Some(board_us) = found.content.board_time_us() {
                    let passed = board_us
                        .wrapping_sub(last_us.unwrap_or(board_us))
                        .cast_signed();
                    // A restarted clock goes on from where the last one stopped.
                    if passed > RESTART_US {
                        *since_us += i64::from(passed);
                    }
                    *last_us = Some(board_us);
                }
                (*last_us)?;
                Some(since_us.saturating_mul(1_000))
            }
        }
    }
}

impl Source for Line {
    fn start_wall_ns(&self) -> Option<u64> {
        match self.clock {
            Clock::Arrival { start_wall_ns, .. } => start_wall_ns,
            Clock::Board { .. } => None,
        }
    }

    fn next(&mut self) -> Result<Next, DumpError> {
        let Some(found) = self.search() else {
            if !self.ended {
                return Ok(Next::Pending);
            }
            if matches!(self.input, Input::File(_)) && self.frames.whole == 0 {
                let (name, bytes) = (&self.name, self.frames.taken());
                return Err(DumpError::Other(format!(
                    "{name} holds no whole frame of the protocol in {bytes} bytes: name a capture of \
                     the serial line (--direction says which way the bytes went), or a record (*.mcap \
                     or *.mcap.part)"
                )));
            }
            return Ok(Next::End);
        };
        let name = found.content.name();
        let row = Row {
            kind: self
                .kinds
                .iter()
                .position(|kind| kind.name == name)
                .unwrap_or_default(),
            time_ns: self.clock.date(&found),
        };
        self.at_row = Some((row, found));
        Ok(Next::Row(row))
    }

    fn wait(&mut self) -> Result<(), DumpError> {
        let input = match &self.input {
            Input::Serial(port) => port.as_fd(),
            Input::File(file) => file.as_fd(),
        };
        let ready = wait_to_read([input], PATIENCE);
        if !ready.map_err(|error| unreadable(&self.name, &error))? {
            return Ok(());
        }
        self.received.resize(READ_LENGTH, 0);
        self.at = 0;
        let read = match &mut self.input {
            Input::Serial(port) => match port.read(&mut self.received) {
                // Unplugged, or the other end of a pseudo-terminal is closed.
                Some(Ok(0) | Err(_)) => {
                    self.hung_up = true;
                    self.ended = true;
                    Ok(0)
                }
                read => read.unwrap_or(Ok(0)),
            },
            Input::File(file) => {
                let read = file.read(&mut self.received);
                if matches!(read, Ok(0)) {
                    if self.follow {
                        thread::sleep(PATIENCE);
                    } else {
                        self.ended = true;
                    }
                }
                read
            }
        };
        self.received
            .truncate(read.as_ref().copied().unwrap_or_default());
        match read {
            Err(error) if error.kind() != io::ErrorKind::Interrupted => {
                Err(unreadable(&self.name, &error))
            }
            _ => Ok(()),
        }
    }

    fn read_values(&mut self, values: &mut Vec<Value>) -> Result<(), DumpError> {
        match &self.at_row {
            Some((_, found)) => found.read_values(values),
            None => values.clear(),
        }
        Ok(())
    }

    fn write_json(&mut self, json: &mut String) -> Result<(), DumpError> {
        if let Some((row, found)) = &self.at_row
            && let Some(kind) = self.kinds.get(row.kind)
        {
            found.read_values(&mut self.values);
            let time = row.time();
            let fields = kind.fields.iter().map(String::as_str).zip(&self.values);
            write_json_object(json, kind.name, iter::once((TIME, &time)).chain(fields));
        }
        Ok(())
    }

    fn close(&self) -> Close {
        Close {
            note: self
                .hung_up
                .then(|| format!("{}: the line hung up", self.name)),
            line_bytes: Some(self.frames.taken()),
            ..Close::default()
        }
    }
}
