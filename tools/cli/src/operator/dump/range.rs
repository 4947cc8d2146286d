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
            (Some(from), Some(to)) if from.is_after(to) => Err(no_time(from, to, span)),
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
        let since = |moment: Option<Moment>, option: &str| {
            let since = |moment: Moment| {
                let no_wall_time = || {
                    DumpError::Other(format!(
                        "{name} holds no wall time: give --{option} in seconds since its start"
                    ))
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
            return Err(no_time(from, to, span));
        }
        if let Some(span) = span {
            let outside = |option: &str, moment: Moment| {
                DumpError::Other(format!(
                    "--{option} {moment} leaves nothing of {name}: its entries are from {span}"
                ))
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

/// The range ends before it begins. `span` are the times of the record, if they are known.
fn no_time(from: Moment, to: Moment, span: Option<Span>) -> DumpError {
    let of_record = span.map(|span| format!("; the entries of the record are from {span}"));
    DumpError::Other(format!(
        "--from {from} is after --to {to}: give the earlier time to --from{}",
        of_record.unwrap_or_default()
    ))
}
