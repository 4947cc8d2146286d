//! The range of time on the command line.

use super::{DumpError, moment::Moment, source::Source, span::Span};

/// From when to when rows are printed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Range {
    pub(super) from: Option<Moment>,
    pub(super) to: Option<Moment>,
}

impl Range {
    /// Refuses a range that ends before it begins, as far as that is known without the source.
    pub(super) fn check_order(self, span: Option<Span>) -> Result<(), DumpError> {
        match (self.from, self.to) {
            (Some(from), Some(to)) if from.is_after(to) => {
                Err(DumpError::NoTime { from, to, span })
            }
            _ => Ok(()),
        }
    }

    /// The range in ns since the start of the source. One that no entry of the source can be in
    /// is refused.
    pub(super) fn since(
        self,
        source: &dyn Source,
        name: &str,
    ) -> Result<(Option<i64>, Option<i64>), DumpError> {
        let span = source.span();
        self.check_order(span)?;
        let start_wall_ns = source.start_wall_ns();
        let since = |moment: Option<Moment>, option| {
            let since = |moment: Moment| {
                let no_wall_time = || DumpError::NoWallTime {
                    name: name.to_owned(),
                    option,
                };
                moment.since(start_wall_ns).ok_or_else(no_wall_time)
            };
            moment.map(since).transpose()
        };
        let (from_ns, to_ns) = (since(self.from, "from")?, since(self.to, "to")?);
        // One may be a date and the other a number of seconds.
        if let (Some(from), Some(to), Some(from_ns), Some(to_ns)) =
            (self.from, self.to, from_ns, to_ns)
            && from_ns > to_ns
        {
            return Err(DumpError::NoTime { from, to, span });
        }
        if let Some(span) = span {
            let outside = |option, moment| DumpError::OutsideRecord {
                name: name.to_owned(),
                option,
                moment,
                span,
            };
            if let Some(from) = self.from
                && from_ns.is_some_and(|from_ns| from_ns > span.last_ns)
            {
                return Err(outside("from", from));
            }
            if let Some(to) = self.to
                && to_ns.is_some_and(|to_ns| to_ns < span.first_ns)
            {
                return Err(outside("to", to));
            }
        }
        Ok((from_ns, to_ns))
    }
}
