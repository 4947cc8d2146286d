//! What the daemon records, as it comes.

use std::{
    io,
    path::Path,
    sync::mpsc::{self, Receiver, RecvTimeoutError},
    thread,
    time::Duration,
};

use singletrack_api::{ClientError, MessageStream, Received};
use singletrack_record::{Entry, Topic};

use super::ANSWER;

/// The topics that are watched.
const TOPICS: [Topic; 4] = [Topic::Tick, Topic::Telemetry, Topic::Status, Topic::Pose];

/// Entries that may wait here, beyond those that wait in the connection.
const BACKLOG: usize = 64;

/// The entries of the watched topics. A thread receives them, so that the wait for one can be
/// shorter than a message takes.
pub(super) struct Entries(Receiver<Result<Entry, ClientError>>);

impl Entries {
    /// Subscribes to them.
    pub(super) fn watch(socket: &Path) -> Result<Self, ClientError> {
        let channels = TOPICS.map(Topic::channel);
        let mut stream = MessageStream::open(socket, &channels, ANSWER).map_err(named)?;
        let (sender, entries) = mpsc::sync_channel(BACKLOG);
        // It ends with the connection, or with its receiver.
        thread::spawn(move || {
            loop {
                let entry = receive(&mut stream);
                let is_last = entry.is_err();
                if sender.send(entry).is_err() || is_last {
                    return;
                }
            }
        });
        Ok(Self(entries))
    }

    /// The next entry, if one comes within `wait`.
    pub(super) fn next(&self, wait: Duration) -> Result<Option<Entry>, ClientError> {
        match self.0.recv_timeout(wait) {
            Ok(entry) => entry.map(Some),
            Err(RecvTimeoutError::Timeout) => Ok(None),
            Err(RecvTimeoutError::Disconnected) => Err(ClientError::Ended),
        }
    }
}

/// Waits for the next entry.
fn receive(stream: &mut MessageStream) -> Result<Entry, ClientError> {
    loop {
        // What was missed is not observed.
        if let Received::Message(message) = stream.receive().map_err(named)?
            && let Some(topic) = TOPICS
                .into_iter()
                .find(|one| one.channel() == message.topic)
        {
            return Entry::decode(topic, message.bytes).map_err(ClientError::NoAnswer);
        }
    }
}

/// A wait that was too long, as for other connections.
fn named(error: ClientError) -> ClientError {
    match error {
        ClientError::BrokeOff(cause) if cause.kind() == io::ErrorKind::WouldBlock => {
            io::Error::from(io::ErrorKind::TimedOut).into()
        }
        other => other,
    }
}
