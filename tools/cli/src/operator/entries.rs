//! What the running daemon records, as it comes.

use std::{
    path::Path,
    sync::mpsc::{self, Receiver, RecvTimeoutError},
    thread,
    time::Duration,
};

use singletrack_api::{ClientError, MessageStream, Received};
use singletrack_record::{Entry, Topic};

/// The longest wait for the daemon's answer to the subscription.
const ANSWER: Duration = Duration::from_secs(5);

/// Entries that may wait here, beyond those that wait in the connection.
const BACKLOG: usize = 64;

/// What came next.
pub(crate) enum Heard {
    /// An entry of a chosen topic.
    Entry(Box<Entry>),
    /// This number of entries, of any topic, was lost: they are not taken as fast as they come.
    Missed(u64),
}

/// The entries of the chosen topics. A thread receives them, so that the wait for one can be
/// shorter than a message takes.
pub(crate) struct Entries(Receiver<Result<Heard, ClientError>>);

impl Entries {
    /// Subscribes to the entries of `topics`, and waits until the daemon agrees.
    pub(crate) fn watch(socket: &Path, topics: Vec<Topic>) -> Result<Self, ClientError> {
        let channels: Vec<_> = topics.iter().map(|topic| topic.channel()).collect();
        let mut stream = MessageStream::open(socket, &channels, ANSWER)?;
        stream.wait_for_ever()?;
        let (sender, entries) = mpsc::sync_channel(BACKLOG);
        // It ends with the connection, or with its receiver.
        thread::spawn(move || {
            loop {
                let next = receive(&mut stream, &topics);
                let is_last = next.is_err();
                if sender.send(next).is_err() || is_last {
                    return;
                }
            }
        });
        Ok(Self(entries))
    }

    /// What comes next, if it comes within `wait`.
    pub(crate) fn next(&self, wait: Duration) -> Result<Option<Heard>, ClientError> {
        match self.0.recv_timeout(wait) {
            Ok(next) => next.map(Some),
            Err(RecvTimeoutError::Timeout) => Ok(None),
            Err(RecvTimeoutError::Disconnected) => Err(ClientError::Ended),
        }
    }
}

/// Waits for what comes next. A newer daemon may have more topics than this program.
fn receive(stream: &mut MessageStream, topics: &[Topic]) -> Result<Heard, ClientError> {
    loop {
        let message = match stream.receive()? {
            Received::Message(message) => message,
            Received::Missed(count) => return Ok(Heard::Missed(count)),
        };
        if let Some(topic) = topics.iter().find(|one| one.channel() == message.topic) {
            let entry = Entry::decode(*topic, message.bytes).map_err(ClientError::NoAnswer);
            return Ok(Heard::Entry(Box::new(entry?)));
        }
    }
}
