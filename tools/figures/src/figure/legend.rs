//! What the lines, marks and shadings of a figure mean, each once.

use super::{Figure, Look, MarkKind, Shade, typeset};

/// An entry of the legend.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Entry {
    pub(super) key: Key,
    pub(super) name: String,
}

/// What it explains.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Key {
    Line(Look),
    Mark(MarkKind),
    Span,
    Shade(Shade),
    Isoline,
    Leader,
    Estimate(MarkKind),
}

/// The legend of all panels together. A single kind of line needs none: the axis
/// names it.
pub(super) fn entries(figure: &Figure) -> Vec<Entry> {
    let mut entries: Vec<Entry> = Vec::new();
    let mut add = |key, name: &str| {
        let entry = Entry {
            key,
            name: name.to_owned(),
        };
        if !name.is_empty() && !entries.contains(&entry) {
            entries.push(entry);
        }
    };
    for panel in &figure.panels {
        if let Some(map) = &panel.map {
            for band in map.bands.iter().filter(|band| map.grid.has(band)) {
                add(Key::Shade(band.shade), &band.name);
            }
        }
    }
    for panel in &figure.panels {
        let lines = panel.curves.iter().filter(|curve| curve.look != Look::Lost);
        for curve in lines.filter(|curve| !curve.is_empty()) {
            add(Key::Line(curve.look), curve.name);
        }
    }
    for panel in &figure.panels {
        for level in &panel.levels {
            add(Key::Line(level.look), &level.name);
        }
        for callouts in panel.callouts.iter().filter(|all| !all.points.is_empty()) {
            add(Key::Leader, &callouts.name);
        }
        for estimate in &panel.estimates {
            add(Key::Estimate(estimate.kind), &estimate.name);
        }
        if let Some(map) = &panel.map
            && !map.isolines.is_empty()
        {
            add(Key::Isoline, &map.isoline_name);
        }
        for mark in &panel.marks {
            add(Key::Mark(mark.kind), mark.name);
        }
        if !panel.spans.is_empty() {
            add(Key::Span, panel.span_name);
        }
        let lost = panel.curves.iter().filter(|curve| curve.look == Look::Lost);
        for curve in lost.filter(|curve| !curve.is_empty()) {
            add(Key::Span, curve.name);
        }
    }
    entries
}

/// Width of a key and of the gaps around it, in mm.
pub(super) const KEY_WIDTH: f64 = 4.6;
const KEY_GAP: f64 = 1.0;
const ENTRY_GAP: f64 = 2.4;
/// Height of a row, in mm.
pub(super) const ROW_HEIGHT: f64 = 3.8;

/// Where the entries go within `width`: left edge and row of each.
pub(super) fn places(entries: &[Entry], width: f64) -> Vec<(f64, usize)> {
    let (mut left, mut row) = (0.0, 0);
    entries
        .iter()
        .map(|entry| {
            let own = KEY_WIDTH + KEY_GAP + typeset::width(&entry.name);
            if left > 0.0 && left + own > width {
                (left, row) = (0.0, row + 1);
            }
            let place = (left, row);
            left += own + ENTRY_GAP;
            place
        })
        .collect()
}

/// Where the text of an entry begins, from its left edge.
pub(super) const TEXT_OFFSET: f64 = KEY_WIDTH + KEY_GAP;
