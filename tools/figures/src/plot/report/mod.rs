//! `report.html`: a drive to look around in, in one file that needs nothing else.
//!
//! The page is readable without JavaScript, and prints the figures for print; the
//! script puts canvases in their place.

mod data;

use base64::{Engine as _, engine::general_purpose::STANDARD};
use singletrack_record::{Level, Log, seconds_since};

use super::{
    animation,
    drive::Drive,
    figures::FigureKind,
    read::Record,
    summary::{self, Line},
};
use crate::{
    figure::{Figure, escaped},
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
    let name = record
        .path
        .file_name()
        .unwrap_or_default()
        .to_string_lossy();
    let summary = summary::lines(record, number, drive);
    let configuration = record
        .configuration(drive)
        .unwrap_or("The configuration of this drive is not in the record.");
    let animation = match animation::animation(drive, configuration) {
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
    let data = data::json(&figures, drive.duration());
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
        ("script", include_str!("plot.js")),
    ])
}

/// The page with its parts.
fn fill(parts: &[(&str, &str)]) -> String {
    output::fill(include_str!("page.html"), parts)
}

fn subtitle(drive: &Drive) -> String {
    format!(
        "A drive of {:.1} s. Times are since its first driving tick; {}.",
        drive.duration(),
        if drive.truth.is_empty() {
            "all that is shown comes from the record"
        } else {
            "ground truth is shown because the car is simulated"
        }
    )
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
    format!(
        "<tr><th scope=\"row\">{}</th><td>{}</td></tr>\n",
        escaped(name),
        escaped(value)
    )
}

fn framed((kind, figure): &(FigureKind, Figure)) -> String {
    let over_time = if data::is_interactive(figure) {
        " time"
    } else {
        ""
    };
    let width = figure.width;
    format!(
        "<figure id=\"{}\" class=\"{width}{over_time}\">\n<h3>{}</h3>\n<div class=\"live\"></div>\n\
         <div class=\"static\">{}</div>\n<figcaption>{}</figcaption>\n</figure>\n",
        kind.name(),
        escaped(&figure.title),
        figure.to_svg(),
        escaped(&figure.caption)
    )
}

fn changes(record: &Record, drive: &Drive) -> String {
    summary::changes(record, drive)
        .into_iter()
        .map(|(time, change)| {
            format!(
                "<tr><td>{time:.3}</td><td>{}</td><td>{}</td></tr>\n",
                change.mode,
                change.reason.map_or("", |reason| reason.name())
            )
        })
        .collect()
}

fn log(log: &[Log], drive: &Drive) -> String {
    if log.is_empty() {
        return "<p class=\"quiet\">The record has no lines of the log.</p>".to_owned();
    }
    let matters = |log: &&Log| log.level >= Level::Warning;
    let bad: Vec<&Log> = log.iter().filter(matters).collect();
    let mut html = if bad.is_empty() {
        "<p class=\"quiet\">No warnings and no errors.</p>\n".to_owned()
    } else {
        table(&bad, drive)
    };
    let all: Vec<&Log> = log.iter().collect();
    html += &format!(
        "<details><summary>All {} lines</summary>{}</details>",
        log.len(),
        table(&all, drive)
    );
    html
}

fn table(lines: &[&Log], drive: &Drive) -> String {
    let rows = lines.iter().take(MOST_LOG_LINES).map(|log| {
        let time = seconds_since(drive.start_ns, log.time_ns);
        let level = log.level.name();
        format!(
            "<tr><td>{time:.3}</td><td>{level}</td><td>{}</td></tr>\n",
            escaped(&log.text)
        )
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
