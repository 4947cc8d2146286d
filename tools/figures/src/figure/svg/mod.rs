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
    area::{Area, areas, widest},
    write::{line, number, pen, rectangle, text, through, title, turned},
};
use super::{
    Axis, Curve, Figure, Mark, Panel, Rule, Symbol,
    page::{self, Entry, INK, Key, LINE_HEIGHT, MARGIN, NAME_SIZE, TICK_GAP},
    place::{Obstacles, Slot},
    thin::{envelope, pieces, thin},
    typeset::{self, TEXT_SIZE, escaped},
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
    pub fn to_svg(&self) -> String {
        let mut svg = String::new();
        // Writing to a string does not fail.
        let _ = self.draw(&mut svg);
        svg
    }

    /// The same for the screen: twice as large, in the colours of the reports.
    pub fn to_screen_svg(&self) -> String {
        let svg = self.to_svg();
        let (head, rest) = svg.split_once('>').unwrap_or((&svg, ""));
        // The height in mm goes: what is left is as high as the view box says.
        let (start, _) = head.split_once(" width=").unwrap_or((head, ""));
        let (_, end) = head.split_once("mm\" viewBox").unwrap_or(("", head));
        let width = number(2.0 * 96.0 / 25.4 * self.width.mm());
        format!(
            "{start} class=\"static\" width=\"{width}\" viewBox{end}>\n<style>\n{}\
             svg {{ background: var(--page); }}\n</style>{rest}",
            crate::plot::STYLE
        )
    }

    fn draw(&self, svg: &mut String) -> fmt::Result {
        let entries = page::entries(self);
        let width = self.width.mm();
        let places = page::places(&entries, width - 2.0 * MARGIN);
        let rows = places.last().map_or(0, |(_, row)| row + 1);
        let top = MARGIN + rows as f64 * page::ROW_HEIGHT + TICK_GAP;
        // The shades reach up to the frame, where the topmost tick may be.
        let mapped = self.panels.iter().any(|panel| panel.map.is_some());
        let top = top + if mapped { 0.8 } else { 0.0 };
        let areas = areas(self, top);
        let bottom = areas.iter().map(Area::end).fold(top, f64::max);
        let [width, height] = [width, bottom + MARGIN].map(number);
        writeln!(
            svg,
            r#"<svg xmlns="http://www.w3.org/2000/svg" role="img" width="{width}mm" height="{height}mm" viewBox="0 0 {width} {height}" font-family="{FONT}" font-size="{TEXT_SIZE}" fill="none" stroke-linejoin="round">"#,
        )?;
        let caption = escaped(&typeset::plain(&self.caption));
        writeln!(svg, "{}\n<desc>{caption}</desc>", title(&self.title, ""))?;
        writeln!(
            svg,
            r##"<rect class="paper" width="100%" height="100%" fill="#ffffff"/>"##
        )?;
        for (entry, (left, row)) in entries.iter().zip(&places) {
            let middle = MARGIN + (*row as f64 + 0.5) * page::ROW_HEIGHT;
            draw_entry(svg, entry, MARGIN + left, middle)?;
        }
        for (panel, area) in self.panels.iter().zip(&areas) {
            draw_panel(svg, panel, area)?;
        }
        writeln!(svg, "</svg>")
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
        let bar = rectangle("bar", [from, high, to - from, bottom - high]);
        writeln!(
            svg,
            r##"<rect {bar} fill="#7d7d7d" stroke="#ffffff" stroke-width="0.08"/>"##
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
    let frame = rectangle("frame", [left, top, right - left, bottom - top]);
    writeln!(svg, r#"<rect {frame} stroke="{INK}" stroke-width="0.2"/>"#)?;
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
        axis_name(svg, &panel.x, [0.5 * (left + right), bottom + 7.8], 0.0)?;
    }
    let widest = widest(&area.y_ticks);
    let place = [left - TICK_GAP - widest - 1.4, 0.5 * (top + bottom)];
    axis_name(svg, &panel.y, place, -90.0)?;
    annotate::draw_labels(svg, &labels)?;
    writeln!(svg, "</g>")
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
    let span = rectangle("span", [left, area.top, width, area.bottom - area.top]);
    let title = title(name, &format!(": {from:.3} to {to:.3}"));
    writeln!(svg, r#"<rect {span} fill="{SHADE}">{title}</rect>"#)
}

fn draw_curve(svg: &mut String, curve: &Curve, area: &Area, equal: bool) -> fmt::Result {
    if curve.is_empty() {
        return Ok(());
    }
    let place = |[x, y]: [f64; 2]| [area.x.at(x), area.y.at(y)];
    let mut data = String::new();
    for piece in pieces(curve.points().map(place)) {
        let piece = if equal {
            piece
        } else {
            envelope(&piece, COLUMN)
        };
        let piece = thin(&piece, TOLERANCE);
        data += &through(&piece);
        if piece.len() == 1 {
            // A dot, by the round cap.
            data += "h0";
        }
    }
    let (pen, title) = (pen(curve.look), title(curve.name, ""));
    writeln!(svg, r#"<path {pen} d="{data}">{title}</path>"#)
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
    // Over the bars it has a rim in the colour of the paper, beneath it in every renderer.
    svg.push_str(r##"<g class="rim" stroke="#ffffff" stroke-width="0.8">"##);
    text(svg, [x, y], anchor, &rule.name)?;
    svg.push_str("</g>\n");
    text(svg, [x, y], anchor, &rule.name)
}

fn draw_mark(svg: &mut String, mark: &Mark, area: &Area) -> fmt::Result {
    let Mark { kind, point, name } = *mark;
    let title = title(name, &format!(" ({:.3}, {:.3})", point[0], point[1]));
    write::mark(
        svg,
        kind,
        [area.x.at(point[0]), area.y.at(point[1])],
        &title,
    )
}

fn draw_entry(svg: &mut String, entry: &Entry, left: f64, middle: f64) -> fmt::Result {
    let right = left + entry.key.width();
    let centre = [0.5 * (left + right), middle];
    match entry.key {
        Key::Line(look) => {
            let (pen, start) = (pen(look), through(&[[left, middle]]));
            writeln!(svg, r#"<path {pen} d="{start}h{}"/>"#, page::KEY_WIDTH)?;
        }
        Key::Mark(kind) => write::mark(svg, kind, centre, "")?,
        Key::Span => {
            let span = rectangle("span", [left, middle - 1.2, page::KEY_WIDTH, 2.4]);
            writeln!(svg, r#"<rect {span} fill="{SHADE}"/>"#)?;
        }
        Key::Shade(shade) => map::draw_key(svg, shade, left, middle)?,
        Key::Isoline => map::draw_dotted(svg, "isoline", &[[left, middle], [right, middle]])?,
        Key::Leader => annotate::draw_leader(svg, &[[left + 0.8, middle], [right, middle]])?,
        Key::Estimate(kind) => {
            annotate::draw_interval(svg, centre[0], [middle - 1.3, middle + 1.3])?;
            write::mark(svg, kind, centre, "")?;
        }
    }
    let place = [left + entry.key.text_offset(), middle + 0.85];
    text(svg, place, "start", &entry.name)
}

/// Name, symbol and unit of an axis, around a place.
fn axis_name(svg: &mut String, axis: &Axis, place: [f64; 2], degrees: f64) -> fmt::Result {
    let symbol = axis.symbol.map(|Symbol { letter, below }| match below {
        "" => format!("${letter}$"),
        below => format!("${letter}_{below}$"),
    });
    let unit = (!axis.unit.is_empty()).then(|| format!("({})", axis.unit));
    let parts = [Some(axis.quantity.to_owned()), symbol, unit];
    let parts: Vec<String> = parts
        .into_iter()
        .flatten()
        .filter(|part| !part.is_empty())
        .collect();
    turned(
        svg,
        "ink",
        (place, degrees),
        0.0,
        (&parts.join(" "), NAME_SIZE),
    )
}
