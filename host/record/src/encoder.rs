//! From entries to messages on channels, for the file and for live viewers.

use crate::{
    Channel, ClockMapping, EncodeError, Entry, Publication,
    batch::Batch,
    derive::{Diagnostics, derive},
};

/// Encodes entries as the messages of the channels.
///
/// An entry gives one complete message on its own topic, then the messages on the
/// [`crate::StandardTopic`]s that follow from it. The same entries in the same order
/// give the same bytes. An encoder allocates: use it on the thread that writes or sends.
#[derive(Debug)]
pub struct Encoder {
    start: ClockMapping,
    diagnostics: Diagnostics,
    batch: Batch,
}

impl Encoder {
    /// An encoder for a record that begins at `start`.
    #[must_use]
    pub fn new(start: ClockMapping) -> Self {
        Self {
            start,
            diagnostics: Diagnostics::default(),
            batch: Batch::new(start),
        }
    }

    /// The messages of `entry`, its own first.
    ///
    /// # Errors
    ///
    /// When one of them can't be encoded. Then none is returned.
    pub fn encode(
        &mut self,
        entry: &Entry,
    ) -> Result<impl Iterator<Item = Publication<'_>>, EncodeError> {
        let batch = &mut self.batch;
        batch.clear();
        let own = Channel::Entry(entry.topic());
        batch.add_encoded(own, entry.sample_time_ns(), |bytes| entry.encode(bytes))?;
        derive(entry, batch)?;
        self.diagnostics.take(entry, batch)?;
        Ok(self.batch.iter(self.start.wall_ns_at(entry.time_ns())))
    }
}
