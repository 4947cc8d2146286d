//! The messages of the record for clients of the control socket: encoded once for all of them,
//! and only while there is one.

use std::{ops::Range, sync::Arc};

use serde_json::json;
use singletrack_record::{Channel, ClockMapping, Encoder, Entry};
use tokio::sync::broadcast;

/// Entries that a client may be behind before it misses some: most of a second.
const CAPACITY: usize = 256;

/// The way from the collector to the clients.
#[derive(Debug)]
pub(crate) struct MessageFeed {
    /// Maps the times of the stamps, as in the record.
    pub(crate) clocks: ClockMapping,
    clients: broadcast::Sender<Arc<Frames>>,
}

impl MessageFeed {
    pub(crate) fn new(clocks: ClockMapping) -> Self {
        Self {
            clocks,
            clients: broadcast::Sender::new(CAPACITY),
        }
    }

    pub(crate) fn subscribe(&self) -> broadcast::Receiver<Arc<Frames>> {
        self.clients.subscribe()
    }

    /// Encodes an entry if a client wants messages.
    pub(crate) fn publish(&self, encoder: &mut Encoder, entry: &Entry) {
        if self.clients.receiver_count() == 0 {
            return;
        }
        // What can't be encoded is missing in the record too, which reports it.
        if let Ok(publications) = encoder.encode(entry) {
            let mut frames = Frames::default();
            for publication in publications {
                frames.add(publication.channel, publication.bytes);
            }
            // An error means that the last client has left.
            let _ = self.clients.send(Arc::new(frames));
        }
    }
}

/// The messages of one entry as they are sent: for each a line with topic and length, then its
/// bytes.
#[derive(Debug, Default)]
pub(crate) struct Frames {
    bytes: Vec<u8>,
    frames: Vec<(Channel, Range<usize>)>,
}

impl Frames {
    fn add(&mut self, channel: Channel, message: &[u8]) {
        let begin = self.bytes.len();
        let head = json!({ "topic": channel.topic(), "bytes": message.len() });
        self.bytes.extend_from_slice(head.to_string().as_bytes());
        self.bytes.push(b'\n');
        self.bytes.extend_from_slice(message);
        self.frames.push((channel, begin..self.bytes.len()));
    }

    /// Adds the frames of `channels` to `bytes`; of all if there are none.
    pub(crate) fn choose(&self, channels: &[Channel], bytes: &mut Vec<u8>) {
        for (channel, range) in &self.frames {
            if channels.is_empty() || channels.contains(channel) {
                bytes.extend_from_slice(self.bytes.get(range.clone()).unwrap_or_default());
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use singletrack_record::{Level, Log, StandardTopic, Topic};

    use super::*;

    const CLOCKS: ClockMapping = ClockMapping {
        monotonic_ns: 0,
        wall_ns: 1_000_000_000,
    };

    fn entry() -> Entry {
        Entry::Log(Log {
            time_ns: 5,
            level: Level::Info,
            text: "a line".to_owned(),
        })
    }

    #[test]
    fn the_bytes_of_a_message_are_those_of_the_record() {
        let feed = MessageFeed::new(CLOCKS);
        let mut client = feed.subscribe();
        feed.publish(&mut Encoder::new(CLOCKS), &entry());
        let frames = client.try_recv().unwrap();
        let mut expected = Vec::new();
        for publication in Encoder::new(CLOCKS).encode(&entry()).unwrap() {
            let (topic, length) = (publication.channel.topic(), publication.bytes.len());
            expected.extend_from_slice(
                format!("{{\"bytes\":{length},\"topic\":\"{topic}\"}}\n").as_bytes(),
            );
            expected.extend_from_slice(publication.bytes);
        }
        let mut all = Vec::new();
        frames.choose(&[], &mut all);
        assert_eq!(all, expected);

        let (mut own, mut derived, mut none) = (Vec::new(), Vec::new(), Vec::new());
        frames.choose(&[Channel::Entry(Topic::Log)], &mut own);
        frames.choose(&[Channel::Standard(StandardTopic::Rosout)], &mut derived);
        frames.choose(&[Channel::Entry(Topic::Tick)], &mut none);
        assert_eq!([own, derived].concat(), expected);
        assert!(none.is_empty());
    }

    #[test]
    fn nothing_is_encoded_without_a_client() {
        let feed = MessageFeed::new(CLOCKS);
        feed.publish(&mut Encoder::new(CLOCKS), &entry());
        assert!(feed.subscribe().try_recv().is_err());
    }
}
