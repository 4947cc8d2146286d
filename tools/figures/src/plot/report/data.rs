//! The numbers of a report, as its script reads them.

use std::collections::HashMap;

use base64::{Engine as _, engine::general_purpose::STANDARD};
use serde::Serialize;

use crate::{
    figure::{Axis, Column, Figure, Mark, Panel, Scale},
    plot::figures::FigureKind,
};

/// What the script reads.
#[derive(Serialize)]
struct Data {
    /// The end of the time axis, in s.
    end: f64,
    /// Each the base 64 of 32-bit floats, little-endian.
    columns: Vec<String>,
    figures: Vec<FigureData>,
}

#[derive(Serialize)]
struct FigureData {
    id: String,
    title: String,
    caption: String,
    panels: Vec<PanelData>,
}

#[derive(Serialize)]
struct PanelData {
    x: AxisData,
    y: AxisData,
    equal: bool,
    spans: Vec<[f64; 2]>,
    span: &'static str,
    curves: Vec<CurveData>,
    marks: Vec<Mark>,
}

#[derive(Serialize)]
struct AxisData {
    quantity: &'static str,
    letter: &'static str,
    below: &'static str,
    unit: &'static str,
    include: Option<f64>,
    log: bool,
}

/// Columns by their number.
#[derive(Serialize)]
struct CurveData {
    name: &'static str,
    look: &'static str,
    x: usize,
    y: usize,
    time: usize,
}

/// Whether the script draws a figure: histograms stay pictures.
pub(super) fn is_interactive(figure: &Figure) -> bool {
    figure.panels.iter().all(|panel| panel.bars.is_empty())
}

/// The JSON of the figures that the script draws. It can stand in HTML as it is.
pub(super) fn json(figures: &[(FigureKind, Figure)], end: f64) -> String {
    let mut columns = Columns::default();
    let figures = figures
        .iter()
        .filter(|(_, figure)| is_interactive(figure))
        .map(|(kind, figure)| FigureData {
            id: kind.name(),
            title: figure.title.clone(),
            caption: figure.caption.clone(),
            panels: figure
                .panels
                .iter()
                .map(|panel| columns.panel(panel))
                .collect(),
        })
        .collect();
    let data = Data {
        end,
        columns: columns.texts,
        figures,
    };
    // Finite numbers and strings can be written; without data the script stops and
    // the pictures stay.
    let json = serde_json::to_string(&data).unwrap_or_else(|_| "null".to_owned());
    // Nothing in a script element may look like its end.
    json.replace('<', "\\u003c")
}

/// Columns, each once: the times are the same in most figures.
#[derive(Default)]
struct Columns {
    texts: Vec<String>,
    numbers: HashMap<String, usize>,
}

impl Columns {
    fn panel(&mut self, panel: &Panel) -> PanelData {
        let curves = panel.curves.iter().filter(|curve| !curve.is_empty());
        let curves = curves
            .map(|curve| CurveData {
                name: curve.name,
                look: curve.look.name(),
                x: self.number(&curve.x),
                y: self.number(&curve.y),
                time: self.number(curve.time.as_ref().unwrap_or(&curve.x)),
            })
            .collect();
        PanelData {
            x: axis(&panel.x),
            y: axis(&panel.y),
            equal: panel.equal,
            spans: panel.spans.clone(),
            span: panel.span_name,
            curves,
            marks: panel.marks.clone(),
        }
    }

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

fn axis(axis: &Axis) -> AxisData {
    AxisData {
        quantity: axis.quantity,
        letter: axis.symbol.map_or("", |symbol| symbol.letter),
        below: axis.symbol.map_or("", |symbol| symbol.below),
        unit: axis.unit,
        include: axis.include,
        log: axis.scale == Scale::Log,
    }
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
