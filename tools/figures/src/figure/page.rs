//! How a figure looks: colours and sizes, legend, notes, and where its panels lie on the page.

use std::sync::Arc;

use singletrack_control::words;

use super::{
    Axis, Figure, Map, Panel, Scale, Shade,
    place::Slot,
    scale::{Ruler, equalise, roomy},
    typeset,
};

/// From one line of a broken name to the next, in mm.
pub(super) const LINE_HEIGHT: f64 = 2.9;
/// Size of the axes' names, in mm: 8 pt.
pub(super) const NAME_SIZE: f64 = 2.82;
/// An area is not lower than this, however wide its data, in mm.
const LEAST_HEIGHT: f64 = 30.0;
pub(super) const MARGIN: f64 = 1.5;
/// Below an area: its ticks and the axis' name.
const BELOW: f64 = 9.2;
/// Room for the axis' name left of its ticks.
const NAME_ROOM: f64 = 4.6;
pub(super) const TICK_GAP: f64 = 1.0;
const PANEL_GAP: f64 = 5.0;
/// Between the name of an axis and what is in the row below.
const ROW_GAP: f64 = 2.0;
/// Above an area that has a title.
const TITLE_HEIGHT: f64 = 4.2;

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

/// An area between axes on the page, in mm.
pub(super) struct Area {
    pub(super) x: Ruler,
    pub(super) y: Ruler,
    pub(super) left: f64,
    pub(super) right: f64,
    pub(super) top: f64,
    pub(super) bottom: f64,
    /// Whether names stand below it, in place of numbers.
    pub(super) named: bool,
    /// Each with the lines of its text.
    pub(super) x_ticks: Vec<(f64, Vec<String>)>,
    pub(super) y_ticks: Vec<(f64, String)>,
}

/// How far from the frame a label stays, in mm.
const INSET: f64 = 0.5;
/// Ticks that reach in, in mm.
const TICK: f64 = 0.9;

impl Area {
    /// Where what is written below it ends.
    pub(super) fn end(&self) -> f64 {
        let lines = self.x_ticks.iter().map(|(_, lines)| lines.len());
        let more = lines.max().unwrap_or_default().saturating_sub(1);
        let name = if self.named { NAME_SIZE + 1.5 } else { 0.0 };
        self.bottom + BELOW - name + more as f64 * LINE_HEIGHT
    }

    /// Whether a label is wholly within the frame.
    pub(super) fn holds(&self, slot: &Slot) -> bool {
        slot.corners().iter().all(|[x, y]| {
            (self.left + INSET..=self.right - INSET).contains(x)
                && (self.top + INSET..=self.bottom - TICK - INSET).contains(y)
        })
    }
}

/// The areas of the panels, side by side in their rows, each with room for its own
/// ticks.
pub(super) fn areas(figure: &Figure, top: f64) -> Vec<Area> {
    let mut areas = Vec::new();
    let mut top = top;
    for row in figure.panels.chunk_by(|_, next| !next.begins_row) {
        let titled = row.iter().any(|panel| !panel.title.is_empty());
        let title = if titled { TITLE_HEIGHT } else { 0.0 };
        let gaps = PANEL_GAP * (row.len() as f64 - 1.0);
        let share = (figure.width.mm() - 2.0 * MARGIN - gaps) / row.len() as f64;
        let row = row.iter().enumerate().map(|(index, panel)| {
            let left = MARGIN + index as f64 * (share + PANEL_GAP);
            area(panel, left, left + share, top + title)
        });
        let row: Vec<Area> = row.collect();
        let bottom = row.iter().map(Area::end).fold(top, f64::max);
        top = bottom + ROW_GAP;
        areas.extend(row);
    }
    areas
}

/// The area of a panel between `left` and `right`, ticks and name of the vertical
/// axis included.
fn area(panel: &Panel, left: f64, right: f64, top: f64) -> Area {
    let ranges = [range(panel, 0), range(panel, 1)];
    let fit = |inner: f64| {
        let ([mut x, mut y], mut bottom) = (ranges, top + panel.height_mm);
        if panel.equal {
            let wanted = (right - inner) * (y[1] - y[0]) / (x[1] - x[0]);
            bottom = top + wanted.max(LEAST_HEIGHT).min(panel.height_mm);
            (x, y) = equalise(x, y, right - inner, bottom - top);
        }
        let x = Ruler::new(panel.x.scale, x, [inner, right - 1.0]);
        let y = Ruler::new(panel.y.scale, y, [bottom, top]);
        let y_ticks = y.ticks(((bottom - top) / 7.5) as usize);
        let inner = left + NAME_ROOM + widest(&y_ticks) + TICK_GAP;
        (x, y, y_ticks, bottom, inner)
    };
    // How wide the ticks' text is follows from them, and they hardly from that.
    let (.., inner) = fit(left + NAME_ROOM + 7.0);
    let (x, y, y_ticks, bottom, inner) = fit(inner);
    // Maps are read at both axes.
    let x_tick = if panel.map.is_some() { 8.0 } else { 12.0 };
    let x_ticks = if panel.names.is_empty() {
        let ticks = x.ticks(((right - inner) / x_tick) as usize).into_iter();
        ticks.map(|(value, text)| (value, vec![text])).collect()
    } else {
        let room = (x.at(1.0) - x.at(0.0)) - TICK_GAP;
        let names = panel.names.iter().enumerate();
        let names = names.map(|(place, name)| (place as f64, typeset::broken(name, room)));
        names.collect()
    };
    Area {
        named: !panel.names.is_empty(),
        x_ticks,
        y_ticks,
        left: x.at(x.range[0]),
        right: x.at(x.range[1]),
        top,
        bottom,
        x,
        y,
    }
}

/// The width of the widest text of some ticks, in mm.
pub(super) fn widest(ticks: &[(f64, String)]) -> f64 {
    let widths = ticks.iter().map(|(_, text)| typeset::width(text));
    widths.fold(0.0, f64::max)
}

/// The ends of a panel's horizontal (0) or vertical (1) axis.
fn range(panel: &Panel, axis: usize) -> [f64; 2] {
    if axis == 0 && !panel.names.is_empty() {
        return [-0.5, panel.names.len() as f64 - 0.5];
    }
    let description: &Axis = if axis == 0 { &panel.x } else { &panel.y };
    let mut values: Vec<f64> = description.include.into_iter().collect();
    if let Some(Map { grid, .. }) = &panel.map {
        values.extend([grid.x(), grid.y()][axis]);
    }
    for curve in &panel.curves {
        values.extend([&curve.x, &curve.y][axis].iter());
    }
    let marks = panel.marks.iter().map(|mark| mark.point);
    let callouts = panel.callouts.iter().flat_map(|all| &all.points);
    let points = marks.chain(callouts.map(|callout| callout.point));
    values.extend(points.map(|point| point[axis]));
    for estimate in &panel.estimates {
        let [low, high] = estimate.interval;
        values.extend([[estimate.x; 3], [estimate.value, low, high]][axis]);
    }
    if axis == 1 {
        values.extend(panel.levels.iter().map(|level| level.value));
    }
    for bar in &panel.bars {
        values.extend([bar.span, [bar.height; 2]][axis]);
    }
    values.retain(|value| value.is_finite());
    let least = values.iter().copied().reduce(f64::min);
    let Some(ends) = least.zip(values.into_iter().reduce(f64::max)) else {
        return match description.scale {
            Scale::Linear => [0.0, 1.0],
            Scale::Log => [1.0, 10.0],
        };
    };
    let ends: [f64; 2] = ends.into();
    let histogram = !panel.bars.is_empty();
    match description.scale {
        // A map fills its frame.
        _ if panel.map.is_some() => ends,
        Scale::Log => [
            10_f64.powf(ends[0].max(1e-9).log10().floor()),
            10_f64.powf((ends[1].max(1e-9) * (1.0 - 1e-9)).log10().ceil()),
        ],
        // Bars stand on the axis, and time begins at its edge.
        Scale::Linear
            if axis == 0 && !panel.equal && panel.estimates.is_empty() && ends[1] > ends[0] =>
        {
            ends
        }
        Scale::Linear if histogram => [0.0, roomy(ends)[1]],
        Scale::Linear => {
            let roomy = roomy(ends);
            match description.include {
                Some(edge) if edge == ends[0] => [edge, roomy[1]],
                _ => roomy,
            }
        }
    }
}
