//! How a figure looks: colours and sizes, legend, notes, and the page.

use std::sync::Arc;

use singletrack_control::words;

use super::{Figure, Shade, typeset};

/// From one line of a broken name to the next, in mm.
pub(super) const LINE_HEIGHT: f64 = 2.9;
/// Size of the axes' names, in mm: 8 pt.
pub(super) const NAME_SIZE: f64 = 2.82;
/// An area is not lower than this, however wide its data, in mm.
pub(super) const LEAST_HEIGHT: f64 = 30.0;
pub(super) const MARGIN: f64 = 1.5;
/// Below an area: its ticks and the axis' name.
pub(super) const BELOW: f64 = 9.2;
/// Room for the axis' name left of its ticks.
pub(super) const NAME_ROOM: f64 = 4.6;
pub(super) const TICK_GAP: f64 = 1.0;
pub(super) const PANEL_GAP: f64 = 5.0;
/// Between the name of an axis and what is in the row below.
pub(super) const ROW_GAP: f64 = 2.0;
/// Above an area that has a title.
pub(super) const TITLE_HEIGHT: f64 = 4.2;

pub(super) const INK: &str = "#1a1a1a";

/// A value of the vertical axis that matters, drawn across the panel.
#[derive(Clone, Debug, PartialEq)]
pub struct Level {
    /// What it is. Both ends of a range have the same name.
    pub name: String,
    /// Where.
    pub value: f64,
    /// What is written beside it. Without it the name is in the legend.
    pub label: String,
    /// How it looks.
    pub look: Look,
}

impl Level {
    /// A level that the legend names.
    pub fn new(name: &str, value: f64, look: Look) -> Self {
        Self {
            name: name.to_owned(),
            value,
            label: String::new(),
            look,
        }
    }
}

/// Points of one kind, each with something written beside it at the end of a dotted
/// leader.
#[derive(Clone, Debug, PartialEq)]
pub struct Callouts {
    /// What is written, for the legend.
    pub name: String,
    /// The points.
    pub points: Vec<Callout>,
}

/// A point and what is written beside it.
#[derive(Clone, Debug, PartialEq)]
pub struct Callout {
    /// Where.
    pub point: [f64; 2],
    /// What.
    pub label: String,
}

/// A value, and the interval that it is believed to be in.
#[derive(Clone, Debug, PartialEq)]
pub struct Estimate {
    /// What it is, for the legend.
    pub name: String,
    /// What the point looks like.
    pub kind: MarkKind,
    /// Where it is on the horizontal axis.
    pub x: f64,
    /// The value, on the vertical axis.
    pub value: f64,
    /// The ends of the interval, on the vertical axis.
    pub interval: [f64; 2],
}

/// Numbers of a curve, shared by all that draw them.
pub type Column = Arc<[f64]>;

words! {
    /// The style of a line: distinguishable without colour, by grey, width and dashes. Its word is
    /// its class in a style sheet.
    pub enum Look {
        /// The nominal value: wide and grey, as in the paper.
        Nominal = "nominal",
        /// The actual value: thin and black, as in the paper.
        Actual = "actual",
        /// A measurement: thin and light.
        Measured = "measured",
        /// Ground truth, which only a simulation has: dashed.
        Truth = "truth",
        /// Where something was missing: a wide band of the shading's colour.
        Lost = "lost",
        /// The other of two that are compared: black, in long dashes.
        Other = "other",
        /// Where one kind of behaviour turns into another: thick and black.
        Boundary = "boundary",
        /// The end of a range: thin, dashed.
        RangeEnd = "range-end",
        /// An asymptote: thin, dashes and dots.
        Asymptote = "asymptote",
    }
}

words! {
    /// What a mark looks like. Its word is its class in a style sheet.
    pub enum MarkKind {
        /// Where a trajectory starts: a triangle.
        Start = "start",
        /// Where it ends: a circle.
        End = "end",
        /// A value that was found: a dot.
        Found = "found",
        /// One of several kinds of value: a filled square.
        Square = "square",
        /// One of several kinds of value: a diamond.
        Diamond = "diamond",
        /// What has no value: a cross.
        None = "none",
    }
}

/// An entry of the legend: what it explains, and its name.
pub(super) type Entry<'a> = (Key, &'a str);

/// What an entry of the legend explains.
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
pub(super) fn entries<'a>(figure: &'a Figure) -> Vec<Entry<'a>> {
    let mut entries = Vec::new();
    let mut add = |key, name: &'a str| {
        if !name.is_empty() && !entries.contains(&(key, name)) {
            entries.push((key, name));
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
        for level in panel.levels.iter().filter(|level| level.label.is_empty()) {
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
const MARK_WIDTH: f64 = 2.6;
const KEY_GAP: f64 = 1.0;
const ENTRY_GAP: f64 = 2.4;
/// The least gap between entries that all fit in one row. Texts are narrower than they are taken for.
const LEAST_ENTRY_GAP: f64 = 0.5;
/// Height of a row, in mm.
pub(super) const ROW_HEIGHT: f64 = 3.8;

impl Key {
    /// How wide it is, in mm.
    pub(super) const fn width(self) -> f64 {
        match self {
            Self::Mark(_) => MARK_WIDTH,
            _ => KEY_WIDTH,
        }
    }

    /// Where the text of an entry begins, from its left edge.
    pub(super) const fn text_offset(self) -> f64 {
        self.width() + KEY_GAP
    }
}

/// Where the entries go within `width`: left edge and row of each.
pub(super) fn places(entries: &[Entry<'_>], width: f64) -> Vec<(f64, usize)> {
    let own = |(key, name): &Entry<'_>| key.text_offset() + typeset::width(name);
    let rest = width - entries.iter().map(own).sum::<f64>();
    let in_a_row = rest / entries.len().saturating_sub(1).max(1) as f64;
    let gap = match in_a_row {
        LEAST_ENTRY_GAP..ENTRY_GAP => in_a_row,
        _ => ENTRY_GAP,
    };
    let (mut left, mut row) = (0.0, 0);
    entries
        .iter()
        .map(|entry| {
            let own = own(entry);
            if left > 0.0 && left + own > width + 1e-9 {
                (left, row) = (0.0, row + 1);
            }
            let place = (left, row);
            left += own + gap;
            place
        })
        .collect()
}
