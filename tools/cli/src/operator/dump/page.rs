//! The statistics as a page for a person.

use core::fmt;

use super::stats::{BoardCounters, Durations, ModeSpan, Report};

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
        if let Some(lateness) = self.lateness.as_ref().filter(|_| !self.brief) {
            write!(page, "\n\nlateness of ticks, in us")?;
            distribution(page, lateness)?;
        }
        let latency = self.capture_to_command.as_ref();
        if let Some(latency) = latency.filter(|_| !self.brief) {
            write!(
                page,
                "\n\nfrom mid-exposure to the command leaving, in us (ticks with a new pose)"
            )?;
            distribution(page, latency)?;
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
            write!(
                page,
                "\n\ntelemetry lost on the line: {} of {}",
                line.telemetry_lost,
                line.telemetry_lost + self.count_of("telemetry"),
            )?;
            if let (Some(gap_ms), Some(at_s)) = (line.longest_gap_ms, line.longest_gap_at_s) {
                write!(
                    page,
                    " (in {} gaps, the longest {gap_ms:.1} ms at {at_s:.3} s)",
                    line.gaps
                )?;
            }
            if line.board_restarts > 0 {
                write!(page, "; the board restarted {} times", line.board_restarts)?;
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
            let names = BoardCounters::NAMES.map(|name| name.replace('_', " "));
            let named = counts(names.iter().zip(&board.counts));
            write!(page, "\nthe board counted: {named}")?;
            let [_, _, drives_refused, ..] = board.counts;
            if let Some(refusal) = board.last_refusal.filter(|_| drives_refused > 0) {
                write!(page, " (the last refusal: {refusal})")?;
            }
        }
        if let Some(poses) = &self.poses {
            write!(
                page,
                "\nposes: {}; {} frames missing",
                counts(&poses.states),
                poses.frames_missing
            )?;
            if let (Some(gap_ms), Some(at_s)) = (
                poses.longest_between_valid_ms,
                poses.longest_between_valid_at_s,
            ) {
                write!(
                    page,
                    "; at most {gap_ms:.1} ms between valid ones, at {at_s:.3} s"
                )?;
            }
        }
        if let Some(ticks) = &self.ticks {
            write!(
                page,
                "\nticks: {} skipped, {} events dropped, {} without a new pose, {} commands not written",
                ticks.skipped,
                ticks.events_dropped,
                ticks.without_new_pose,
                ticks.commands_not_written,
            )?;
        }
        if self.count_of("tick") > 0 || self.entries_dropped > 0 {
            write!(
                page,
                "\nentries that did not reach the record: {}",
                self.entries_dropped
            )?;
        }
        if self.missed > 0 {
            write!(
                page,
                "\nmissed, because they came faster than they were taken: {}",
                self.missed
            )?;
        }
        Ok(())
    }

    fn count_of(&self, name: &str) -> u64 {
        self.topics
            .iter()
            .find(|topic| topic.topic == name)
            .map_or(0, |topic| topic.count)
    }
}

fn counts<'a>(counts: impl IntoIterator<Item = (&'a String, &'a u64)>) -> String {
    let counts: Vec<_> = counts
        .into_iter()
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
