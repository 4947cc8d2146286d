//! The numbers of a report, as its script reads them.

use std::collections::HashMap;

use base64::{Engine as _, engine::general_purpose::STANDARD};
use serde_json::{Value, json};

use crate::{
    figure::{Axis, Column, Figure, Panel, Scale},
    plot::figures::FigureKind,
};

/// Whether the script draws a figure: histograms stay pictures.
pub(super) fn is_interactive(figure: &Figure) -> bool {
    figure.panels.iter().all(|panel| panel.bars.is_empty())
}

/// The JSON of the figures that the script draws, up to `end`, in s. It can stand in HTML as it is.
pub(super) fn json(figures: &[(FigureKind, Figure)], end: f64) -> String {
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
        let bytes: Vec<u8> = column
            .iter()
            .flat_map(|value| (*value as f32).to_le_bytes())
            .collect();
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
