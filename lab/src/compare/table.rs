//! The table of a comparison and its picture, and that of the added delays that diverge.

use std::{collections::BTreeMap, fmt::Write as _};

use singletrack_control::statistics::{Distribution, Random};
use singletrack_figures::figure::{Axis, Estimate, Figure, Mark, MarkKind, Panel};

use super::{
    controller::ControllerName,
    counted::{DriveResult, Effort, Errors},
    drive::{Condition, DIVERGED, LONGEST_DELAY_MS, WORST},
    plan::{Comparison, Row},
};

/// The names of the columns, in order.
pub const HEADER: &str = "controller,path,speed_m_s,condition,seeds,rms_m,rms_low_m,rms_high_m,\
                          p99_m,max_m,along_rms_m,across_rms_m,tyre_use_max,stops,\
                          steering_rate_rms_rad_s,steering_rate_max_rad_s,speed_ripple_m_s,\
                          worst_condition,rank,stop_reasons";

/// RMS that differ by less count as the same, in m: half of the noise of the cameras.
const FLOOR_M: f64 = 1e-4;

/// A line of the table.
#[derive(Clone, Debug, PartialEq)]
pub struct Line {
    pub(super) row: Row,
    /// The name of the controller.
    pub(super) name: String,
    /// What it is the worst of; the condition is that of the row.
    pub(super) worst_of: Option<&'static str>,
    /// The root mean square of each seed that was driven to the end, in m.
    rms_of: Vec<(u64, f64)>,
    /// The place among the controllers of the case; those that can't be told apart from the first of
    /// a place share it. None if no drive came to the end, or if one seed tells nothing.
    rank: Option<usize>,
    /// Whether the errors are those of the front axle, not of the controller's own point.
    pub(super) front_axle: bool,
    seeds: usize,
    /// Over the seeds that were driven to the end, in m: the mean of the root mean squares with its
    /// interval of 95 %, the mean of what 1 % of the time exceeds, the largest error of all, and the
    /// means along and across the path. Of all seeds the largest use of the tyres.
    pub(super) values: [Option<f64>; 8],
    /// Means, but the largest of all steering rates.
    effort: [Option<f64>; 3],
    stops: usize,
    stop_reasons: StopReasons,
}

/// Results by the rows they belong to, in the order of the rows. A shard has a part of the
/// seeds.
fn by_row<'a>(
    plan: &Comparison,
    results: &'a [(u64, DriveResult)],
) -> Vec<(Row, Vec<(u64, &'a DriveResult)>)> {
    let mut results = results.iter().peekable();
    let mut end = 0;
    let rows = plan.rows().map(|row| {
        end += plan.seeds_under(row.condition);
        let mut own = Vec::new();
        while let Some((unit, result)) = results.next_if(|(unit, _)| *unit < end) {
            // The same number is the same seed in every row of a condition.
            own.push((end - unit, result));
        }
        (row, own)
    });
    rows.filter(|(_, own)| !own.is_empty()).collect()
}

/// Two lines per row: the front axle, then the controller's own point. After those of a path and
/// a speed, the worst of some conditions for each controller.
pub fn lines(plan: &Comparison, results: &[(u64, DriveResult)]) -> Vec<Line> {
    let rows = by_row(plan, results);
    let rows: Vec<_> = rows
        .iter()
        .filter(|(row, _)| row.condition != Condition::AddedDelay)
        .collect();
    let mut lines: Vec<Line> = Vec::new();
    for group in rows.chunk_by(|(a, _), (b, _)| a.path == b.path && a.speed_m_s == b.speed_m_s) {
        let first = lines.len();
        for (row, own) in group {
            lines.extend([true, false].map(|front_axle| Line::of(*row, front_axle, own)));
        }
        for (worst, conditions) in WORST {
            for &controller in &plan.controllers {
                for front_axle in [true, false] {
                    let of_it = |line: &&Line| {
                        line.row.controller == controller
                            && line.front_axle == front_axle
                            && line.worst_of.is_none()
                            && conditions.contains(&line.row.condition)
                    };
                    let candidates = || lines.iter().skip(first).filter(of_it);
                    let found = candidates().max_by(|a, b| {
                        let by_stops = a.stops.cmp(&b.stops);
                        by_stops.then(a.rms().total_cmp(&b.rms()))
                    });
                    // A single one has its line.
                    if candidates().count() > 1
                        && let Some(found) = found.cloned()
                    {
                        lines.push(Line {
                            worst_of: Some(worst),
                            ..found
                        });
                    }
                }
            }
        }
    }
    rank(&mut lines);
    lines
}

/// Lines in which the program's own controller has this name.
pub fn lines_with(plan: &Comparison, results: &[(u64, DriveResult)], yours: &str) -> Vec<Line> {
    let mut lines = lines(plan, results);
    for line in &mut lines {
        if line.row.controller == ControllerName::Yours.into() {
            yours.clone_into(&mut line.name);
        }
    }
    lines
}

/// Gives every line its place among those of its case.
fn rank(lines: &mut [Line]) {
    let case = |line: &Line| {
        let Row {
            path, speed_m_s, ..
        } = line.row;
        (path.name(), speed_m_s.to_bits(), line.condition())
    };
    let mut order: Vec<usize> = (0..lines.len()).collect();
    order.sort_by(|&a, &b| {
        let [a, b] = [a, b].map(|index| &lines[index]);
        let by_case = case(a).cmp(&case(b)).then(a.stops.cmp(&b.stops));
        by_case.then(a.rms().total_cmp(&b.rms()))
    });
    let is_same_case = |&a: &usize, &b: &usize| case(&lines[a]) == case(&lines[b]);
    let cases: Vec<&[usize]> = order.chunk_by(is_same_case).collect();
    for of_case in cases {
        let mut head = None;
        let mut place = 0;
        for (index, &line) in of_case.iter().enumerate() {
            if !lines[line].is_told() {
                continue;
            }
            if head.is_none_or(|head: usize| !lines[line].is_same(&lines[head])) {
                head = Some(line);
                place = index + 1;
            }
            lines[line].rank = Some(place);
        }
    }
}

impl Line {
    /// Whether it can be compared: some drives came to the end, more than one if chance has a part.
    fn is_told(&self) -> bool {
        let least = if self.row.condition == Condition::IdealPlant {
            1
        } else {
            2
        };
        self.rms_of.len() >= least
    }

    /// Whether the two rows can't be ranked: equal stops, and a paired difference that is below the
    /// floor or whose interval contains zero.
    fn is_same(&self, other: &Self) -> bool {
        if self.stops != other.stops {
            return false;
        }
        let differences = self.rms_of.iter().filter_map(|(seed, rms)| {
            let theirs = other.rms_of.iter().find(|(theirs, _)| theirs == seed);
            theirs.map(|(_, theirs)| rms - theirs)
        });
        let differences: Vec<f64> = differences.collect();
        let [low, high] = interval(&differences);
        (self.rms() - other.rms()).abs() < FLOOR_M || !(low > 0.0 || high < 0.0)
    }

    fn of(row: Row, front_axle: bool, results: &[(u64, &DriveResult)]) -> Self {
        let driven = results.iter();
        let driven = driven.filter(|(_, result)| result.stopped.is_none());
        let own = driven.clone().filter_map(|(seed, result)| {
            let [front, own] = [result.front_axle, result.own];
            Some((*seed, if front_axle { front? } else { own? }))
        });
        let (seeds, errors): (Vec<u64>, Vec<Errors>) = own.unzip();
        let efforts: Vec<Effort> = driven.filter_map(|(_, result)| result.effort).collect();
        let rms: Vec<f64> = errors.iter().map(|errors| errors.rms).collect();
        let [low, high] = interval(&rms).map(|end| (!rms.is_empty()).then_some(end));
        let along = mean(&errors, |errors| errors.along_rms);
        let stopped = results.iter();
        let stopped = stopped.filter_map(|(_, result)| result.stopped.as_deref());
        Self {
            row,
            name: row.controller.name().to_owned(),
            worst_of: None,
            rms_of: seeds.into_iter().zip(rms).collect(),
            rank: None,
            front_axle,
            seeds: results.len(),
            values: [
                mean(&errors, |errors| errors.rms),
                low,
                high,
                mean(&errors, |errors| errors.p99),
                most(&errors, |errors| errors.max),
                along.filter(|_| !front_axle),
                mean(&errors, |errors| errors.across_rms),
                most(results, |(_, result)| result.tyre_use_max),
            ],
            effort: [
                mean(&efforts, |effort| effort.steering_rate_rms),
                most(&efforts, |effort| effort.steering_rate_max),
                mean(&efforts, |effort| effort.speed_ripple),
            ],
            stops: results.len() - errors.len(),
            stop_reasons: StopReasons::of(stopped),
        }
    }

    /// Infinite if no drive came to the end.
    fn rms(&self) -> f64 {
        self.values[0].unwrap_or(f64::INFINITY)
    }

    /// The condition, or what the line is the worst of.
    fn title(&self) -> &'static str {
        self.worst_of.unwrap_or(self.row.condition.name())
    }

    fn condition(&self) -> String {
        let of = if self.front_axle { "@front-axle" } else { "" };
        format!("{}{of}", self.title())
    }
}

fn mean<T>(all: &[T], value: fn(&T) -> f64) -> Option<f64> {
    let sum: f64 = all.iter().map(value).sum();
    (!all.is_empty()).then(|| sum / all.len() as f64)
}

fn most<T>(all: &[T], value: fn(&T) -> f64) -> Option<f64> {
    all.iter().map(value).reduce(f64::max)
}

/// Number of samples of the bootstrap.
const SAMPLES: usize = 2_000;

/// The interval of 95 % of a mean, by resampling. Equal numbers of values are resampled in
/// the same way, so that differences of rows with the same seeds are those of pairs.
fn interval(values: &[f64]) -> [f64; 2] {
    let mut random = Random::new(1);
    let means = (0..SAMPLES).map(|_| {
        let drawn = values.iter().map(|_| {
            let place = random.below(values.len());
            values.get(place).copied().unwrap_or(f64::NAN)
        });
        drawn.sum::<f64>() / values.len() as f64
    });
    let means = Distribution::of(means);
    [0.025, 0.975].map(|part| means.quantile(part).unwrap_or(f64::NAN))
}

/// With every digit, for programs. A field is empty if no drive came to the end.
pub fn csv(lines: &[Line]) -> String {
    let mut text = format!("{HEADER}\n");
    for line in lines {
        let Row {
            path, speed_m_s, ..
        } = line.row;
        let controller = &line.name;
        let plain = |value: Option<f64>| value.map_or_else(String::new, |value| value.to_string());
        let (values, effort) = (line.values.map(plain), line.effort.map(plain));
        // Writing to a string does not fail.
        let _ = writeln!(
            text,
            "{controller},{path},{speed_m_s},{},{},{},{},{},{},{},{}",
            line.condition(),
            line.seeds,
            values.join(","),
            line.stops,
            effort.join(","),
            line.worst_of.map_or("", |_| line.row.condition.name()),
            line.rank.map_or_else(String::new, |rank| rank.to_string()),
            line.stop_reasons.joined(";")
        );
    }
    text
}

fn in_units(value: Option<f64>) -> String {
    value.map_or_else(|| "-".to_owned(), |value| format!("{value:.2}"))
}

/// In millimetres, for a page: a table per path, speed and condition, ranked by the distance of the
/// front axle from the path, which is the same point of the car for every controller.
pub fn markdown(lines: &[Line]) -> String {
    let mut text = String::new();
    let case = |line: &Line| {
        let Row {
            path, speed_m_s, ..
        } = line.row;
        format!("{path}, {speed_m_s} m/s, {}", line.title())
    };
    for group in lines.chunk_by(|a, b| case(a) == case(b)) {
        let (mut front, own): (Vec<_>, Vec<_>) = group.iter().partition(|line| line.front_axle);
        front.sort_by(|a, b| {
            let ranks = [a, b].map(|line| line.rank.unwrap_or(usize::MAX));
            ranks[0].cmp(&ranks[1]).then(a.rms().total_cmp(&b.rms()))
        });
        let title = group.first().map_or_else(String::new, case);
        let _ = writeln!(
            text,
            "{title}\n\n| | controller | front axle, RMS (mm) | 95 % | 99 % | largest | \
             own point, RMS (mm) | along | across | tyres | \
             steering rate, RMS and largest (rad/s) | ripple (mm/s) | stops |\n|---|---|---|---|---|---|---|---|---|---|---|---|---|"
        );
        let mut before = None;
        for line in front {
            let rank = match line.rank {
                None => "-".to_owned(),
                rank if rank == before => "same".to_owned(),
                Some(rank) => rank.to_string(),
            };
            before = line.rank;
            let mine = own
                .iter()
                .find(|own| own.row.controller == line.row.controller);
            let in_mm = |value: Option<f64>| in_units(value.map(|value| 1e3 * value));
            let [.., tyres] = line.values;
            let tyres = tyres.unwrap_or(f64::NAN);
            let [rms, low, high, p99, max, ..] = line.values.map(in_mm);
            let own = mine.map_or([None; 8], |own| own.values).map(in_mm);
            let [own, _, _, _, _, along, across, _] = own;
            let [rate, most_rate, _] = line.effort.map(in_units);
            let [.., ripple] = line.effort.map(in_mm);
            let Line { stops, seeds, .. } = line;
            let (controller, condition) = (&line.name, line.row.condition);
            let worst = line.worst_of.map(|_| format!(", {condition}"));
            let worst = worst.unwrap_or_default();
            let reasons = match stops {
                0 => String::new(),
                _ => format!(": {}", line.stop_reasons.joined(", ")),
            };
            let _ = writeln!(
                text,
                "| {rank} | {controller}{worst} | {rms} | {low} to {high} | {p99} | {max} | {own} \
                 | {along} | {across} | {tyres:.2} | {rate} and {most_rate} | {ripple} \
                 | {stops} of {seeds}{reasons} |"
            );
        }
        text.push('\n');
    }
    text
}

/// The marks of the speeds, distinguishable without colour.
const KINDS: [MarkKind; 5] = [
    MarkKind::Found,
    MarkKind::End,
    MarkKind::Square,
    MarkKind::Diamond,
    MarkKind::Start,
];
/// The part of a controller's place over which the marks of its speeds are spread.
const SPREAD: f64 = 0.72;
const HEIGHT_MM: f64 = 38.0;

/// The nominal condition: a panel per path, in it the controllers, and of each a mark per speed.
/// `None` if that condition was not driven.
pub fn figure(lines: &[Line]) -> Option<Figure> {
    let shown = lines.iter().filter(|line| {
        line.row.condition == Condition::Nominal && line.worst_of.is_none() && line.front_axle
    });
    let shown: Vec<&Line> = shown.collect();
    let mut controllers: Vec<&str> = Vec::new();
    let mut speeds: Vec<f64> = Vec::new();
    for line in &shown {
        if !controllers.contains(&line.name.as_str()) {
            controllers.push(&line.name);
        }
        if !speeds.contains(&line.row.speed_m_s) {
            speeds.push(line.row.speed_m_s);
        }
    }
    let panels = shown.chunk_by(|a, b| a.row.path == b.row.path);
    let panels: Vec<Panel> = panels
        .map(|lines| panel(lines, &controllers, &speeds))
        .collect();
    (!panels.is_empty()).then(|| {
        Figure::page(
            "RMS distance of the front axle",
            "Root mean square of the distance of the front axle from the path, mean over the \
             seeds with its 95 % interval, condition nominal.",
            panels,
        )
    })
}

fn panel(lines: &[&Line], controllers: &[&str], speeds: &[f64]) -> Panel {
    let mut panel = Panel::new(
        Axis::new("", None, ""),
        Axis::new("RMS distance", None, "mm").logarithmic(),
    );
    panel.begins_row = true;
    panel.height_mm = HEIGHT_MM;
    let path = lines.first().map(|line| line.row.path);
    panel.title = path.map_or_else(String::new, |path| path.to_string());
    panel.names = controllers.iter().map(ToString::to_string).collect();
    let place = |line: &Line| {
        let controller = controllers.iter().position(|name| *name == line.name);
        let speed = speeds.iter().position(|speed| *speed == line.row.speed_m_s);
        let (controller, speed) = (controller.unwrap_or_default(), speed.unwrap_or_default());
        let aside = (speed as f64 + 0.5) / speeds.len() as f64 - 0.5;
        (controller as f64 + SPREAD * aside, speed)
    };
    let mut stopped = Vec::new();
    for line in lines {
        let (x, speed) = place(line);
        let [Some(rms), Some(low), Some(high), ..] = line.values else {
            stopped.push(x);
            continue;
        };
        panel.estimates.push(Estimate {
            name: format!("{} m/s", line.row.speed_m_s),
            kind: KINDS[speed % KINDS.len()],
            x,
            value: 1e3 * rms,
            interval: [1e3 * low, 1e3 * high],
        });
    }
    // Those without a value stand at the upper end of the axis.
    let values = panel.estimates.iter().map(|estimate| estimate.interval[1]);
    let top = values.fold(1.0, f64::max).log10().ceil();
    let mark = |x| Mark {
        name: "the car stops with every seed",
        point: [x, 10_f64.powf(top)],
        kind: MarkKind::None,
    };
    panel.marks = stopped.into_iter().map(mark).collect();
    panel
}

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

/// Reasons with the number of drives of each, the commonest first.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
struct StopReasons(Vec<(String, usize)>);

impl StopReasons {
    /// Counts reasons. What stands behind a colon is about one drive alone.
    fn of<'a>(reasons: impl Iterator<Item = &'a str>) -> Self {
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
    fn commonest(&self) -> &str {
        self.0.first().map_or("", |(kind, _)| kind)
    }

    /// Each with its number, between them `separator`.
    fn joined(&self, separator: &str) -> String {
        let reasons = self.0.iter().map(|(kind, count)| format!("{kind} {count}"));
        reasons.collect::<Vec<_>>().join(separator)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_interval_holds_the_mean_and_narrows_with_the_number() {
        let values: Vec<f64> = (0..400).map(|index| f64::from(index % 20)).collect();
        let [low, high] = interval(&values);
        assert!(low < 9.5 && 9.5 < high, "{low} {high}");
        // 1.96 standard deviations of the mean to both sides.
        assert!(
            (high - low - 2.0 * 1.96 * 5.77 / 20.0).abs() < 0.15,
            "{low} {high}"
        );
        let [fewer_low, fewer_high] = interval(&values[..20]);
        assert!(fewer_high - fewer_low > 3.0 * (high - low));
        assert_eq!(interval(&[2.0]), [2.0, 2.0]);
    }

    #[test]
    fn the_commonest_is_first_and_equal_ones_are_in_the_order_of_their_names() {
        let reasons = ["geofence", "refused: a, b", "diverged", "refused: c"];
        let reasons = StopReasons::of(reasons.into_iter());
        assert_eq!(reasons.commonest(), "refused");
        assert_eq!(reasons.joined(";"), "refused 2;diverged 1;geofence 1");
        assert_eq!(StopReasons::default().commonest(), "");
    }
}
