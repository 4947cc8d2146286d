//! The table of the added delays that diverge.

use std::fmt::Write as _;

use super::{
    counted::DriveResult,
    drive::{DIVERGED, LONGEST_DELAY_MS},
    plan::{Comparison, Row},
    stops::StopReasons,
    table::{by_row, interval},
};

/// The names of the columns, in order.
pub const DELAYS_HEADER: &str = "controller,path,speed_m_s,seeds,delay_ms,delay_low_ms,delay_high_ms,least_ms,beyond,\
                                 ended_by";

/// The least added delay with which a controller diverges.
#[derive(Clone, Debug, PartialEq)]
pub struct DelayLine {
    pub(super) row: Row,
    seeds: usize,
    /// The mean over the seeds, in ms; those that stand the longest count as that.
    pub(super) mean_ms: f64,
    /// The interval of 95 % of the mean, in ms.
    pub(super) interval_ms: [f64; 2],
    /// The least of all seeds, in ms.
    least_ms: f64,
    /// Seeds that stand the longest delay that is tried.
    pub(super) beyond: usize,
    /// How the drives with these delays ended, the commonest first.
    ended_by: StopReasons,
}

/// A line per row whose delay was searched.
#[must_use]
pub fn delays(plan: &Comparison, results: &[(u64, DriveResult)]) -> Vec<DelayLine> {
    let mut lines = Vec::new();
    for (row, results) in by_row(plan, results) {
        let found = || {
            results
                .iter()
                .filter_map(|(_, result)| result.added_delay.as_ref())
        };
        let ended_by = StopReasons::of(found().filter_map(|delay| delay.ended_by.as_deref()));
        let found: Vec<Option<u32>> = found().map(|delay| delay.diverges_ms).collect();
        let delays = found.iter().map(|found| found.unwrap_or(LONGEST_DELAY_MS));
        let delays: Vec<f64> = delays.map(f64::from).collect();
        if delays.is_empty() {
            continue;
        }
        lines.push(DelayLine {
            row,
            seeds: delays.len(),
            mean_ms: delays.iter().sum::<f64>() / delays.len() as f64,
            interval_ms: interval(&delays),
            least_ms: delays.iter().copied().fold(f64::INFINITY, f64::min),
            beyond: found.iter().filter(|found| found.is_none()).count(),
            ended_by,
        });
    }
    lines
}

/// For programs.
#[must_use]
pub fn delays_csv(lines: &[DelayLine]) -> String {
    let mut text = format!("{DELAYS_HEADER}\n");
    for line in lines {
        let [low, high] = line.interval_ms;
        // Writing to a string does not fail.
        let _ = writeln!(
            text,
            "{},{},{},{},{},{low},{high},{},{},{}",
            line.row.controller,
            line.row.path,
            line.row.speed_m_s,
            line.seeds,
            line.mean_ms,
            line.least_ms,
            line.beyond,
            line.ended_by.commonest()
        );
    }
    text
}

/// For a page: a table with a row per path and speed, and a column per controller. Empty if no
/// delay was searched.
#[must_use]
pub fn delays_markdown(lines: &[DelayLine]) -> String {
    let mut text = String::new();
    let Some(first) = lines.first() else {
        return text;
    };
    let case = |line: &DelayLine| (line.row.path, line.row.speed_m_s);
    let head = lines.iter().take_while(|line| case(line) == case(first));
    let names: Vec<&str> = head.map(|line| line.row.controller.name()).collect();
    let _ = writeln!(
        text,
        "Least added delay that diverges, in ms\n\n| path | m/s | {} |\n|---|---|{}",
        names.join(" | "),
        "---|".repeat(names.len())
    );
    for group in lines.chunk_by(|a, b| case(a) == case(b)) {
        let cells = group.iter().map(|line| {
            let more = if line.beyond > 0 { "> " } else { "" };
            let ended_by = match line.ended_by.commonest() {
                "" | DIVERGED => String::new(),
                reason => format!(" ({reason})"),
            };
            format!("{more}{:.0}{ended_by}", line.mean_ms)
        });
        let cells: Vec<String> = cells.collect();
        if let Some(line) = group.first() {
            let (path, speed) = (line.row.path, line.row.speed_m_s);
            let _ = writeln!(text, "| {path} | {speed} | {} |", cells.join(" | "));
        }
    }
    text.push('\n');
    text
}
