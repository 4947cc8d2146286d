//! The statistics as a page for a person.

use core::fmt;

use super::stats::{Durations, ModeSpan, Report};

/// The longest bar of a histogram, in characters.
const BAR: u64 = 50;
/// No more spans of modes than this are listed one by one.
const MAX_SPANS: usize = 40;

/// What a summary does not show.
const MORE: &str = "--stats adds latencies, --topic tick prints rows, --help has examples";

impl fmt::Display for Report {
    fn fmt(&self, page: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(page, "{}: {:.3} s", self.source, self.span_s)?;
        if self.unfinished {
            write!(page, ", unfinished")?;
        }
        self.topics(page)?;
        self.line(page)?;
        self.counters(page)?;
        for (title, durations) in [
            ("lateness of ticks, in us", &self.lateness),
            (
                "from mid-exposure to the command leaving, in us (ticks with a new pose)",
                &self.capture_to_command,
            ),
        ] {
            if let Some(durations) = durations.as_ref().filter(|_| !self.brief) {
                write!(page, "\n\n{title}")?;
                distribution(page, durations)?;
            }
        }
        modes(page, "modes", &self.modes)?;
        modes(page, "modes of the board", &self.board_modes)?;
        if self.brief {
            write!(page, "\n\n{MORE}")?;
        }
        Ok(())
    }
}

impl Report {
    fn topics(&self, page: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            page,
            "\n\n{:<16}{:>9}{:>10}{:>12}{:>12}{:>16}{:>12}",
            "topic", "count", "per s", "first s", "last s", "longest gap ms", "at s"
        )?;
        for topic in &self.topics {
            write!(page, "\n{:<16}{:>9}", topic.topic, topic.count)?;
            for (value, width, digits) in [
                (topic.rate_hz, 10, 2),
                (topic.first_s, 12, 3),
                (topic.last_s, 12, 3),
                (topic.longest_gap_ms, 16, 3),
                (topic.longest_gap_at_s, 12, 3),
            ] {
                match value {
                    Some(value) => write!(page, "{value:>width$.digits$}")?,
                    None => write!(page, "{:>width$}", "-")?,
                }
            }
        }
        Ok(())
    }

    fn line(&self, page: &mut fmt::Formatter<'_>) -> fmt::Result {
        let line = &self.line;
        if line.telemetry {
            let (lost, gaps, restarts) = (line.telemetry_lost, line.gaps, line.board_restarts);
            let all = lost + self.count_of("telemetry");
            write!(page, "\n\ntelemetry lost on the line: {lost} of {all}")?;
            if let (Some(ms), Some(at_s)) = (line.longest_gap_ms, line.longest_gap_at_s) {
                write!(
                    page,
                    " (in {gaps} gaps, the longest {ms:.1} ms at {at_s:.3} s)"
                )?;
            }
            if restarts > 0 {
                write!(page, "; the board restarted {restarts} times")?;
            }
        }
        if let Some(bytes) = line.bytes {
            write!(page, "\nbytes on the line: {bytes}")?;
            if let Some(rate) = line.bytes_per_s {
                write!(page, ", {rate:.0} per s")?;
            }
            write!(page, "\nbroken frames: {}", counts(&line.broken))?;
        }
        Ok(())
    }

    fn counters(&self, page: &mut fmt::Formatter<'_>) -> fmt::Result {
        if let Some(board) = &self.board {
            let counted = counts([
                ("frames received", &board.frames_received),
                ("frames damaged", &board.frames_damaged),
                ("drives refused", &board.drives_refused),
                ("frames dropped", &board.frames_dropped),
                ("bytes overrun", &board.bytes_overrun),
                ("imu errors", &board.imu_errors),
            ]);
            write!(page, "\nthe board counted: {counted}")?;
            if let Some(refusal) = board.last_refusal.filter(|_| board.drives_refused > 0) {
                write!(page, " (the last refusal: {refusal})")?;
            }
        }
        if let Some(poses) = &self.poses {
            let (states, missing) = (counts(&poses.states), poses.frames_missing);
            write!(page, "\nposes: {states}; {missing} frames missing")?;
            let longest = poses.longest_between_valid_ms;
            if let Some((ms, at_s)) = longest.zip(poses.longest_between_valid_at_s) {
                write!(
                    page,
                    "; at most {ms:.1} ms between valid ones, at {at_s:.3} s"
                )?;
            }
        }
        if let Some(ticks) = &self.ticks {
            let counted = counts([
                ("skipped", &ticks.skipped),
                ("events dropped", &ticks.events_dropped),
                ("without a new pose", &ticks.without_new_pose),
                ("commands not written", &ticks.commands_not_written),
            ]);
            write!(page, "\nticks: {counted}")?;
        }
        let (dropped, missed) = (self.entries_dropped, self.missed);
        if self.count_of("tick") > 0 || dropped > 0 {
            write!(page, "\nentries that did not reach the record: {dropped}")?;
        }
        if missed > 0 {
            let why = "because they came faster than they were taken";
            write!(page, "\nmissed, {why}: {missed}")?;
        }
        Ok(())
    }

    fn count_of(&self, name: &str) -> u64 {
        let topic = self.topics.iter().find(|topic| topic.topic == name);
        topic.map_or(0, |topic| topic.count)
    }
}

fn counts<'a, T: fmt::Display>(counts: impl IntoIterator<Item = (T, &'a u64)>) -> String {
    let counts = counts.into_iter();
    let counts: Vec<_> = counts
        .map(|(what, count)| format!("{count} {what}"))
        .collect();
    match counts.as_slice() {
        [] => "none".to_owned(),
        counts => counts.join(", "),
    }
}

fn distribution(page: &mut fmt::Formatter<'_>, of: &Durations) -> fmt::Result {
    write!(page, "\n ")?;
    for (name, value) in [
        ("min", of.min),
        ("p50", of.p50),
        ("p90", of.p90),
        ("p99", of.p99),
        ("p99.9", of.p999),
        ("max", of.max),
    ] {
        write!(page, " {name} {value:.1}")?;
    }
    let most = of.histogram.iter().map(|bucket| bucket.count).max();
    for bucket in &of.histogram {
        write!(page, "\n  up to {:>9} {:>9}", bucket.up_to, bucket.count)?;
        // Every bucket that is not empty has a bar.
        let bar = (bucket.count * BAR).div_ceil(most.unwrap_or(1).max(1));
        if bar > 0 {
            write!(page, "  {}", "#".repeat(bar as usize))?;
        }
    }
    Ok(())
}

fn modes(page: &mut fmt::Formatter<'_>, title: &str, spans: &[ModeSpan]) -> fmt::Result {
    if spans.is_empty() {
        return Ok(());
    }
    write!(page, "\n\n{title:<20}{:>12}{:>12}  why", "from s", "for s")?;
    for span in spans.iter().take(MAX_SPANS) {
        write!(
            page,
            "\n  {:<18}{:>12.3}{:>12.3}  {}",
            span.mode,
            span.from_s,
            span.duration_s,
            span.reason.unwrap_or("-")
        )?;
    }
    if let Some(more) = spans.len().checked_sub(MAX_SPANS).filter(|more| *more > 0) {
        write!(page, "\n  and {more} more: --format json has them all")?;
    }
    Ok(())
}
