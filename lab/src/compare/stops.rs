//! Why drives stopped.

use std::collections::BTreeMap;

/// Reasons with the number of drives of each, the commonest first.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(super) struct StopReasons(Vec<(String, usize)>);

impl StopReasons {
    /// Counts reasons. What stands behind a colon is about one drive alone.
    pub(super) fn of<'a>(reasons: impl Iterator<Item = &'a str>) -> Self {
        let mut counts = BTreeMap::<&str, usize>::new();
        for reason in reasons {
            let kind = reason.split_once(':').map_or(reason, |(kind, _)| kind);
            *counts.entry(kind).or_default() += 1;
        }
        let counts = counts.into_iter();
        let mut counts: Vec<_> = counts
            .map(|(kind, count)| (kind.to_owned(), count))
            .collect();
        // Equal ones stay in the order of their names.
        counts.sort_by_key(|(_, count)| core::cmp::Reverse(*count));
        Self(counts)
    }

    /// Empty without a stop.
    pub(super) fn commonest(&self) -> &str {
        self.0.first().map_or("", |(kind, _)| kind)
    }

    /// Each with its number, between them `separator`.
    pub(super) fn joined(&self, separator: &str) -> String {
        let reasons = self.0.iter().map(|(kind, count)| format!("{kind} {count}"));
        reasons.collect::<Vec<_>>().join(separator)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_commonest_is_first_and_equal_ones_are_in_the_order_of_their_names() {
        let reasons = ["geofence", "refused: a, b", "diverged", "refused: c"];
        let reasons = StopReasons::of(reasons.into_iter());
        assert_eq!(reasons.commonest(), "refused");
        assert_eq!(reasons.joined(";"), "refused 2;diverged 1;geofence 1");
        assert_eq!(StopReasons::default().commonest(), "");
    }
}
