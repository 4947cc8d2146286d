//! Schedules of marker losses: periodic (`200ms@2s`) and single.

use core::{fmt, str::FromStr};

use serde::{Deserialize, Deserializer, Serialize, Serializer};

/// Periodic losses: of `duration_us` at every multiple of `interval_us`, starting
/// at `interval_us`.
///
/// The text form is `DURATION@INTERVAL`, for example `200ms@2s`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LossPattern {
    /// Duration of a loss, in µs.
    pub duration_us: u64,
    /// Time between the starts of two losses, in µs.
    pub interval_us: u64,
}

/// Why a loss pattern or a duration is none.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct LossPatternError(String);

impl LossPattern {
    /// A pattern with a loss of `duration_us` at every multiple of `interval_us`.
    ///
    /// # Errors
    ///
    /// If one is zero, or the duration is not shorter than the interval.
    pub fn new(duration_us: u64, interval_us: u64) -> Result<Self, LossPatternError> {
        for (name, value) in [("duration", duration_us), ("interval", interval_us)] {
            if value == 0 {
                return Err(LossPatternError(format!(
                    "the {name} of a loss pattern must be at least 1 us; it is zero"
                )));
            }
        }
        if duration_us >= interval_us {
            let [duration_s, interval_s] = [duration_us, interval_us].map(|us| us as f64 / 1e6);
            return Err(LossPatternError(format!(
                "a loss of {duration_s} s at every {interval_s} s never ends: make the duration \
                 shorter than the interval"
            )));
        }
        Ok(Self {
            duration_us,
            interval_us,
        })
    }

    /// Whether the markers are lost this long after the pattern's epoch, in µs.
    pub const fn is_lost(&self, since_epoch_us: u64) -> bool {
        since_epoch_us >= self.interval_us && since_epoch_us % self.interval_us < self.duration_us
    }
}

impl FromStr for LossPattern {
    type Err = LossPatternError;

    fn from_str(text: &str) -> Result<Self, LossPatternError> {
        let form = || {
            LossPatternError(format!(
                "{text:?} is not a loss pattern: write DURATION@INTERVAL, for instance 200ms@2s"
            ))
        };
        let (duration, interval) = text.split_once('@').ok_or_else(form)?;
        if interval.contains('@') {
            return Err(form());
        }
        Self::new(parse_duration_us(duration)?, parse_duration_us(interval)?)
    }
}

/// Parses a duration such as `200ms`, `0.2s` or `1500us`; returns µs.
///
/// # Errors
///
/// The number is negative or not finite, or the unit is unknown.
pub fn parse_duration_us(text: &str) -> Result<u64, LossPatternError> {
    let error = || {
        LossPatternError(format!(
            "{text:?} is not a duration: write a number and one of us, ms, s, for instance 200ms or \
             0.2s"
        ))
    };
    let trimmed = text.trim();
    let (number, microseconds) = [("us", 1.0), ("µs", 1.0), ("ms", 1e3), ("s", 1e6)]
        .into_iter()
        .find_map(|(unit, scale)| Some((trimmed.strip_suffix(unit)?, scale)))
        .ok_or_else(error)?;
    let number = number.trim_end();
    let is_written = |byte: u8| byte.is_ascii_digit() || byte == b'.';
    if !number.bytes().all(is_written) {
        return Err(error());
    }
    let value = number.parse::<f64>().map_err(|_| error())? * microseconds;
    // A year exceeds any run, and is exact in f64.
    if value <= 3.2e13 {
        return Ok((value + 0.5) as u64);
    }
    Err(error())
}

/// Formats a duration in the largest unit without a fraction.
fn format_duration(microseconds: u64) -> String {
    match microseconds {
        us if us % 1_000_000 == 0 => format!("{}s", us / 1_000_000),
        us if us % 1_000 == 0 => format!("{}ms", us / 1_000),
        us => format!("{us}us"),
    }
}

impl fmt::Display for LossPattern {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [duration, interval] = [self.duration_us, self.interval_us].map(format_duration);
        write!(formatter, "{duration}@{interval}")
    }
}

impl Serialize for LossPattern {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

impl<'de> Deserialize<'de> for LossPattern {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let text = String::deserialize(deserializer)?;
        text.parse().map_err(serde::de::Error::custom)
    }
}

/// A single loss, in simulation time since the schedule's epoch.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LossWindow {
    /// First microsecond of the loss.
    pub start_us: u64,
    /// First microsecond after it.
    pub end_us: u64,
}

impl LossWindow {
    /// Whether the markers are lost this long after the schedule's epoch, in µs.
    pub const fn is_lost(&self, since_epoch_us: u64) -> bool {
        self.start_us <= since_epoch_us && since_epoch_us < self.end_us
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn losses_start_at_the_first_interval_and_repeat() {
        let pattern: LossPattern = "200ms@2s".parse().unwrap();
        for (ms, lost) in [
            (0, false),
            (199, false),
            (1_999, false),
            (2_000, true),
            (2_199, true),
            (2_200, false),
            (4_000, true),
            (39_999, false),
        ] {
            assert_eq!(pattern.is_lost(ms * 1_000), lost, "{ms} ms");
        }
    }

    #[test]
    fn patterns_round_trip_through_text() {
        for text in ["200ms@2s", "50ms@1s", "1500us@20ms", "1s@3s"] {
            assert_eq!(text.parse::<LossPattern>().unwrap().to_string(), text);
        }
        assert_eq!(
            "0.2s@2 s".parse::<LossPattern>(),
            LossPattern::new(200_000, 2_000_000)
        );
    }

    #[test]
    fn errors_contain_the_text_and_the_expected_form() {
        for (text, part) in [
            ("200ms", "DURATION@INTERVAL"),
            ("200ms@2s@3s", "DURATION@INTERVAL"),
            ("200@2s", "\"200\" is not a duration"),
            ("ms@2s", "\"ms\" is not a duration"),
            ("-1ms@2s", "\"-1ms\" is not a duration"),
            ("1e300s@2s", "\"1e300s\" is not a duration"),
            ("200ms@2h", "\"2h\" is not a duration"),
            ("0ms@2s", "duration of a loss pattern"),
            ("2s@2s", "never ends"),
        ] {
            let message = text.parse::<LossPattern>().unwrap_err().to_string();
            assert!(message.contains(part), "{text}: {message}");
        }
    }
}
