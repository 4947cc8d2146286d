//! From entries to messages on channels, for the file and for live viewers.

use crate::{
    Channel, ClockMapping, Entry,
    batch::{Batch, EncodeError, Publication},
    standard::{Diagnostics, derive},
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
        batch.add_encoded(own, entry.sample_time_ns(), |bytes| entry.encode(bytes))?;
        derive(entry, batch)?;
        self.diagnostics.take(entry, batch)?;
        Ok(self.batch.iter(self.start.wall_ns_at(entry.time_ns())))
    }
}
