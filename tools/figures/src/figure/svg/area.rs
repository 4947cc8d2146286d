//! Where the panels of a figure lie on its page.

use crate::figure::{
    Axis, Figure, Map, Panel, Scale,
    page::{
        BELOW, LEAST_HEIGHT, LINE_HEIGHT, MARGIN, NAME_ROOM, NAME_SIZE, PANEL_GAP, ROW_GAP,
        TICK_GAP, TITLE_HEIGHT,
    },
    place::Slot,
    scale::{Ruler, equalise, roomy},
    typeset,
};

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
