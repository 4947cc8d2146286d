//! The messages of one entry, on their way to their channels.

use std::ops::Range;

use serde::Serialize;

use crate::{Channel, ClockMapping, message};

/// A message on a channel. Times are on the wall clock, in ns since 1970, by the mapping
/// taken when the record began.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Publication<'a> {
    /// Its channel.
    pub channel: Channel,
    /// When its entry reached the host.
    pub log_time_ns: u64,
    /// When the described event happened.
    pub publish_time_ns: u64,
    /// The message as ROS 2 encodes it: CDR with its header.
    pub bytes: &'a [u8],
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
    pub(crate) fn new(start: ClockMapping) -> Self {
        Self {
            start,
            // Enough for a tick and all messages that follow from it.
            bytes: Vec::with_capacity(8 << 10),
            messages: Vec::with_capacity(Channel::COUNT),
        }
    }

    pub(crate) fn clear(&mut self) {
        self.bytes.clear();
        self.messages.clear();
    }

    /// The wall clock at a time of the monotonic clock, both in ns.
    pub(crate) const fn wall_ns_at(&self, monotonic_ns: u64) -> u64 {
        self.start.wall_ns_at(monotonic_ns)
    }

    /// Adds a message on `channel` about `sample_time_ns`, on the monotonic clock.
    pub(crate) fn add(
        &mut self,
        channel: Channel,
        sample_time_ns: u64,
        message: &impl Serialize,
    ) -> Result<(), String> {
        self.add_encoded(channel, sample_time_ns, |bytes| {
            message::encode(message, bytes)
        })
    }

    /// Adds a message that `encode` appends to the bytes.
    pub(crate) fn add_encoded(
        &mut self,
        channel: Channel,
        sample_time_ns: u64,
        encode: impl FnOnce(&mut Vec<u8>) -> Result<(), cdr_encoding::Error>,
    ) -> Result<(), String> {
        let start = self.bytes.len();
        // Only a text that is longer than 4 GB can't be.
        encode(&mut self.bytes)
            .map_err(|error| format!("can't encode a message of {}: {error}", channel.topic()))?;
        self.messages.push(Encoded {
            channel,
            publish_time_ns: self.wall_ns_at(sample_time_ns),
            range: start..self.bytes.len(),
        });
        Ok(())
    }

    /// The messages in their order. All reached the host at the same moment.
    pub(crate) fn iter(&self, log_time_ns: u64) -> impl Iterator<Item = Publication<'_>> {
        self.messages.iter().map(move |message| Publication {
            channel: message.channel,
            log_time_ns,
            publish_time_ns: message.publish_time_ns,
            bytes: self.bytes.get(message.range.clone()).unwrap_or_default(),
        })
    }
}
