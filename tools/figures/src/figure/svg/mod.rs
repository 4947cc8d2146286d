//! Drawing a figure as SVG, in mm: the only place that knows how pictures are made.
//!
//! What a page that holds the picture may want to restyle has a class; what stands
//! in the attributes is for print.

mod annotate;
mod map;
mod write;

use self::write::{END, line, number, pen, rectangle, text, through, title, turned};
use super::{
    Axis, Bar, Curve, Figure, Mark, Panel, Rule, Symbol,
    page::{self, Area, Entry, INK, Key, LINE_HEIGHT, MARGIN, NAME_SIZE, TICK_GAP, areas, widest},
    place::{Obstacles, Slot},
    thin::{envelope, pieces, thin},
    typeset::{self, TEXT_SIZE, escaped},
};

/// Nothing smaller than this can be seen, in mm.
const TOLERANCE: f64 = 0.03;
/// Width of a column in which a line that only goes to the right is drawn by its
/// extremes, in mm.
const COLUMN: f64 = 0.1;
const FAINT: &str = "#dedede";
const SHADE: &str = "#f1dfb6";
const FONT: &str = "Helvetica, Arial, 'Liberation Sans', 'DejaVu Sans', sans-serif";

impl Figure {
    /// The figure as an SVG file, as large as it is to be printed.
    pub fn to_svg(&self) -> String {
        let size = |[width, height]: [f64; 2]| {
            let [width, height] = [width, height].map(number);
            format!(r#"width="{width}mm" height="{height}mm""#)
        };
        self.draw(size, "")
    }

    /// The figure for the screen: twice as large, in the colours of the reports.
    pub fn to_screen_svg(&self) -> String {
        // It is as high as the view box says.
        let size = |[width, _]: [f64; 2]| {
            let width = number(2.0 * 96.0 / 25.4 * width);
            format!(r#"class="static" width="{width}""#)
        };
        let style = format!(
            "\n<style>\n{}svg {{ background: var(--page); }}\n</style>",
            crate::plot::STYLE
        );
        self.draw(size, &style)
    }

    /// The picture, with the attributes that `size` makes of its size in mm.
    fn draw(&self, size: impl Fn([f64; 2]) -> String, style: &str) -> String {
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
        let size = size([width, bottom + MARGIN]);
        let [width, height] = [width, bottom + MARGIN].map(number);
        let caption = escaped(&typeset::plain(&self.caption));
        let title = title(&self.title, "");
        let entries = entries.iter().zip(&places).map(|(entry, (left, row))| {
            let middle = MARGIN + (*row as f64 + 0.5) * page::ROW_HEIGHT;
            draw_entry(entry, MARGIN + left, middle)
        });
        let panels = self.panels.iter().zip(&areas);
        let panels = panels.map(|(panel, area)| draw_panel(panel, area));
        let content: String = entries.chain(panels).collect();
        format!(
            r##"<svg xmlns="http://www.w3.org/2000/svg" role="img" {size} viewBox="0 0 {width} {height}" font-family="{FONT}" font-size="{TEXT_SIZE}" fill="none" stroke-linejoin="round">{style}
{title}
<desc>{caption}</desc>
<rect class="paper" width="100%" height="100%" fill="#ffffff"/>
{content}</svg>
"##
        )
    }
}

fn draw_panel(panel: &Panel, area: &Area) -> String {
    let (left, right, top, bottom) = (area.left, area.right, area.top, area.bottom);
    let mut svg = String::from("<g>\n");
    if !panel.title.is_empty() {
        let middle = 0.5 * (left + right);
        svg += &text([middle, top - 1.6], "middle", &panel.title);
    }
    let mut obstacles = obstacles(panel, area);
    let labels = annotate::place(panel, area, &mut obstacles);
    let taken: Vec<Slot> = labels.iter().map(|label| label.slot).collect();
    if let Some(map) = &panel.map {
        svg += &map::draw_bands(map, area, &taken);
    }
    let spans = panel.spans.iter();
    svg.extend(spans.map(|span| draw_span(panel.span_name, *span, area)));
    // On a map they would be taken for lines of equal value.
    if panel.map.is_none() {
        svg += &draw_grid(area);
    }
    svg.extend(panel.bars.iter().map(|bar| draw_bar(bar, area)));
    if let Some(map) = &panel.map {
        svg += &map::draw_isolines(map, area, &mut obstacles, taken);
    }
    let levels = panel.levels.iter();
    svg.extend(levels.map(|level| annotate::draw_level(level, area)));
    let curves = panel.curves.iter();
    svg.extend(curves.map(|curve| draw_curve(curve, area, panel.equal)));
    let frame = rectangle("frame", [left, top, right - left, bottom - top]);
    svg += &format!(r#"<rect {frame} stroke="{INK}" stroke-width="0.2"/>{END}"#);
    let rules = panel.rules.iter().enumerate();
    svg.extend(rules.map(|(index, rule)| draw_rule(rule, index, area)));
    let estimates = panel.estimates.iter();
    svg.extend(estimates.map(|estimate| annotate::draw_estimate(estimate, area)));
    svg.extend(panel.marks.iter().map(|mark| draw_mark(mark, area)));
    for (value, label) in &area.x_ticks {
        let x = area.x.at(*value);
        svg += &line("ink", INK, 0.2, [x, bottom, x, bottom - 0.9]);
        let y = |index: usize| bottom + TICK_GAP + 2.0 + index as f64 * LINE_HEIGHT;
        let lines = label.iter().enumerate();
        svg.extend(lines.map(|(index, line)| text([x, y(index)], "middle", line)));
    }
    for (value, label) in &area.y_ticks {
        let y = area.y.at(*value);
        svg += &line("ink", INK, 0.2, [left, y, left + 0.9, y]);
        svg += &text([left - TICK_GAP, y + 0.85], "end", label);
    }
    if panel.names.is_empty() {
        svg += &axis_name(&panel.x, [0.5 * (left + right), bottom + 7.8], 0.0);
    }
    let widest = widest(&area.y_ticks);
    let place = [left - TICK_GAP - widest - 1.4, 0.5 * (top + bottom)];
    svg + &axis_name(&panel.y, place, -90.0) + &annotate::draw_labels(&labels) + "</g>\n"
}

fn draw_bar(bar: &Bar, area: &Area) -> String {
    let [from, to] = bar.span.map(|end| area.x.at(end));
    let high = area.y.at(bar.height);
    let bar = rectangle("bar", [from, high, to - from, area.bottom - high]);
    format!(r##"<rect {bar} fill="#7d7d7d" stroke="#ffffff" stroke-width="0.08"/>{END}"##)
}

fn draw_grid(area: &Area) -> String {
    // What belongs to a name lies between two lines.
    let aside = if area.named { 0.5 } else { 0.0 };
    let line = |ends| line("grid", FAINT, 0.12, ends);
    let along_x = area.x_ticks.iter().map(|(value, _)| {
        let x = area.x.at(*value + aside);
        line([x, area.top, x, area.bottom])
    });
    let along_y = area.y_ticks.iter().map(|(value, _)| {
        let y = area.y.at(*value);
        line([area.left, y, area.right, y])
    });
    along_x.chain(along_y).collect()
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
fn draw_span(name: &str, [from, to]: [f64; 2], area: &Area) -> String {
    let [low, high] = area.x.range;
    if to < low || from > high {
        return String::new();
    }
    let (left, right) = (area.x.at(from.max(low)), area.x.at(to.min(high)));
    // Even the shortest can be seen.
    let width = (right - left).max(0.15);
    let span = rectangle("span", [left, area.top, width, area.bottom - area.top]);
    let title = title(name, &format!(": {from:.3} to {to:.3}"));
    format!(r#"<rect {span} fill="{SHADE}">{title}</rect>{END}"#)
}

fn draw_curve(curve: &Curve, area: &Area, equal: bool) -> String {
    if curve.is_empty() {
        return String::new();
    }
    let place = |[x, y]: [f64; 2]| [area.x.at(x), area.y.at(y)];
    let mut data = String::new();
    for piece in pieces(curve.points().map(place)) {
        let piece = match equal {
            true => piece,
            false => envelope(&piece, COLUMN),
        };
        let piece = thin(&piece, TOLERANCE);
        data += &through(&piece);
        if piece.len() == 1 {
            // A dot, by the round cap.
            data += "h0";
        }
    }
    let (pen, title) = (pen(curve.look), title(curve.name, ""));
    format!(r#"<path {pen} d="{data}">{title}</path>{END}"#)
}

fn draw_rule(rule: &Rule, index: usize, area: &Area) -> String {
    let x = area.x.at(rule.value);
    let line = line("rule", INK, 0.2, [x, area.top, x, area.bottom]);
    // One below the other, on the right if there is room.
    let y = area.top + 3.0 + 3.2 * index as f64;
    let room = area.right - x - typeset::width(&rule.name);
    let (x, anchor) = if room < 1.5 {
        (x - 0.8, "end")
    } else {
        (x + 0.8, "start")
    };
    let name = text([x, y], anchor, &rule.name);
    // Over the bars it has a rim in the colour of the paper, beneath it in every renderer.
    let rim = r##"<g class="rim" stroke="#ffffff" stroke-width="0.8">"##;
    format!("{line}{rim}{name}</g>\n{name}")
}

fn draw_mark(mark: &Mark, area: &Area) -> String {
    let Mark { kind, point, name } = *mark;
    let [x, y] = point;
    let title = title(name, &format!(" ({x:.3}, {y:.3})"));
    write::mark(kind, [area.x.at(x), area.y.at(y)], &title)
}

fn draw_entry((key, name): &Entry<'_>, left: f64, middle: f64) -> String {
    let right = left + key.width();
    let centre = [0.5 * (left + right), middle];
    let place = [left + key.text_offset(), middle + 0.85];
    let drawn = match *key {
        Key::Line(look) => {
            let (pen, start) = (pen(look), through(&[[left, middle]]));
            format!(r#"<path {pen} d="{start}h{}"/>{END}"#, page::KEY_WIDTH)
        }
        Key::Mark(kind) => write::mark(kind, centre, ""),
        Key::Span => {
            let span = rectangle("span", [left, middle - 1.2, page::KEY_WIDTH, 2.4]);
            format!(r#"<rect {span} fill="{SHADE}"/>{END}"#)
        }
        Key::Shade(shade) => map::draw_key(shade, left, middle),
        Key::Isoline => map::draw_dotted("isoline", &[[left, middle], [right, middle]]),
        Key::Leader => annotate::draw_leader(&[[left + 0.8, middle], [right, middle]]),
        Key::Estimate(kind) => {
            annotate::draw_interval(centre[0], [middle - 1.3, middle + 1.3])
                + &write::mark(kind, centre, "")
        }
    };
    drawn + &text(place, "start", name)
}

/// Name, symbol and unit of an axis, around a place.
fn axis_name(axis: &Axis, place: [f64; 2], degrees: f64) -> String {
    let symbol = axis.symbol.map(|Symbol { letter, below }| match below {
        "" => format!("${letter}$"),
        below => format!("${letter}_{below}$"),
    });
    let unit = (!axis.unit.is_empty()).then(|| format!("({})", axis.unit));
    let parts = [Some(axis.quantity.to_owned()), symbol, unit];
    let parts = parts.into_iter().flatten();
    let parts: Vec<String> = parts.filter(|part| !part.is_empty()).collect();
    let text = parts.join(" ");
    turned("ink", (place, degrees), 0.0, (&text, NAME_SIZE))
}
