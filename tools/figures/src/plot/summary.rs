//! A drive in a few lines.

use jiff::Timestamp;
use singletrack_control::statistics::Distribution;
use singletrack_pilot::{Mode, Reason};
use singletrack_record::{ClockMapping, Level, Meta, seconds_since};
use toml::{Table, Value};

use super::{
    drive::{Change, Drive},
    read::Record,
};

/// A line of the summary: a name and a value.
pub(super) type Line = (&'static str, String);

/// The summary of a drive of a record; `number` counts from 1.
pub(super) fn lines(record: &Record, number: usize, drive: &Drive) -> Vec<Line> {
    let mut lines = Vec::new();
    let mut add = |name, value: Option<String>| {
        lines.extend(value.map(|value| (name, value)));
    };
    let recording = &record.recording;
    let ticks = &drive.ticks;
    add("begun", begun(record, drive));
    let which = match recording.drives.len() {
        1 => String::new(),
        count => format!("; drive {number} of {count} in the record"),
    };
    let (duration, followed) = (drive.duration(), drive.followed());
    let duration =
        format!("{duration:.2} s, of which P followed its reference for {followed:.2} s{which}");
    add("duration", Some(duration));
    add("ended", Some(ended(record, drive)));
    let estimated = ticks.iter().map(|tick| (tick.time, tick.error()));
    add("tracking error", errors(drive, estimated));
    let truth = drive.truth.iter();
    let real = truth.map(|sample| (sample.time, drive.true_error(sample)));
    add("true tracking error", errors(drive, real));
    let speed = Distribution::of(ticks.iter().map(|tick| tick.speed));
    let speed = speed.quantile(0.5).zip(speed.max());
    let text = |(p50, most)| format!("{p50:.3} m/s at the median, {most:.3} m/s at most");
    add("speed", speed.map(text));
    let held = ticks.iter().filter(|tick| tick.held).count();
    let missing: usize = ticks.iter().map(|tick| tick.poses_missing as usize).sum();
    let lost = drive.lost_markers();
    let longest = lost.iter().map(|[from, to]| to - from).fold(0.0, f64::max);
    let longest = format!("for {:.0} ms at most", longest * 1000.0);
    let (held, missing) = (many(held, "tick"), many(missing, "frame"));
    let poses = format!("{missing} without a valid pose, {held} held the last one");
    let markers = match lost.len() {
        0 => format!("never lost; {held} without a new pose"),
        1 => format!("lost once, {longest}; {poses}"),
        times => format!("lost {times} times, {longest}; {poses}"),
    };
    add("markers", Some(markers));
    let skipped: usize = ticks.iter().map(|tick| tick.skipped as usize).sum();
    let skipped = many(skipped, "deadline");
    add("ticks", Some(format!("{}, {skipped} missed", ticks.len())));
    let percentiles = |values: Distribution, unit, decimals: usize| {
        let (p50, p99) = (values.quantile(0.5)?, values.quantile(0.99)?);
        let most = values.max()?;
        Some(format!(
            "{p50:.decimals$} {unit} at the median, {p99:.decimals$} {unit} at 99 %, \
             {most:.decimals$} {unit} at most"
        ))
    };
    if !drive.is_never_late() {
        let lateness = Distribution::of(ticks.iter().map(|tick| tick.lateness * 1e6));
        add("lateness", percentiles(lateness, "µs", 0));
    }
    let latency = Distribution::of(ticks.iter().map(|tick| tick.latency * 1e3));
    add("capture to command", percentiles(latency, "ms", 1));
    for (name, value) in configured(&record.settings(drive)) {
        add(name, Some(value));
    }
    add("versions", Some(versions(&record.meta)));
    let seed = record.meta.seed.map(|seed| seed.to_string());
    add("seed of the simulation", seed);
    let levels = recording.log.iter().map(|log| log.level);
    let count = |level| levels.clone().filter(|own| *own == level).count();
    let (warnings, errors) = (count(Level::Warning), count(Level::Error));
    let log = format!("{}, {}", many(warnings, "warning"), many(errors, "error"));
    add("log", Some(log));
    lines
}

fn many(count: usize, what: &str) -> String {
    format!("{count} {what}{}", if count == 1 { "" } else { "s" })
}

/// The reason of a mode in brackets, if it has one.
pub fn because(reason: Option<Reason>) -> String {
    reason.map_or_else(String::new, |reason| format!(" ({reason})"))
}

/// The changes of mode in a drive, up to the one that ended it.
pub(super) fn changes<'a>(record: &'a Record, drive: &Drive) -> Vec<(f64, &'a Change)> {
    let seconds = |time_ns: u64| seconds_since(drive.start_ns, time_ns);
    let mut changes = Vec::new();
    for change in &record.recording.changes {
        let time = seconds(change.time_ns);
        if time < -1e-9 {
            continue;
        }
        changes.push((time, change));
        if !change.mode.commands() {
            break;
        }
    }
    changes
}

/// The time of day; a virtual drive has none.
pub(super) fn begun(record: &Record, drive: &Drive) -> Option<String> {
    let start = record.meta.start;
    (start != ClockMapping::VIRTUAL)
        .then(|| format!("{} UTC", utc(start.wall_ns_at(drive.start_ns))))
}

pub(super) fn ended(record: &Record, drive: &Drive) -> String {
    let follows = |mode| matches!(mode, Mode::Driving | Mode::Slowing);
    let mut changes = changes(record, drive).into_iter();
    let stop = changes.find(|(_, change)| !follows(change.mode));
    let stopped = stop.map_or_else(
        || "never stopped".to_owned(),
        |(time, change)| match (change.mode, change.reason) {
            (Mode::Stopping, Some(Reason::Requested)) => {
                format!("stopped on request at {time:.2} s")
            }
            (Mode::Stopping, reason) => format!("stopped at {time:.2} s{}", because(reason)),
            (mode, reason) => format!("{mode} at {time:.2} s{}", because(reason)),
        },
    );
    match drive.ended {
        None => format!("{stopped}; the record ends while the car is driven"),
        Some((mode, _)) if stop.is_none_or(|(_, change)| change.mode != mode) => {
            format!("{stopped}; then {mode}")
        }
        Some(_) => stopped,
    }
}

/// Errors at their times, over the whole drive and over its second half, when P is
/// no longer on its way to the reference.
fn errors(drive: &Drive, timed: impl Iterator<Item = (f64, f64)>) -> Option<String> {
    let timed: Vec<(f64, f64)> = timed.collect();
    let half = drive.followed() / 2.0;
    let all = Distribution::of(timed.iter().map(|(_, error)| *error));
    let late = timed.iter().filter(|(time, _)| *time >= half);
    let late = Distribution::of(late.map(|(_, error)| *error));
    let text = |errors: &Distribution| {
        let [rms, most] = [errors.root_mean_square()?, errors.max()?].map(|error| error * 1000.0);
        Some(format!("{rms:.1} mm RMS, {most:.1} mm at most"))
    };
    Some(format!(
        "{}; in the second half {}",
        text(&all)?,
        text(&late)?
    ))
}

/// The most important values of the configuration, if it has them.
fn configured(table: &Table) -> Vec<(&'static str, String)> {
    let number = |section: &str, key: &str| table.get(section)?.get(key)?.as_float();
    let word = |section: &str, key: &str| table.get(section)?.get(key)?.as_str();
    let mut lines = Vec::new();
    let axle = |section| number(section, "front_axle_distance_m");
    if let Some((p, believed)) = number("law", "point_distance_m").zip(axle("law")) {
        let error = axle("vehicle").map(|real| format!(" (dl = {:.4} m)", believed - real));
        let error = error.unwrap_or_default();
        let law = format!("p = {p} m, estimated l_f = {believed} m{error}");
        lines.push(("law", law));
    }
    if let Some(kind) = word("outer_loop", "kind") {
        let value = |key| Some(table.get("outer_loop")?.get(key)?.to_string());
        let gain = value("gain_per_s").map(|gain| format!(", gain {gain} 1/s"));
        let gain = gain.unwrap_or_default();
        let forward = match value("feed_forward").as_deref() {
            Some("true") => ", with feed-forward",
            _ => "",
        };
        let own = word("outer_loop", "name").zip(word("outer_loop", "version"));
        let own = own.filter(|_| kind == "own");
        let own = own.map_or_else(String::new, |(name, version)| format!(": {name} {version}"));
        lines.push(("position loop", format!("{kind}{gain}{forward}{own}")));
    }
    if let Some(kind) = word("reference", "kind") {
        let rest = table.get("reference").and_then(Value::as_table);
        let rest = rest.into_iter().flatten().filter(|(key, _)| *key != "kind");
        let rest = rest.map(|(key, value)| format!("{key} = {value}"));
        let rest: Vec<String> = rest.filter(|line| !line.contains('\n')).collect();
        let rest = rest.join(", ");
        // A long list of steps is in the configuration.
        let rest = if rest.len() > 160 { "" } else { &rest };
        let gap = if rest.is_empty() { "" } else { ": " };
        lines.push(("reference", format!("{kind}{gap}{rest}")));
    }
    lines
}

fn versions(meta: &Meta) -> String {
    let software = meta.software.iter();
    let software = software.map(|(component, version)| format!("{component} {version}"));
    let mut parts: Vec<String> = software.collect();
    parts.push(format!("protocol {}", meta.protocol_version));
    parts.join(", ")
}

/// A time on the wall in UTC, as `2025-01-31 23:59:59`.
fn utc(wall_ns: u64) -> String {
    // All that fits into 64 bits is within the calendar: 1970 to 2554.
    Timestamp::from_nanosecond(i128::from(wall_ns))
        .unwrap_or_default()
        .strftime("%Y-%m-%d %H:%M:%S")
        .to_string()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dates_are_those_of_the_calendar() {
        const SECOND_NS: u64 = 1_000_000_000;
        assert_eq!(utc(0), "1970-01-01 00:00:00");
        assert_eq!(utc(951_782_399 * SECOND_NS), "2000-02-28 23:59:59");
        assert_eq!(utc(951_782_400 * SECOND_NS), "2000-02-29 00:00:00");
        assert_eq!(utc(1_700_000_000 * SECOND_NS), "2023-11-14 22:13:20");
        assert_eq!(utc(4_107_542_400 * SECOND_NS), "2100-03-01 00:00:00");
    }

    #[test]
    fn the_summary_states_the_law_with_its_error() {
        let settings = |text: &str| text.parse::<Table>().unwrap_or_default();
        let lines = configured(&settings(
            "[law]\npoint_distance_m = 0.35\nfront_axle_distance_m = 0.26\n\
             [vehicle]\nfront_axle_distance_m = 0.1368\n\
             [reference]\nkind = \"circle\"\nradius_m = 1.0\n",
        ));
        assert_eq!(
            lines,
            [
                (
                    "law",
                    "p = 0.35 m, estimated l_f = 0.26 m (dl = 0.1232 m)".to_owned()
                ),
                ("reference", "circle: radius_m = 1.0".to_owned()),
            ]
        );
        assert_eq!(configured(&settings("not TOML [")), []);
    }
}
