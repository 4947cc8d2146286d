//! Rows of a record.

use std::{path::Path, thread};

use singletrack_record::{Ending, Reader, Recorded, Topic, Value};

use super::{Close, Next, PATIENCE, Row, Source};
use crate::operator::dump::{DumpError, span::Span};

/// A record, finished or not.
pub(in crate::operator::dump) struct Record {
    name: String,
    reader: Reader,
    follow: bool,
    start_wall_ns: u64,
}

impl Record {
    /// Opens a record to read the `chosen` of its kinds.
    pub(in crate::operator::dump) fn open(
        path: &Path,
        chosen: &[usize],
        follow: bool,
    ) -> Result<Self, DumpError> {
        let topics: Vec<_> = chosen
            .iter()
            .filter_map(|index| Topic::ALL.get(*index).copied())
            .collect();
        let reader = Reader::open(path)?.only(&topics);
        let start_wall_ns = reader.meta().start.wall_ns;
        Ok(Self {
            name: path.display().to_string(),
            reader,
            follow,
            start_wall_ns,
        })
    }

    fn is_unfinished(&self) -> bool {
        matches!(self.reader.ending(), Some(Ending::Unfinished { .. }))
    }
}

impl Source for Record {
    fn start_wall_ns(&self) -> Option<u64> {
        Some(self.start_wall_ns)
    }

    fn span(&self) -> Option<Span> {
        let since_start = |wall_ns: u64| wall_ns.wrapping_sub(self.start_wall_ns).cast_signed();
        let [first_ns, last_ns] = self.reader.span_wall_ns()?.map(since_start);
        Some(Span {
            first_ns,
            last_ns,
            start_wall_ns: self.start_wall_ns,
        })
    }

    fn next(&mut self) -> Result<Next, DumpError> {
        Ok(match self.reader.advance()? {
            Some(Recorded { topic, wall_ns }) => Next::Row(Row {
                kind: topic.index(),
                time_ns: Some(wall_ns.wrapping_sub(self.start_wall_ns).cast_signed()),
            }),
            None if self.follow && self.is_unfinished() => Next::Pending,
            None => Next::End,
        })
    }

    fn wait(&mut self) -> Result<(), DumpError> {
        thread::sleep(PATIENCE);
        Ok(())
    }

    fn read_values(&mut self, values: &mut Vec<Value>) -> Result<(), DumpError> {
        Ok(self.reader.read_values(values)?)
    }

    fn write_json(&mut self, json: &mut String) -> Result<(), DumpError> {
        Ok(self.reader.write_json(json)?)
    }

    fn close(&self) -> Close {
        let ending = self.reader.ending();
        Close {
            note: ending
                .filter(|_| self.is_unfinished())
                .map(|ending| format!("{}: {ending}", self.name)),
            unfinished: self.is_unfinished(),
            ..Close::default()
        }
    }
}
