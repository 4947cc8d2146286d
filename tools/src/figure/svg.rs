//! Drawing a figure as SVG, in mm: the only place that knows how pictures are made.
//!
//! What a page that holds the picture may want to restyle has a class; what stands
//! in the attributes is for print.

use std::fmt::{self, Write as _};

use super::{
    Axis, Curve, Figure, Look, Mark, MarkKind, Panel, Rule, Scale, Symbol,
    legend::{self, Entry, Key},
    scale::{Ruler, equalise, roomy},
    thin::{envelope, pieces, thin},
};

/// Size of all text but the axes' names, in mm: 7 pt.
pub(super) const TEXT_SIZE: f64 = 2.47;
/// Size of the axes' names, in mm: 8 pt.
const NAME_SIZE: f64 = 2.82;
/// Nothing smaller than this can be seen, in mm.
const TOLERANCE: f64 = 0.03;
/// Of a line that only goes to the right, no more is drawn in a column of this
/// width than its extremes, in mm.
const COLUMN: f64 = 0.1;
/// An area is not lower than this, however wide its data, in mm.
const LEAST_HEIGHT: f64 = 30.0;
const MARGIN: f64 = 1.5;
/// Below an area: its ticks and the axis' name.
const BELOW: f64 = 9.2;
/// Room for the axis' name left of its ticks.
const NAME_ROOM: f64 = 4.6;
const TICK_GAP: f64 = 1.0;
const PANEL_GAP: f64 = 5.0;

const INK: &str = "#1a1a1a";
const FAINT: &str = "#dedede";
const SHADE: &str = "#f1dfb6";
const FONT: &str = "Helvetica, Arial, 'Liberation Sans', 'DejaVu Sans', sans-serif";

/// An area between axes on the page, in mm.
struct Area {
    x: Ruler,
    y: Ruler,
    left: f64,
    right: f64,
    top: f64,
    bottom: f64,
    x_ticks: Vec<(f64, String)>,
    y_ticks: Vec<(f64, String)>,
}

impl Figure {
    /// The figure as an SVG file, as large as it is to be printed.
    #[must_use]
    pub fn to_svg(&self) -> String {
        let mut svg = String::new();
        // Writing to a string does not fail.
        let _ = self.draw(&mut svg);
        svg
    }

    fn draw(&self, svg: &mut String) -> fmt::Result {
        let entries = legend::entries(self);
        let width = self.width.mm();
        let places = legend::places(&entries, width - 2.0 * MARGIN);
        let rows = places.last().map_or(0, |(_, row)| row + 1);
        let top = MARGIN + rows as f64 * legend::ROW_HEIGHT + TICK_GAP;
        let areas = self.areas(top);
        let bottom = areas.iter().map(|area| area.bottom).fold(top, f64::max);
        let height = bottom + BELOW + MARGIN;
        let width_text = number(width);
        writeln!(
            svg,
            r#"<svg xmlns="http://www.w3.org/2000/svg" role="img" width="{width_text}mm" height="{height}mm" viewBox="0 0 {width_text} {height}" font-family="{FONT}" font-size="{TEXT_SIZE}" fill="none" stroke-linejoin="round">"#,
            height = number(height),
        )?;
        writeln!(svg, "<title>{}</title>", escaped(&self.title))?;
        writeln!(svg, "<desc>{}</desc>", escaped(&self.caption))?;
        writeln!(
            svg,
            r##"<rect class="paper" width="100%" height="100%" fill="#ffffff"/>"##
        )?;
        for (entry, (left, row)) in entries.iter().zip(&places) {
            let middle = MARGIN + (*row as f64 + 0.5) * legend::ROW_HEIGHT;
            draw_entry(svg, entry, MARGIN + left, middle)?;
        }
        for (panel, area) in self.panels.iter().zip(&areas) {
            draw_panel(svg, panel, area)?;
        }
        svg.push_str("</svg>\n");
        Ok(())
    }

    /// The areas of the panels, side by side, each with room for its own ticks.
    fn areas(&self, top: f64) -> Vec<Area> {
        let count = self.panels.len().max(1) as f64;
        let gaps = PANEL_GAP * (count - 1.0);
        let share = (self.width.mm() - 2.0 * MARGIN - gaps) / count;
        self.panels
            .iter()
            .enumerate()
            .map(|(index, panel)| {
                let left = MARGIN + index as f64 * (share + PANEL_GAP);
                area(panel, left, left + share, top)
            })
            .collect()
    }
}

/// The area of a panel between `left` and `right`, ticks and name of the vertical
/// axis included.
fn area(panel: &Panel, left: f64, right: f64, top: f64) -> Area {
    let ranges = [range(panel, 0), range(panel, 1)];
    // How wide the ticks' text is follows from them, and they hardly from that.
    let mut inner = left + NAME_ROOM + 7.0;
    let mut bottom = top + panel.height_mm;
    let mut built = None;
    for _ in 0..2 {
        if panel.equal {
            let [width, height] = ranges.map(|[low, high]| high - low);
            let wanted = (right - inner) * height / width;
            bottom = top + wanted.max(LEAST_HEIGHT).min(panel.height_mm);
        }
        let [x, y] = if panel.equal {
            let (x, y) = equalise(ranges[0], ranges[1], right - inner, bottom - top);
            [x, y]
        } else {
            ranges
        };
        let x = Ruler::new(panel.x.scale, x, [inner, right - 1.0]);
        let y = Ruler::new(panel.y.scale, y, [bottom, top]);
        let y_ticks = y.ticks(((bottom - top) / 7.5) as usize);
        let text = y_ticks
            .iter()
            .map(|(_, text)| legend::text_width(text))
            .fold(0.0, f64::max);
        inner = left + NAME_ROOM + text + TICK_GAP;
        built = Some((x, y, y_ticks));
    }
    let (x, y, y_ticks) = built.unwrap_or_else(|| {
        let none = Ruler::new(Scale::Linear, [0.0, 1.0], [left, right]);
        (none, none, Vec::new())
    });
    Area {
        x_ticks: x.ticks(((right - inner) / 12.0) as usize),
        y_ticks,
        left: x.at(x.range[0]),
        right: x.at(x.range[1]),
        top,
        bottom,
        x,
        y,
    }
}

/// The ends of a panel's horizontal (0) or vertical (1) axis.
fn range(panel: &Panel, axis: usize) -> [f64; 2] {
    let description: &Axis = if axis == 0 { &panel.x } else { &panel.y };
    let mut ends = [f64::INFINITY, f64::NEG_INFINITY];
    let mut take = |value: f64| {
        if value.is_finite() {
            ends = [ends[0].min(value), ends[1].max(value)];
        }
    };
    for curve in &panel.curves {
        let column = if axis == 0 { &curve.x } else { &curve.y };
        column.iter().copied().for_each(&mut take);
    }
    for mark in &panel.marks {
        mark.point
            .get(axis)
            .copied()
            .into_iter()
            .for_each(&mut take);
    }
    for bar in &panel.bars {
        if axis == 0 {
            bar.span.into_iter().for_each(&mut take);
        } else {
            take(bar.height);
        }
    }
    description.include.into_iter().for_each(&mut take);
    if ends[0] > ends[1] {
        return [0.0, 1.0];
    }
    let histogram = !panel.bars.is_empty();
    match description.scale {
        Scale::Log => [
            10_f64.powf(ends[0].max(1e-9).log10().floor()),
            10_f64.powf((ends[1].max(1e-9) * (1.0 - 1e-9)).log10().ceil()),
        ],
        // Bars stand on the axis, and time begins at its edge.
        Scale::Linear if axis == 0 && !panel.equal && ends[1] > ends[0] => ends,
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

fn draw_panel(svg: &mut String, panel: &Panel, area: &Area) -> fmt::Result {
    let Area {
        left,
        right,
        top,
        bottom,
        ..
    } = *area;
    svg.push_str("<g>\n");
    for span in &panel.spans {
        draw_span(svg, panel.span_name, *span, area)?;
    }
    for (value, _) in &area.x_ticks {
        line(
            svg,
            "grid",
            FAINT,
            0.12,
            [area.x.at(*value), top, area.x.at(*value), bottom],
        )?;
    }
    for (value, _) in &area.y_ticks {
        line(
            svg,
            "grid",
            FAINT,
            0.12,
            [left, area.y.at(*value), right, area.y.at(*value)],
        )?;
    }
    for bar in &panel.bars {
        let [from, to] = bar.span.map(|end| area.x.at(end));
        let high = area.y.at(bar.height);
        writeln!(
            svg,
            r##"<rect class="bar" x="{}" y="{}" width="{}" height="{}" fill="#7d7d7d" stroke="#ffffff" stroke-width="0.08"/>"##,
            number(from),
            number(high),
            number(to - from),
            number(bottom - high),
        )?;
    }
    for curve in &panel.curves {
        draw_curve(svg, curve, area, panel.equal)?;
    }
    writeln!(
        svg,
        r#"<rect class="frame" x="{}" y="{}" width="{}" height="{}" stroke="{INK}" stroke-width="0.2"/>"#,
        number(left),
        number(top),
        number(right - left),
        number(bottom - top),
    )?;
    for (index, rule) in panel.rules.iter().enumerate() {
        draw_rule(svg, rule, index, area)?;
    }
    for mark in &panel.marks {
        draw_mark(svg, mark, area)?;
    }
    for (value, label) in &area.x_ticks {
        let x = area.x.at(*value);
        line(svg, "ink", INK, 0.2, [x, bottom, x, bottom - 0.9])?;
        text(svg, [x, bottom + TICK_GAP + 2.0], "middle", label)?;
    }
    for (value, label) in &area.y_ticks {
        let y = area.y.at(*value);
        line(svg, "ink", INK, 0.2, [left, y, left + 0.9, y])?;
        text(svg, [left - TICK_GAP, y + 0.85], "end", label)?;
    }
    let middle = (0.5 * (left + right), bottom + 7.8);
    axis_name(
        svg,
        &panel.x,
        &format!(r#"x="{}" y="{}""#, number(middle.0), number(middle.1)),
    )?;
    let ticks = area.y_ticks.iter();
    let widest = ticks
        .map(|(_, text)| legend::text_width(text))
        .fold(0.0, f64::max);
    let (x, y) = (left - TICK_GAP - widest - 1.4, 0.5 * (top + bottom));
    let place = format!(
        r#"transform="translate({} {}) rotate(-90)""#,
        number(x),
        number(y)
    );
    axis_name(svg, &panel.y, &place)?;
    svg.push_str("</g>\n");
    Ok(())
}

/// A shaded span, cut at the edges of the area.
fn draw_span(svg: &mut String, name: &str, [from, to]: [f64; 2], area: &Area) -> fmt::Result {
    let [low, high] = area.x.range;
    if to < low || from > high {
        return Ok(());
    }
    let (left, right) = (area.x.at(from.max(low)), area.x.at(to.min(high)));
    // Even the shortest can be seen.
    let width = (right - left).max(0.15);
    writeln!(
        svg,
        r#"<rect class="span" x="{}" y="{}" width="{}" height="{}" fill="{SHADE}"><title>{}: {from:.3} to {to:.3}</title></rect>"#,
        number(left),
        number(area.top),
        number(width),
        number(area.bottom - area.top),
        escaped(name),
    )
}

fn draw_curve(svg: &mut String, curve: &Curve, area: &Area, equal: bool) -> fmt::Result {
    if curve.is_empty() {
        return Ok(());
    }
    let place = |[x, y]: [f64; 2]| [area.x.at(x), area.y.at(y)];
    write!(
        svg,
        r#"<path class="{}" {} d=""#,
        curve.look.class(),
        pen(curve.look)
    )?;
    for piece in pieces(curve.points().map(place)) {
        let piece = if equal {
            piece
        } else {
            envelope(&piece, COLUMN)
        };
        let piece = thin(&piece, TOLERANCE);
        for (index, [x, y]) in piece.iter().enumerate() {
            let command = if index == 0 { 'M' } else { 'L' };
            write!(svg, "{command}{} {}", number(*x), number(*y))?;
        }
        if piece.len() == 1 {
            // A dot, by the round cap.
            svg.push_str("h0");
        }
    }
    writeln!(svg, r#""><title>{}</title></path>"#, escaped(curve.name))
}

/// Colour, width and dashes of a look. The greys differ as the colours do.
const fn pen(look: Look) -> &'static str {
    match look {
        Look::Nominal => r##"stroke="#9a9a9a" stroke-width="0.6" stroke-linecap="round""##,
        Look::Actual => r##"stroke="#1a1a1a" stroke-width="0.3" stroke-linecap="round""##,
        Look::Measured => r##"stroke="#d59a4a" stroke-width="0.2" stroke-linecap="round""##,
        Look::Truth => r##"stroke="#2166ac" stroke-width="0.25" stroke-dasharray="1.1 0.6""##,
        Look::Lost => r##"stroke="#f1dfb6" stroke-width="2.2" stroke-linecap="butt""##,
    }
}

fn draw_rule(svg: &mut String, rule: &Rule, index: usize, area: &Area) -> fmt::Result {
    let x = area.x.at(rule.value);
    line(svg, "rule", INK, 0.2, [x, area.top, x, area.bottom])?;
    // One below the other, on the right if there is room.
    let y = area.top + 3.0 + 3.2 * index as f64;
    let room = area.right - x - legend::text_width(&rule.name);
    let (x, anchor) = if room < 1.5 {
        (x - 0.8, "end")
    } else {
        (x + 0.8, "start")
    };
    // Over the bars it has a rim in the colour of the paper.
    svg.push_str(r##"<g class="rim" stroke="#ffffff" stroke-width="0.8" paint-order="stroke">"##);
    text(svg, [x, y], anchor, &rule.name)?;
    svg.push_str("</g>\n");
    Ok(())
}

fn draw_mark(svg: &mut String, mark: &Mark, area: &Area) -> fmt::Result {
    let [x, y] = [area.x.at(mark.point[0]), area.y.at(mark.point[1])];
    mark_shape(svg, mark.kind, [x, y])?;
    let [at_x, at_y] = mark.point;
    writeln!(
        svg,
        "<title>{} ({at_x:.3}, {at_y:.3})</title></path>",
        escaped(mark.name)
    )
}

/// The opening tag of a mark.
fn mark_shape(svg: &mut String, kind: MarkKind, [x, y]: [f64; 2]) -> fmt::Result {
    let (class, shape) = match kind {
        MarkKind::Start => ("start", "m0 -1.25l1.2 2.1h-2.4z"),
        MarkKind::End => (
            "end",
            "m-1.05 0a1.05 1.05 0 1 0 2.1 0a1.05 1.05 0 1 0 -2.1 0z",
        ),
    };
    write!(
        svg,
        r##"<path class="mark {class}" d="M{} {}{shape}" fill="#ffffff" stroke="{INK}" stroke-width="0.35">"##,
        number(x),
        number(y),
    )
}

fn draw_entry(svg: &mut String, entry: &Entry, left: f64, middle: f64) -> fmt::Result {
    match entry.key {
        Key::Line(look) => writeln!(
            svg,
            r#"<path class="{}" {} d="M{} {}h{}"/>"#,
            look.class(),
            pen(look),
            number(left),
            number(middle),
            legend::KEY_WIDTH,
        )?,
        Key::Mark(kind) => {
            mark_shape(svg, kind, [left + 0.5 * legend::KEY_WIDTH, middle])?;
            svg.push_str("</path>\n");
        }
        Key::Span => writeln!(
            svg,
            r#"<rect class="span" x="{}" y="{}" width="{}" height="2.4" fill="{SHADE}"/>"#,
            number(left),
            number(middle - 1.2),
            legend::KEY_WIDTH,
        )?,
    }
    let place = [left + legend::TEXT_OFFSET, middle + 0.85];
    text(svg, place, "start", &entry.name)
}

/// Name, symbol and unit of an axis, at `place`.
fn axis_name(svg: &mut String, axis: &Axis, place: &str) -> fmt::Result {
    write!(
        svg,
        r#"<text class="ink" fill="{INK}" font-size="{NAME_SIZE}" text-anchor="middle" {place}>{}"#,
        escaped(axis.quantity)
    )?;
    if let Some(Symbol { letter, below }) = axis.symbol {
        if !axis.quantity.is_empty() {
            svg.push(' ');
        }
        write!(
            svg,
            r#"<tspan font-style="italic">{}</tspan>"#,
            escaped(letter)
        )?;
        if !below.is_empty() {
            write!(
                svg,
                r#"<tspan font-size="70%" dy="0.7">{}</tspan><tspan dy="-0.7">&#8203;</tspan>"#,
                escaped(below)
            )?;
        }
    }
    writeln!(svg, " ({})</text>", escaped(axis.unit))
}

fn text(svg: &mut String, [x, y]: [f64; 2], anchor: &str, content: &str) -> fmt::Result {
    writeln!(
        svg,
        r#"<text class="ink" fill="{INK}" text-anchor="{anchor}" x="{}" y="{}">{}</text>"#,
        number(x),
        number(y),
        escaped(content)
    )
}

fn line(
    svg: &mut String,
    class: &str,
    colour: &str,
    width: f64,
    [x1, y1, x2, y2]: [f64; 4],
) -> fmt::Result {
    writeln!(
        svg,
        r#"<path class="{class}" stroke="{colour}" stroke-width="{width}" d="M{} {}L{} {}"/>"#,
        number(x1),
        number(y1),
        number(x2),
        number(y2)
    )
}

/// A length to a hundredth of a mm, without needless digits.
fn number(value: f64) -> String {
    let text = format!("{value:.2}");
    let text = text.trim_end_matches('0').trim_end_matches('.');
    if text == "-0" {
        "0".to_owned()
    } else {
        text.to_owned()
    }
}

/// Text that means nothing to XML.
pub(crate) fn escaped(text: &str) -> String {
    let mut escaped = String::with_capacity(text.len());
    for letter in text.chars() {
        match letter {
            '&' => escaped.push_str("&amp;"),
            '<' => escaped.push_str("&lt;"),
            '>' => escaped.push_str("&gt;"),
            '"' => escaped.push_str("&quot;"),
            '\'' => escaped.push_str("&#39;"),
            // Not allowed in XML, not even escaped.
            letter if letter.is_control() && !matches!(letter, '\n' | '\t') => {
                escaped.push('\u{fffd}');
            }
            letter => escaped.push(letter),
        }
    }
    escaped
}
