//! From entries to messages on channels: the one way, for the file and for
//! whoever watches live.

use std::ops::Range;

use serde::Serialize;

use crate::{
    Channel, ClockMapping, Entry,
    standard::{Diagnostics, derive},
    topic,
};

/// Encodes entries as the messages of the channels.
///
/// Each entry becomes one message on its own topic, which holds all of it, and
/// then those of the [`crate::StandardTopic`]s that follow from it. The same
/// entries in the same order give the same bytes. An encoder is meant for the
/// thread that writes or sends them: it allocates.
#[derive(Debug)]
pub struct Encoder {
    start: ClockMapping,
    diagnostics: Diagnostics,
    batch: Batch,
}

/// A message on a channel. Times are on the wall, in ns since 1970, by the one
/// mapping taken when the record began.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Publication<'a> {
    /// The channel it is on.
    pub channel: Channel,
    /// When the entry that it comes from reached the host.
    pub log_time_ns: u64,
    /// When what it tells of happened.
    pub publish_time_ns: u64,
    /// The message as ROS 2 encodes it: CDR with its header.
    pub bytes: &'a [u8],
}

/// A message could not be encoded: a text in it is longer than 4 GB.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("cannot encode a message of {topic}: {reason}")]
pub struct EncodeError {
    /// The topic it is on.
    pub topic: &'static str,
    /// Why it failed.
    pub reason: String,
}

impl Encoder {
    /// For entries of a record that begins with `start`.
    #[must_use]
    pub fn new(start: ClockMapping) -> Self {
        Self {
            start,
            diagnostics: Diagnostics::default(),
            batch: Batch::new(start),
        }
    }

    /// The messages that `entry` becomes, its own first.
    ///
    /// # Errors
    ///
    /// When one of them cannot be encoded; none of them is then given.
    pub fn encode(
        &mut self,
        entry: &Entry,
    ) -> Result<impl Iterator<Item = Publication<'_>>, EncodeError> {
        let batch = &mut self.batch;
        batch.clear();
        let own = Channel::Entry(entry.topic());
        let encoded = entry.encode(&mut batch.bytes);
        batch.close(own, entry.sample_time_ns(), encoded)?;
        derive(entry, batch)?;
        self.diagnostics.take(entry, batch)?;
        Ok(self.batch.iter(self.start.wall_ns_at(entry.time_ns())))
    }
}

/// The messages of one entry, end to end.
#[derive(Debug)]
pub(crate) struct Batch {
    start: ClockMapping,
    bytes: Vec<u8>,
    messages: Vec<Encoded>,
}

#[derive(Debug)]
struct Encoded {
    channel: Channel,
    publish_time_ns: u64,
    range: Range<usize>,
}

impl Batch {
    fn new(start: ClockMapping) -> Self {
        Self {
            start,
            // A tick with all that follows from it.
            bytes: Vec::with_capacity(8 << 10),
            messages: Vec::with_capacity(Channel::COUNT),
        }
    }

    fn clear(&mut self) {
        self.bytes.clear();
        self.messages.clear();
    }

    /// The wall's time at a moment of the monotonic clock, both in ns.
    pub(crate) const fn wall_ns_at(&self, monotonic_ns: u64) -> u64 {
        self.start.wall_ns_at(monotonic_ns)
    }

    /// Adds a message on `channel` that tells of `sample_time_ns`, on the
    /// monotonic clock.
    pub(crate) fn add(
        &mut self,
        channel: Channel,
        sample_time_ns: u64,
        message: &impl Serialize,
    ) -> Result<(), EncodeError> {
        let encoded = topic::encode(message, &mut self.bytes);
        self.close(channel, sample_time_ns, encoded)
    }

    /// What was added to the bytes since the message before is one.
    fn close(
        &mut self,
        channel: Channel,
        sample_time_ns: u64,
        encoded: Result<(), cdr_encoding::Error>,
    ) -> Result<(), EncodeError> {
        encoded.map_err(|error| EncodeError {
            topic: channel.topic(),
            reason: error.to_string(),
        })?;
        let before = self.messages.last().map_or(0, |message| message.range.end);
        self.messages.push(Encoded {
            channel,
            publish_time_ns: self.wall_ns_at(sample_time_ns),
            range: before..self.bytes.len(),
        });
        Ok(())
    }

    fn iter(&self, log_time_ns: u64) -> impl Iterator<Item = Publication<'_>> {
        self.messages.iter().map(move |message| Publication {
            channel: message.channel,
            log_time_ns,
            publish_time_ns: message.publish_time_ns,
            bytes: self.bytes.get(message.range.clone()).unwrap_or_default(),
        })
    }
}
