//! The hands of `singletrack-sim`, by its socket.

use std::{
    collections::VecDeque,
    io::{self, Read as _, Write as _},
    os::unix::net::UnixStream,
    path::Path,
    time::{Duration, Instant},
};

use singletrack_onboard::Hands;
use singletrack_sim::{HandCommand, Seen};

use crate::{Failure, Outcome, wait};

/// A person's hands and eyes, on a car in another process.
#[derive(Debug)]
pub struct SocketHands {
    stream: UnixStream,
    received: Vec<u8>,
    seen: Seen,
    /// What is still to be done.
    commands: VecDeque<HandCommand>,
    /// What is being done.
    under_way: Option<HandCommand>,
    begun: Instant,
    rear_axle_m: f64,
}

impl SocketHands {
    /// Connects.
    ///
    /// # Errors
    ///
    /// Nothing listens within five seconds.
    pub fn connect(path: &Path, rear_axle_m: f64) -> Outcome<Self> {
        let stream = wait::until("the hands' socket", Duration::from_secs(5), || {
            Ok(UnixStream::connect(path).ok())
        })?;
        stream
            .set_nonblocking(true)
            .map_err(Failure::system("the hands' socket"))?;
        Ok(Self {
            stream,
            received: Vec::new(),
            seen: Seen::default(),
            commands: VecDeque::new(),
            under_way: None,
            begun: Instant::now(),
            rear_axle_m,
        })
    }

    /// Takes the answer, and goes on with the next command, or looks.
    ///
    /// # Errors
    ///
    /// The simulator has ended, or does not know a command.
    pub fn poll(&mut self) -> Outcome {
        let mut buffer = [0; 1_024];
        match self.stream.read(&mut buffer) {
            Ok(0) => return Err(Failure::new("the simulator has ended")),
            Ok(count) => self
                .received
                .extend_from_slice(buffer.get(..count).unwrap_or_default()),
            Err(error) if error.kind() == io::ErrorKind::WouldBlock => {}
            Err(error) => return Err(Failure::system("the hands' socket")(error)),
        }
        if let Some(end) = self.received.iter().position(|byte| *byte == b'\n') {
            let line: Vec<u8> = self.received.drain(..=end).collect();
            let line = String::from_utf8_lossy(&line).into_owned();
            self.seen = line
                .strip_prefix("ok ")
                .and_then(|line| line.parse().ok())
                .ok_or_else(|| Failure::new(format!("the hands: {line}")))?;
            self.under_way = None;
        }
        if self.under_way.is_none() {
            let command = self.commands.pop_front().unwrap_or(HandCommand::Look);
            self.stream
                .write_all(format!("{command}\n").as_bytes())
                .map_err(Failure::system("the hands' socket"))?;
            self.under_way = Some(command);
        }
        Ok(())
    }
}

impl Hands for SocketHands {
    fn now_us(&self) -> u64 {
        self.begun.elapsed().as_micros() as u64
    }

    fn look(&self) -> Seen {
        self.seen
    }

    fn is_moving(&self) -> bool {
        !self.commands.is_empty() || matches!(self.under_way, Some(HandCommand::Move(_)))
    }

    fn apply(&mut self, command: HandCommand) {
        self.commands.push_back(command);
    }

    fn rear_axle_m(&self) -> f64 {
        self.rear_axle_m
    }
}
