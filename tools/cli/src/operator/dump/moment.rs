//! Times on the command line, and the range between two of them.

use std::{fmt, str::FromStr};

use jiff::Timestamp;

use super::source::Times;

/// A time within a record.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Moment {
    /// Seconds after the start of the record.
    Seconds(f64),
    /// On the wall, in ns since 1970.
    WallNs(i64),
}

impl FromStr for Moment {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        if let Some(seconds) = text
            .parse()
            .ok()
            .filter(|seconds: &f64| seconds.is_finite())
        {
            if seconds < 0.0 {
                return Err("there is nothing before the start: give 0 or more seconds".to_owned());
            }
            return Ok(Self::Seconds(seconds));
        }
        wall_ns(text).map(Self::WallNs).ok_or_else(|| {
            format!(
                "not a time: {text:?}; use seconds since the start (12.5), or date, time and zone \
                 (2026-11-21T12:00:00.5Z, 2026-11-21T13:00:00+01:00)"
            )
        })
    }
}

impl fmt::Display for Moment {
    /// Seconds, or date and time in UTC.
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Seconds(seconds) => write!(formatter, "{seconds}"),
            Self::WallNs(wall_ns) => {
                // All that fits into 64 bits is within the calendar: 1677 to 2262.
                let time = Timestamp::from_nanosecond(i128::from(*wall_ns));
                write!(formatter, "{}", time.unwrap_or_default())
            }
        }
    }
}

impl Moment {
    /// Whether it is after the other; false if one has seconds and the other a date.
    fn is_after(self, other: Self) -> bool {
        match (self, other) {
            (Self::Seconds(one), Self::Seconds(other)) => one > other,
            (Self::WallNs(one), Self::WallNs(other)) => one > other,
            _ => false,
        }
    }

    /// The moment in ns since a start at `start_wall_ns`; none if it is on the
    /// wall and the start is not known there.
    fn since(self, start_wall_ns: Option<u64>) -> Option<i64> {
        match self {
            // Saturates, which is as good as never or ever.
            Self::Seconds(seconds) => Some((seconds * 1e9) as i64),
            Self::WallNs(wall_ns) => {
                Some(wall_ns.saturating_sub(i64::try_from(start_wall_ns?).unwrap_or(i64::MAX)))
            }
        }
    }
}

/// ISO 8601 with a zone, in ns since 1970: `2026-11-21T12:00:00.25+01:00`.
fn wall_ns(text: &str) -> Option<i64> {
    let offset = text.rfind(['+', '-']).and_then(|sign| text.get(sign + 1..));
    // An offset has its colon, as in RFC 3339; the library accepts it without.
    if offset.is_some_and(|offset| offset.len() == 4) {
        return None;
    }
    let time: Timestamp = text.parse().ok()?;
    i64::try_from(time.as_nanosecond()).ok()
}

impl Times {
    /// The times of the first and the last row in seconds, and the same times on the wall.
    fn span(&self) -> Option<String> {
        let [first_ns, last_ns] = self.span_ns?;
        let start_ns = i64::try_from(self.start_wall_ns?).unwrap_or(i64::MAX);
        // To a millisecond, as the seconds.
        let wall = |ns| Moment::WallNs(start_ns.saturating_add(ns) / 1_000_000 * 1_000_000);
        let [first_s, last_s] = [first_ns, last_ns].map(|ns| ns as f64 / 1e9);
        let (first, last) = (wall(first_ns), wall(last_ns));
        Some(format!(
            "{first_s:.3} s to {last_s:.3} s ({first} to {last})"
        ))
    }
}

/// The range of time of the rows that are printed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Range {
    pub(super) from: Option<Moment>,
    pub(super) to: Option<Moment>,
}

impl Range {
    /// Refuses a range that ends before it begins, as far as that is known without the source.
    pub(super) fn check_order(self) -> Result<(), String> {
        match (self.from, self.to) {
            (Some(from), Some(to)) if from.is_after(to) => Err(backwards(from, to, "")),
            _ => Ok(()),
        }
    }

    /// The range in ns since the start of the source. One without an entry of the source is refused.
    pub(super) fn since(
        self,
        times: &Times,
        name: &str,
    ) -> Result<(Option<i64>, Option<i64>), String> {
        let since = |moment: Moment| moment.since(times.start_wall_ns);
        let span = times.span().unwrap_or_default();
        let [first_ns, last_ns] = times.span_ns.unwrap_or([i64::MIN, i64::MAX]);
        // One may be a date and the other a number of seconds.
        if let (Some(from), Some(to)) = (self.from, self.to)
            && since(from)
                .zip(since(to))
                .is_some_and(|(from, to)| from > to)
        {
            let of_record = format!("; the entries of the record are from {span}");
            let of_record = if span.is_empty() { "" } else { &of_record };
            return Err(backwards(from, to, of_record));
        }
        let check = |option: &str, moment: Option<Moment>, is_outside: &dyn Fn(i64) -> bool| {
            let Some(moment) = moment else {
                return Ok(None);
            };
            match since(moment) {
                None => Err(format!(
                    "{name} holds no wall time: give --{option} in seconds since its start"
                )),
                Some(ns) if is_outside(ns) => Err(format!(
                    "--{option} {moment} leaves nothing of {name}: its entries are from {span}"
                )),
                since => Ok(since),
            }
        };
        let from_ns = check("from", self.from, &|ns| ns > last_ns)?;
        let to_ns = check("to", self.to, &|ns| ns < first_ns)?;
        Ok((from_ns, to_ns))
    }
}

/// The range ends before it begins; `of_record` names the times of the record.
fn backwards(from: Moment, to: Moment, of_record: &str) -> String {
    format!("--from {from} is after --to {to}: give the earlier time to --from{of_record}")
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test may fail")]
mod tests {
    use super::*;

    #[test]
    fn seconds_and_dates_are_understood() {
        let wall = |seconds: i64, ns: i64| Moment::WallNs(seconds * 1_000_000_000 + ns);
        for (text, expected) in [
            ("12.5", Moment::Seconds(12.5)),
            ("0", Moment::Seconds(0.0)),
            ("1970-01-01T00:00:00Z", wall(0, 0)),
            ("2000-02-29T00:00:00Z", wall(951_782_400, 0)),
            ("2000-03-01T00:00:00Z", wall(951_868_800, 0)),
            ("2026-11-21T12:00:00.25Z", wall(1_795_262_400, 250_000_000)),
            ("2026-11-21 13:00:00+01:00", wall(1_795_262_400, 0)),
            ("2026-11-21T03:30-0830", wall(0, 0)),
        ] {
            if text.ends_with("0830") {
                // RFC 3339 has a colon in the zone.
                assert!(text.parse::<Moment>().is_err());
            } else {
                assert_eq!(text.parse::<Moment>().unwrap(), expected, "{text}");
            }
        }
    }

    #[test]
    fn what_is_no_moment_is_refused_with_what_would_be() {
        for text in [
            "",
            "soon",
            "inf",
            "NaN",
            "2026-11-21",
            "2026-11-21T12:00:00",
            "2026-13-21T12:00:00Z",
            "2026-11-21T25:00:00Z",
            "2026-11-21T12:00:00.Z",
            "2026-11-21T12:00:00+é1:00",
        ] {
            let error = text.parse::<Moment>().unwrap_err().to_string();
            assert!(error.contains("use seconds since the start"), "{error}");
        }
    }

    #[test]
    fn there_is_nothing_before_the_start() {
        for text in ["-1", "-0.001"] {
            let error = text.parse::<Moment>().unwrap_err();
            assert!(error.contains("nothing before the start"), "{error}");
        }
    }

    #[test]
    fn moments_of_a_kind_are_ordered_and_print_as_they_are_written() {
        let moment = |text: &str| text.parse::<Moment>().unwrap();
        let (early, late) = (
            moment("2026-11-21T12:00:00Z"),
            moment("2026-11-21T14:00:00+01:00"),
        );
        assert!(late.is_after(early) && !early.is_after(late) && !early.is_after(early));
        assert!(moment("10").is_after(moment("5")) && !moment("10").is_after(early));
        assert_eq!(late.to_string(), "2026-11-21T13:00:00Z");
        assert_eq!(moment("12.50").to_string(), "12.5");
    }

    #[test]
    fn a_moment_on_the_wall_needs_a_start_on_the_wall() {
        assert_eq!(Moment::Seconds(1.5).since(None), Some(1_500_000_000));
        assert_eq!(Moment::WallNs(1_000).since(None), None);
        assert_eq!(Moment::WallNs(1_000).since(Some(400)), Some(600));
    }
}
