//! Moments, as people write them.

use std::str::FromStr;

/// A moment of a record.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Moment {
    /// So many seconds after the start of the record.
    Seconds(f64),
    /// On the wall, in ns since 1970.
    WallNs(i64),
}

/// It is neither a number of seconds nor a date with its time and zone.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "not a time: {0:?}; use seconds since the start (12.5), or date, time and zone (2026-11-21T12:00:00.5Z, 2026-11-21T13:00:00+01:00)"
)]
pub struct NotAMoment(String);

impl FromStr for Moment {
    type Err = NotAMoment;

    fn from_str(text: &str) -> Result<Self, NotAMoment> {
        if let Some(seconds) = text
            .parse()
            .ok()
            .filter(|seconds: &f64| seconds.is_finite())
        {
            return Ok(Self::Seconds(seconds));
        }
        wall_ns(text)
            .map(Self::WallNs)
            .ok_or_else(|| NotAMoment(text.to_owned()))
    }
}

impl Moment {
    /// The moment in ns since a start at `start_wall_ns`; none if it is on the
    /// wall and the start is not known there.
    pub(super) fn since(self, start_wall_ns: Option<u64>) -> Option<i64> {
        match self {
            // Saturates, which is as good as never or ever.
            Self::Seconds(seconds) => Some((seconds * 1e9) as i64),
            Self::WallNs(wall_ns) => {
                Some(wall_ns.saturating_sub(i64::try_from(start_wall_ns?).unwrap_or(i64::MAX)))
            }
        }
    }
}

/// ISO 8601: `2026-11-21T12:00:00.25+01:00`.
fn wall_ns(text: &str) -> Option<i64> {
    let (date, rest) = text.split_once(['T', 't', ' '])?;
    let mut parts = date.split('-');
    let year = digits(parts.next()?, 4)?;
    let month = digits(parts.next()?, 2)?;
    let day = digits(parts.next()?, 2)?;
    if parts.next().is_some() || !(1..=12).contains(&month) || !(1..=31).contains(&day) {
        return None;
    }
    let (time, offset_s) = match rest.strip_suffix(['Z', 'z']) {
        Some(time) => (time, 0),
        None => {
            let (time, zone) = rest.split_at_checked(rest.rfind(['+', '-'])?)?;
            let (sign, zone) = match zone.strip_prefix('-') {
                Some(zone) => (-1, zone),
                None => (1, zone.strip_prefix('+')?),
            };
            let (hours, minutes) = zone.split_once(':').unwrap_or((zone, "00"));
            let seconds = digits(hours, 2)? * 3_600 + digits(minutes, 2)? * 60;
            (time, sign * seconds)
        }
    };
    let (time, fraction_ns) = match time.split_once('.') {
        Some((time, fraction)) if (1..=9).contains(&fraction.len()) => {
            let value = digits(fraction, fraction.len())?;
            (time, value * 10_i64.pow(9 - fraction.len() as u32))
        }
        Some(_) => return None,
        None => (time, 0),
    };
    let mut parts = time.split(':');
    let hour = digits(parts.next()?, 2)?;
    let minute = digits(parts.next()?, 2)?;
    let second = parts.next().map_or(Some(0), |second| digits(second, 2))?;
    if parts.next().is_some() || hour > 23 || minute > 59 || second > 60 {
        return None;
    }
    let seconds =
        days_since_1970(year, month, day) * 86_400 + hour * 3_600 + minute * 60 + second - offset_s;
    seconds.checked_mul(1_000_000_000)?.checked_add(fraction_ns)
}

/// A number of exactly so many digits.
fn digits(text: &str, count: usize) -> Option<i64> {
    (text.len() == count && text.bytes().all(|byte| byte.is_ascii_digit()))
        .then(|| text.parse().ok())?
}

/// Days from 1970-01-01 in the Gregorian calendar. Years are counted from March,
/// so that the leap day is the last of its year.
fn days_since_1970(year: i64, month: i64, day: i64) -> i64 {
    let (year, month) = if month > 2 {
        (year, month - 3)
    } else {
        (year - 1, month + 9)
    };
    let leap_days = year.div_euclid(4) - year.div_euclid(100) + year.div_euclid(400);
    // Five months from March on have 153 days.
    let day_of_year = (153 * month + 2) / 5 + day - 1;
    365 * year + leap_days + day_of_year - 719_468
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
            ("-1", Moment::Seconds(-1.0)),
            ("1970-01-01T00:00:00Z", wall(0, 0)),
            ("2000-02-29T00:00:00Z", wall(951_782_400, 0)),
            ("2000-03-01T00:00:00Z", wall(951_868_800, 0)),
            ("2026-11-21T12:00:00.25Z", wall(1_795_262_400, 250_000_000)),
            ("2026-11-21 13:00:00+01:00", wall(1_795_262_400, 0)),
            ("2026-11-21T03:30-0830", wall(0, 0)),
        ] {
            if text.ends_with("0830") {
                // A zone without its colon is not what anybody writes.
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
    fn a_moment_on_the_wall_needs_a_start_on_the_wall() {
        assert_eq!(Moment::Seconds(1.5).since(None), Some(1_500_000_000));
        assert_eq!(Moment::WallNs(1_000).since(None), None);
        assert_eq!(Moment::WallNs(1_000).since(Some(400)), Some(600));
    }
}
