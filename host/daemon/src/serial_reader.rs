//! The thread that opens the port, reads it, and opens it again.

use std::{os::fd::AsFd, path::Path, time::Duration};

use rtrb::{Consumer, Producer, PushError};
use tracing::{info, warn};

use crate::{
    clock::monotonic_ns,
    config::SerialSection,
    serial_port::{self, ReadHalf, WriteHalf},
    wake::{StopFlag, Woken},
};

/// The most bytes that are handed over at once.
pub const CHUNK: usize = 240;

/// What the line says to the control thread.
#[derive(Debug)]
#[expect(
    clippy::large_enum_variant,
    reason = "the control thread must not allocate to take it in"
)]
pub enum SerialEvent<L> {
    /// The port is open; this is where to write.
    Opened(L),
    /// Bytes came.
    Bytes(Chunk),
    /// The port has hung up: give the write half back.
    Closed {
        /// When that was noticed.
        time_ns: u64,
    },
}

/// Bytes that were read at once.
#[derive(Clone, Copy, Debug)]
pub struct Chunk {
    /// When they were read.
    pub time_ns: u64,
    length: usize,
    bytes: [u8; CHUNK],
}

impl Chunk {
    /// The first [`CHUNK`] bytes of `bytes`, read at `time_ns`.
    #[must_use]
    pub fn new(time_ns: u64, bytes: &[u8]) -> Self {
        let mut chunk = Self {
            time_ns,
            length: 0,
            bytes: [0; CHUNK],
        };
        for (to, from) in chunk.bytes.iter_mut().zip(bytes) {
            *to = *from;
            chunk.length += 1;
        }
        chunk
    }

    /// The bytes.
    #[must_use]
    pub fn bytes(&self) -> &[u8] {
        self.bytes.get(..self.length).unwrap_or(&[])
    }
}

/// Waiting times between two attempts to open the port.
const FIRST_RETRY: Duration = Duration::from_millis(50);
const LAST_RETRY: Duration = Duration::from_millis(400);

/// How long a hang-up waits for the control thread to let the port go.
const RETURN_PATIENCE: Duration = Duration::from_millis(200);

/// How long the reader waits before it looks around without a reason.
const LOOK_AROUND: Duration = Duration::from_millis(200);

/// What the reader counted.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct ReaderCounters {
    /// Times that the port was opened.
    pub(crate) opened: u64,
    /// Bytes that found no room on their way to the control thread.
    pub(crate) bytes_dropped: u64,
}

/// Everything on the reader's thread.
pub(crate) struct SerialReader {
    pub(crate) config: SerialSection,
    pub(crate) events: Producer<SerialEvent<WriteHalf>>,
    /// Where the control thread gives write halves back.
    pub(crate) returned: Consumer<WriteHalf>,
    pub(crate) stop: StopFlag,
    pub(crate) counters: ReaderCounters,
}

impl SerialReader {
    /// Runs until it is told to stop.
    pub(crate) fn run(mut self) -> ReaderCounters {
        let path = self.config.port.clone();
        let mut retry = FIRST_RETRY;
        // The same trouble is told once.
        let mut told = String::new();
        loop {
            match serial_port::open(&path, self.config.baud) {
                Ok((read, write)) => {
                    info!(port = %path.display(), baud = self.config.baud, "serial port open");
                    self.counters.opened += 1;
                    told.clear();
                    retry = FIRST_RETRY;
                    if self.hand_over(SerialEvent::Opened(write)) == Woken::Stop {
                        return self.counters;
                    }
                    if self.read(&path, &read) == Woken::Stop {
                        return self.counters;
                    }
                }
                Err(error) => {
                    let text = error.to_string();
                    if text != told {
                        warn!("no serial port: {text}");
                        told = text;
                    }
                }
            }
            if self.stop.wait(&[], retry) == Woken::Stop {
                return self.counters;
            }
            retry = (2 * retry).min(LAST_RETRY);
        }
    }

    /// Reads until the line hangs up, and then until the control thread has let
    /// it go.
    fn read(&mut self, path: &Path, port: &ReadHalf) -> Woken {
        let mut buffer = [0; CHUNK];
        loop {
            match self.stop.wait(&[port.as_fd()], LOOK_AROUND) {
                Woken::Stop => return Woken::Stop,
                Woken::Timeout => continue,
                Woken::Ready => {}
            }
            let reason = match port.read(&mut buffer) {
                None => continue,
                Some(Ok(count @ 1..)) => {
                    let time_ns = monotonic_ns();
                    let chunk = Chunk::new(time_ns, buffer.get(..count).unwrap_or(&[]));
                    if self.events.push(SerialEvent::Bytes(chunk)).is_err() {
                        self.counters.bytes_dropped += count as u64;
                    }
                    continue;
                }
                Some(Ok(0)) => "end of file".to_owned(),
                Some(Err(error)) => error.to_string(),
            };
            warn!(port = %path.display(), reason, "serial port hung up");
            let time_ns = monotonic_ns();
            if self.hand_over(SerialEvent::Closed { time_ns }) == Woken::Stop {
                return Woken::Stop;
            }
            return self.await_return();
        }
    }

    /// Hands over what must not be dropped.
    fn hand_over(&mut self, event: SerialEvent<WriteHalf>) -> Woken {
        let mut event = event;
        loop {
            match self.events.push(event) {
                Ok(()) => return Woken::Ready,
                Err(PushError::Full(back)) => event = back,
            }
            if self.stop.wait(&[], Duration::from_millis(1)) == Woken::Stop {
                return Woken::Stop;
            }
        }
    }

    /// Waits for the write half, as long as which is open nobody else, not even
    /// we, can open the port.
    fn await_return(&mut self) -> Woken {
        let until_ns = monotonic_ns() + RETURN_PATIENCE.as_nanos() as u64;
        while self.returned.pop().is_err() && monotonic_ns() < until_ns {
            if self.stop.wait(&[], Duration::from_millis(1)) == Woken::Stop {
                return Woken::Stop;
            }
        }
        Woken::Ready
    }
}
