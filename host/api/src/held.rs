//! A drive that a connection holds: the client's side of the dead-man switch.

use std::{
    path::Path,
    time::{Duration, Instant},
};

use crate::{Arm, Attendance, ClientError, Connection, Reply, Request};

/// Interval of the renewals. The daemon stops the car 0.5 s after the last one.
pub const RENEWAL: Duration = Duration::from_millis(100);

/// A connection that holds a drive, for as long as its owner calls it. Dropped, it ends the drive.
#[derive(Debug)]
pub struct HeldDrive {
    /// Its connection, for other requests and what the daemon says of the drive.
    pub connection: Connection,
    interval: Duration,
    renewed: Instant,
}

impl HeldDrive {
    /// Holds what `connection` arms, or has armed, with a renewal every `interval`.
    pub fn new(connection: Connection, interval: Duration) -> Self {
        Self {
            connection,
            interval,
            renewed: Instant::now(),
        }
    }

    /// Arms, and returns once the car drives. `patience` is the longest wait for a daemon that does
    /// not read.
    ///
    /// # Errors
    ///
    /// The daemon refuses, or the connection is lost.
    pub fn arm(socket: &Path, patience: Duration, wait: Duration) -> Result<Self, ClientError> {
        let mut drive = Self::new(Connection::open(socket, patience)?, RENEWAL);
        drive.connection.send(&Request::Arm(Arm {
            attendance: Some(Attendance::Hold),
            ..Arm::default()
        }))?;
        loop {
            if let Some(reply) = drive.next(wait)? {
                reply.agreed()?;
                return Ok(drive);
            }
        }
    }

    /// Whether a renewal is due; then the next one is due an interval later.
    pub fn is_due(&mut self) -> bool {
        let is_due = self.renewed.elapsed() >= self.interval;
        if is_due {
            self.renewed = Instant::now();
        }
        is_due
    }

    /// Renews the drive if that is due.
    ///
    /// # Errors
    ///
    /// The connection is lost.
    pub fn renew(&mut self) -> Result<(), ClientError> {
        match self.is_due() {
            true => self.connection.send(&Request::Hold {}),
            false => Ok(()),
        }
    }

    /// Renews the drive if that is due, and waits for the daemon's next line; `None` if none comes
    /// within `wait`, which must be shorter than the interval.
    ///
    /// # Errors
    ///
    /// The connection is lost.
    pub fn next(&mut self, wait: Duration) -> Result<Option<Reply>, ClientError> {
        self.renew()?;
        self.connection.receive_within(wait)
    }
}
