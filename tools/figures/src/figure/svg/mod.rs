//! Drawing a figure as SVG, in mm: the only place that knows how pictures are made.
//!
//! What a page that holds the picture may want to restyle has a class; what stands
//! in the attributes is for print.

mod annotate;
mod area;
mod map;
mod write;

use std::fmt::{self, Write as _};

use self::{
    area::{Area, areas},
    write::{line, mark_shape, number, pen, text, through},
};
use super::{
    Axis, Curve, Figure, Mark, Panel, Rule, Symbol,
    legend::{self, Entry, Key},
    page::{INK, LINE_HEIGHT, MARGIN, NAME_SIZE, TEXT_SIZE, TICK_GAP},
    place::{Obstacles, Slot},
    thin::{envelope, pieces, thin},
    typeset,
    xml::escaped,
};

/// Nothing smaller than this can be seen, in mm.
const TOLERANCE: f64 = 0.03;
/// Of a line that only goes to the right, no more is drawn in a column of this
/// width than its extremes, in mm.
const COLUMN: f64 = 0.1;
const FAINT: &str = "#dedede";
const SHADE: &str = "#f1dfb6";
const FONT: &str = "Helvetica, Arial, 'Liberation Sans', 'DejaVu Sans', sans-serif";

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
        // The shades reach up to the frame, where the topmost tick may be.
        let mapped = self.panels.iter().any(|panel| panel.map.is_some());
        let top = top + if mapped { 0.8 } else { 0.0 };
        let areas = areas(self, top);
        let bottom = areas.iter().map(Area::end).fold(top, f64::max);
        let height = bottom + MARGIN;
        let width_text = number(width);
        writeln!(
            svg,
            r#"<svg xmlns="http://www.w3.org/2000/svg" role="img" width="{width_text}mm" height="{height}mm" viewBox="0 0 {width_text} {height}" font-family="{FONT}" font-size="{TEXT_SIZE}" fill="none" stroke-linejoin="round">"#,
            height = number(height),
        )?;
        writeln!(
            svg,
            "<title>{}</title>",
            escaped(&typeset::plain(&self.title))
        )?;
        writeln!(
            svg,
            "<desc>{}</desc>",
            escaped(&typeset::plain(&self.caption))
        )?;
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
    if !panel.title.is_empty() {
        let middle = 0.5 * (left + right);
        text(svg, [middle, top - 1.6], "middle", &panel.title)?;
    }
    let mut obstacles = obstacles(panel, area);
    let labels = annotate::place(panel, area, &mut obstacles);
    let taken: Vec<Slot> = labels.iter().map(|label| label.slot).collect();
    if let Some(map) = &panel.map {
        map::draw_bands(svg, map, area, &taken)?;
    }
    for span in &panel.spans {
        draw_span(svg, panel.span_name, *span, area)?;
    }
    // On a map they would be taken for lines of equal value.
    if panel.map.is_none() {
        draw_grid(svg, area)?;
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
    if let Some(map) = &panel.map {
        let lines = map::isolines(map, area);
        map::draw_isolines(svg, &lines, area, &mut obstacles, taken)?;
    }
    for level in &panel.levels {
        annotate::draw_level(svg, level, area)?;
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
    for estimate in &panel.estimates {
        annotate::draw_estimate(svg, estimate, area)?;
    }
    for mark in &panel.marks {
        draw_mark(svg, mark, area)?;
    }
    for (value, label) in &area.x_ticks {
        let x = area.x.at(*value);
        line(svg, "ink", INK, 0.2, [x, bottom, x, bottom - 0.9])?;
        for (index, label) in label.iter().enumerate() {
            let y = bottom + TICK_GAP + 2.0 + index as f64 * LINE_HEIGHT;
            text(svg, [x, y], "middle", label)?;
        }
    }
    for (value, label) in &area.y_ticks {
        let y = area.y.at(*value);
        line(svg, "ink", INK, 0.2, [left, y, left + 0.9, y])?;
        text(svg, [left - TICK_GAP, y + 0.85], "end", label)?;
    }
    if panel.names.is_empty() {
        let place = format!(
            r#"x="{}" y="{}""#,
            number(0.5 * (left + right)),
            number(bottom + 7.8)
        );
        axis_name(svg, &panel.x, &place)?;
    }
    let ticks = area.y_ticks.iter();
    let widest = ticks
        .map(|(_, text)| typeset::width(text))
        .fold(0.0, f64::max);
    let (x, y) = (left - TICK_GAP - widest - 1.4, 0.5 * (top + bottom));
    let place = format!(
        r#"transform="translate({} {}) rotate(-90)""#,
        number(x),
        number(y)
    );
    axis_name(svg, &panel.y, &place)?;
    annotate::draw_labels(svg, &labels)?;
    svg.push_str("</g>\n");
    Ok(())
}

fn draw_grid(svg: &mut String, area: &Area) -> fmt::Result {
    // What belongs to a name lies between two lines.
    let aside = if area.named { 0.5 } else { 0.0 };
    for (value, _) in &area.x_ticks {
        let x = area.x.at(*value + aside);
        line(svg, "grid", FAINT, 0.12, [x, area.top, x, area.bottom])?;
    }
    for (value, _) in &area.y_ticks {
        let y = area.y.at(*value);
        line(svg, "grid", FAINT, 0.12, [area.left, y, area.right, y])?;
    }
    Ok(())
}

/// What labels keep clear of. Only a panel with labels of its own needs them.
fn obstacles(panel: &Panel, area: &Area) -> Obstacles {
    let mut obstacles = Obstacles::default();
    if panel.map.is_none() && panel.levels.is_empty() && panel.callouts.is_empty() {
        return obstacles;
    }
    let place = |[x, y]: [f64; 2]| [area.x.at(x), area.y.at(y)];
    for curve in &panel.curves {
        for piece in pieces(curve.points().map(place)) {
            obstacles.line(&thin(&piece, TOLERANCE));
        }
    }
    for level in &panel.levels {
        let y = area.y.at(level.value);
        obstacles.line(&[[area.left, y], [area.right, y]]);
    }
    let marks = panel.marks.iter().map(|mark| mark.point);
    let points = panel.callouts.iter().flat_map(|all| &all.points);
    for [x, y] in marks.chain(points.map(|callout| callout.point)).map(place) {
        obstacles.line(&[[x - 1.0, y - 1.0], [x + 1.0, y + 1.0]]);
        obstacles.line(&[[x - 1.0, y + 1.0], [x + 1.0, y - 1.0]]);
    }
    obstacles
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
        through(svg, &piece)?;
        if piece.len() == 1 {
            // A dot, by the round cap.
            svg.push_str("h0");
        }
    }
    writeln!(svg, r#""><title>{}</title></path>"#, escaped(curve.name))
}

fn draw_rule(svg: &mut String, rule: &Rule, index: usize, area: &Area) -> fmt::Result {
    let x = area.x.at(rule.value);
    line(svg, "rule", INK, 0.2, [x, area.top, x, area.bottom])?;
    // One below the other, on the right if there is room.
    let y = area.top + 3.0 + 3.2 * index as f64;
    let room = area.right - x - typeset::width(&rule.name);
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

fn draw_entry(svg: &mut String, entry: &Entry, left: f64, middle: f64) -> fmt::Result {
    let right = left + legend::KEY_WIDTH;
    let centre = [0.5 * (left + right), middle];
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
            mark_shape(svg, kind, centre)?;
            svg.push_str("</path>\n");
        }
        Key::Span => writeln!(
            svg,
            r#"<rect class="span" x="{}" y="{}" width="{}" height="2.4" fill="{SHADE}"/>"#,
            number(left),
            number(middle - 1.2),
            legend::KEY_WIDTH,
        )?,
        Key::Shade(shade) => map::draw_key(svg, shade, left, middle)?,
        Key::Isoline => map::draw_dotted(svg, "isoline", &[[left, middle], [right, middle]])?,
        Key::Leader => annotate::draw_leader(svg, &[[left + 0.8, middle], [right, middle]])?,
        Key::Estimate(kind) => {
            annotate::draw_interval(svg, centre[0], [middle - 1.3, middle + 1.3])?;
            mark_shape(svg, kind, centre)?;
            svg.push_str("</path>\n");
        }
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
        typeset::symbol(svg, letter, below)?;
    }
    if !axis.unit.is_empty() {
        write!(svg, " ({})", escaped(axis.unit))?;
    }
    svg.push_str("</text>\n");
    Ok(())
}
