//! `report.html`: a drive to look around in, in one file that needs nothing else.
//!
//! The page is readable without JavaScript, and prints the figures for print; the
//! script puts canvases in their place.

use std::collections::HashMap;

use base64::{Engine as _, engine::general_purpose::STANDARD};
use serde_json::{Value, json};
use singletrack_pilot::Reason;
use singletrack_record::{Level, Log, seconds_since};

use super::{
    animation,
    drive::{Change, Drive},
    figures::FigureKind,
    read::Record,
    summary::{self, Line},
};
use crate::{
    figure::{Axis, Column, Figure, Panel, Scale, escaped},
    output,
};

/// Lines of the log in a report; of more, the warnings and errors stay longest.
const MOST_LOG_LINES: usize = 2_000;

/// The report of a drive of a record; `number` counts from 1.
pub(super) fn report(record: &Record, number: usize, drive: &Drive) -> String {
    let (figures, missing) = super::draw(drive, FigureKind::of(drive));
    let missing = missing.into_iter();
    let mut missing: Vec<String> = missing
        .map(|(kind, why)| format!("There is no figure {}: {why}.", kind.name()))
        .collect();
    let name = record.path.file_name().unwrap_or_default();
    let name = name.to_string_lossy();
    let summary = summary::lines(record, number, drive);
    let configuration = record
        .configuration(drive)
        .unwrap_or("The configuration of this drive is not in the record.");
    let animation = match animation::animation(drive, &record.settings(drive)) {
        Ok(picture) => moving(&picture),
        Err(why) => {
            missing.push(format!("There is no animation: {why}."));
            String::new()
        }
    };
    let notes = record.notes.iter().chain(&missing);
    let notes: String = notes
        .map(|note| format!("<p class=\"note\">{}</p>\n", escaped(note)))
        .collect();
    let data = data(&figures, drive.duration());
    fill(&[
        ("title", &escaped(&name)),
        ("subtitle", &escaped(&subtitle(drive))),
        ("style", super::STYLE),
        ("notes", &notes),
        ("summary", &summary.iter().map(row).collect::<String>()),
        ("animation", &animation),
        ("figures", &figures.iter().map(framed).collect::<String>()),
        ("changes", &changes(record, drive)),
        ("log", &log(&record.recording.log, drive)),
        ("configuration", &escaped(configuration)),
        ("data", &data),
        ("script", include_str!("report/plot.js")),
    ])
}

/// The page with its parts.
fn fill(parts: &[(&str, &str)]) -> String {
    output::fill(include_str!("report/page.html"), parts)
}

fn subtitle(drive: &Drive) -> String {
    let duration = drive.duration();
    let source = match drive.truth.is_empty() {
        true => "all that is shown comes from the record",
        false => "ground truth is shown because the car is simulated",
    };
    format!("A drive of {duration:.1} s. Times are since its first driving tick; {source}.")
}

/// The animation as an image: its styles and the report's stay apart.
fn moving(picture: &str) -> String {
    format!(
        "<figure id=\"animation\">\n<img alt=\"The drive from above, in real time\" \
         src=\"data:image/svg+xml;base64,{}\">\n</figure>\n",
        STANDARD.encode(picture)
    )
}

fn row((name, value): &Line) -> String {
    let (name, value) = (escaped(name), escaped(value));
    format!("<tr><th scope=\"row\">{name}</th><td>{value}</td></tr>\n")
}

fn framed((kind, figure): &(FigureKind, Figure)) -> String {
    let over_time = if is_interactive(figure) { " time" } else { "" };
    let width = figure.width;
    let (title, caption) = (escaped(&figure.title), escaped(&figure.caption));
    format!(
        "<figure id=\"{kind}\" class=\"{width}{over_time}\">\n<h3>{title}</h3>\n<div class=\"live\"></div>\n\
         <div class=\"static\">{}</div>\n<figcaption>{caption}</figcaption>\n</figure>\n",
        figure.to_svg()
    )
}

fn changes(record: &Record, drive: &Drive) -> String {
    let changes = summary::changes(record, drive).into_iter();
    let rows = changes.map(|(time, Change { mode, reason, .. })| {
        let reason = reason.map_or("", Reason::name);
        format!("<tr><td>{time:.3}</td><td>{mode}</td><td>{reason}</td></tr>\n")
    });
    rows.collect()
}

fn log(log: &[Log], drive: &Drive) -> String {
    if log.is_empty() {
        return "<p class=\"quiet\">The record has no lines of the log.</p>".to_owned();
    }
    let matters = |log: &&Log| log.level >= Level::Warning;
    let bad: Vec<&Log> = log.iter().filter(matters).collect();
    let html = if bad.is_empty() {
        "<p class=\"quiet\">No warnings and no errors.</p>\n".to_owned()
    } else {
        table(&bad, drive)
    };
    let all: Vec<&Log> = log.iter().collect();
    let (count, all) = (log.len(), table(&all, drive));
    html + &format!("<details><summary>All {count} lines</summary>{all}</details>")
}

fn table(lines: &[&Log], drive: &Drive) -> String {
    let rows = lines.iter().take(MOST_LOG_LINES).map(|log| {
        let time = seconds_since(drive.start_ns, log.time_ns);
        let (level, text) = (log.level.name(), escaped(&log.text));
        format!("<tr><td>{time:.3}</td><td>{level}</td><td>{text}</td></tr>\n")
    });
    let rows: String = rows.collect();
    let cut = lines.len().saturating_sub(MOST_LOG_LINES);
    let more = if cut > 0 {
        format!("<p class=\"note\">{cut} more lines: singletrack dump --topic log has them.</p>")
    } else {
        String::new()
    };
    format!(
        "<table><thead><tr><th scope=\"col\">t (s)</th><th scope=\"col\">level</th>\
         <th scope=\"col\">line</th></tr></thead><tbody>\n{rows}</tbody></table>{more}\n"
    )
}

/// Whether the script draws a figure: histograms stay pictures.
fn is_interactive(figure: &Figure) -> bool {
    figure.panels.iter().all(|panel| panel.bars.is_empty())
}

/// The JSON of the figures that the script draws, up to `end`, in s. It can stand in HTML as it is.
fn data(figures: &[(FigureKind, Figure)], end: f64) -> String {
    let mut columns = Columns::default();
    let figures: Vec<_> = figures
        .iter()
        .filter(|(_, figure)| is_interactive(figure))
        .map(|(kind, figure)| {
            let panels = figure.panels.iter();
            let panels: Vec<_> = panels.map(|panel| columns.panel(panel)).collect();
            json!({
                "id": kind.name(),
                "title": figure.title,
                "caption": figure.caption,
                "panels": panels,
            })
        })
        .collect();
    let data = json!({ "end": end, "columns": columns.texts, "figures": figures });
    // Nothing in a script element may look like its end.
    data.to_string().replace('<', "\\u003c")
}

/// Columns, each once: the times are the same in most figures.
#[derive(Default)]
struct Columns {
    texts: Vec<String>,
    numbers: HashMap<String, usize>,
}

impl Columns {
    /// A panel; its curves name their columns by number.
    fn panel(&mut self, panel: &Panel) -> Value {
        let curves = panel.curves.iter().filter(|curve| !curve.is_empty());
        let curves: Vec<_> = curves
            .map(|curve| {
                json!({
                    "name": curve.name,
                    "look": curve.look.name(),
                    "x": self.number(&curve.x),
                    "y": self.number(&curve.y),
                    "time": self.number(curve.time.as_ref().unwrap_or(&curve.x)),
                })
            })
            .collect();
        let marks = panel.marks.iter();
        let marks = marks.map(|mark| json!({ "kind": mark.kind.name(), "point": mark.point }));
        json!({
            "x": axis(&panel.x),
            "y": axis(&panel.y),
            "equal": panel.equal,
            "spans": panel.spans,
            "span": panel.span_name,
            "curves": curves,
            "marks": marks.collect::<Vec<_>>(),
        })
    }

    /// The number of a column, which is written as the base 64 of 32-bit floats, little-endian.
    fn number(&mut self, column: &Column) -> usize {
        let floats = column.iter().map(|value| *value as f32);
        let bytes: Vec<u8> = floats.flat_map(f32::to_le_bytes).collect();
        let text = STANDARD.encode(&bytes);
        *self.numbers.entry(text).or_insert_with_key(|text| {
            self.texts.push(text.clone());
            self.texts.len() - 1
        })
    }
}

fn axis(axis: &Axis) -> Value {
    json!({
        "quantity": axis.quantity,
        "letter": axis.symbol.map_or("", |symbol| symbol.letter),
        "below": axis.symbol.map_or("", |symbol| symbol.below),
        "unit": axis.unit,
        "include": axis.include,
        "log": axis.scale == Scale::Log,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_place_of_the_page_has_its_part_and_parts_are_not_filled() {
        let names = [
            "title",
            "subtitle",
            "style",
            "notes",
            "summary",
            "animation",
            "figures",
            "changes",
            "log",
            "configuration",
            "data",
            "script",
        ];
        let parts: Vec<_> = names.iter().map(|name| (*name, "{title}")).collect();
        let page = fill(&parts);
        assert_eq!(page.matches("{title}").count(), names.len() + 1, "{page}");
        assert_eq!(page.matches('{').count(), names.len() + 1);
    }
}

#[cfg(test)]
mod data_tests {
    use super::*;

    #[test]
    fn the_same_column_is_written_once() {
        let mut columns = Columns::default();
        let column: Column = [1.0, f64::NAN].into();
        let same: Column = [1.0, f64::NAN].into();
        let other: Column = [2.0].into();
        let numbers = [&column, &same, &other].map(|column| columns.number(column));
        assert_eq!(numbers, [0, 0, 1]);
        assert_eq!(columns.texts[0], "AACAPwAAwH8=");
    }
}
