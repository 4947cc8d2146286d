//! A map: shades, and lines of equal value with their labels.

use super::write::{END, label, number, through, title};
use crate::figure::{
    Isoline, Map, Shade,
    contours::{Sheet, hatch},
    page::{self, Area},
    place::{Obstacles, RIM, Slot, between, interrupted, length, segments},
    thin::{Piece, thin},
    typeset::{self, TEXT_SIZE},
};

/// Nothing smaller than this can be seen of an area's edge, in mm.
const TOLERANCE: f64 = 0.02;
/// A label that would read downwards more steeply than this reads upwards, in rad.
const STEEP: f64 = 1.4;
/// A piece of a line that is not the longest has a label of its own from this length
/// on, in mm.
const LONG: f64 = 25.0;
/// A line that is longer than this has more than one label, in mm.
const EVERY: f64 = 40.0;
/// Places that cost more than this are worse than no label.
const WORST: f64 = 3.5;
/// Candidates for a label are so far from each other along a line, in mm.
const STEP: f64 = 0.7;

/// The shades, in their order. Hatching leaves the labels free.
pub(super) fn draw_bands(map: &Map, area: &Area, taken: &[Slot]) -> String {
    let sheet = Sheet::new(&map.grid, &area.x, &area.y);
    let bands = map.bands.iter().map(|band| {
        let rings = sheet.area(band.from, band.to);
        let rings: Vec<Piece> = rings.iter().map(|ring| thin(ring, TOLERANCE)).collect();
        draw_shade(band.shade, &rings, taken, &title(&band.name, ""))
    });
    bands.collect()
}

/// What is in an odd number of the rings; `title` is its element, or empty.
fn draw_shade(shade: Shade, rings: &[Piece], taken: &[Slot], title: &str) -> String {
    let data: String = if shade == Shade::Hatched {
        let lines = hatch(rings).into_iter();
        let pieces = lines.flat_map(|line| interrupted(&line, taken));
        pieces.map(|piece| through(&piece)).collect()
    } else {
        rings.iter().map(|ring| through(ring) + "z").collect()
    };
    let paint = paint(shade);
    format!(r#"<path class="shade {shade}" {paint} d="{data}">{title}</path>{END}"#)
}

/// A shade's sample in a legend.
pub(super) fn draw_key(shade: Shade, left: f64, middle: f64) -> String {
    let (right, [top, bottom]) = (left + page::KEY_WIDTH, [middle - 1.2, middle + 1.2]);
    let ring = vec![
        [left, top],
        [right, top],
        [right, bottom],
        [left, bottom],
        [left, top],
    ];
    draw_shade(shade, &[ring], &[], "")
}

/// A dotted line.
pub(super) fn draw_dotted(class: &str, points: &[[f64; 2]]) -> String {
    let data = through(points);
    format!(r#"<path class="{class}" {DOTTED} d="{data}"/>{END}"#)
}

/// How a dotted path is painted: in print as on a screen.
const DOTTED: &str =
    r##"stroke="#1a1a1a" stroke-width="0.38" stroke-linecap="round" stroke-dasharray="0.01 0.8""##;

/// How a shade is painted.
const fn paint(shade: Shade) -> &'static str {
    match shade {
        Shade::Palest => r##"fill="#f3f3f3" fill-rule="evenodd""##,
        Shade::Light => r##"fill="#e0e0e0" fill-rule="evenodd""##,
        Shade::Dark => r##"fill="#a6a6a6" fill-rule="evenodd""##,
        Shade::Hatched => r##"stroke="#1a1a1a" stroke-width="0.15""##,
    }
}

/// Draws the lines of equal value with their labels, which keep clear of the obstacles and of each
/// other.
pub(super) fn draw_isolines(
    map: &Map,
    area: &Area,
    obstacles: &mut Obstacles,
    mut taken: Vec<Slot>,
) -> String {
    let sheet = Sheet::new(&map.grid, &area.x, &area.y);
    let lines = map.isolines.iter();
    let lines = lines.map(|isoline| (isoline, sheet.lines(isoline.value)));
    // Those that are reached.
    let lines: Vec<_> = lines.filter(|(_, pieces)| !pieces.is_empty()).collect();
    for piece in lines.iter().flat_map(|(_, pieces)| pieces) {
        obstacles.faint_line(&thin(piece, TOLERANCE));
    }
    let mut labels = Vec::new();
    for (Isoline { label, .. }, pieces) in &lines {
        let width = typeset::width(label);
        if width == 0.0 {
            continue;
        }
        let extent = |piece: &Piece| segments(piece).map(length).sum::<f64>();
        let longest = pieces.iter().map(extent).fold(0.0, f64::max);
        let is_long = |piece: &&Piece| extent(piece) >= longest.min(LONG);
        for piece in pieces.iter().filter(is_long) {
            let parts = (extent(piece) / EVERY).floor().max(1.0) as usize;
            let walk = Walk::along(piece);
            for part in 0..parts {
                let share = [part, part + 1].map(|end| end as f64 / parts as f64);
                if let Some(slot) = room(&walk, share, width, area, obstacles) {
                    obstacles.label(&slot);
                    taken.push(slot);
                    labels.push((slot, label));
                }
            }
        }
    }
    let lines = lines.iter().map(|(isoline, pieces)| {
        let pieces = pieces.iter().flat_map(|piece| interrupted(piece, &taken));
        let pieces = pieces.map(|piece| through(&thin(&piece, TOLERANCE)));
        let data: String = pieces.collect();
        let title = match isoline.label.as_str() {
            "" => title(&number(isoline.value), ""),
            label => title(label, ""),
        };
        format!(r#"<path class="isoline" {DOTTED} d="{data}">{title}</path>{END}"#)
    });
    let labels = labels.iter().map(|(slot, text)| label(slot, text));
    lines.chain(labels).collect()
}

/// The best place for a label of that width in a line between two parts of its
/// length, if there is any.
fn room(
    walk: &Walk,
    share: [f64; 2],
    width: f64,
    area: &Area,
    obstacles: &Obstacles,
) -> Option<Slot> {
    let [start, end] = share.map(|part| part * walk.length());
    let half = 0.5 * width + 0.5;
    let count = ((end - start - 2.0 * half) / STEP).floor();
    if count < 0.0 {
        return None;
    }
    let mut best: Option<(f64, Slot)> = None;
    for index in 0..=count as usize {
        let middle = start + half + index as f64 * STEP;
        let (from, to) = (walk.at(middle - half)?, walk.at(middle + half)?);
        let on_line = walk.at(middle)?;
        let centre = [0.5 * (from[0] + to[0]), 0.5 * (from[1] + to[1])];
        let bend = length([centre, on_line]) + (2.0 * half - length([from, to])).abs();
        let mut angle = (to[1] - from[1]).atan2(to[0] - from[0]);
        // Never upside down, and steep ones read upwards.
        let half_turn = std::f64::consts::PI;
        if angle > STEEP {
            angle -= half_turn;
        } else if angle < STEEP - half_turn {
            angle += half_turn;
        }
        let slot = Slot {
            centre,
            half: [half, 0.42 * TEXT_SIZE],
            angle,
        };
        if !area.holds(&slot) || !obstacles.is_free(&slot) {
            continue;
        }
        // The line itself is beneath every slot.
        let others = (obstacles.beneath(&slot) - 2.0 * (half + RIM)).max(0.0);
        let aside = ((middle - start) / (end - start) - 0.5).abs();
        let cost = 2.0 * bend + others + aside + 0.8 * angle.sin().abs();
        if best.is_none_or(|(least, _)| cost < least) {
            best = Some((cost, slot));
        }
    }
    let (_, slot) = best.filter(|(cost, _)| *cost < WORST)?;
    Some(slot)
}

/// A line by the way along it.
struct Walk<'a> {
    points: &'a [[f64; 2]],
    /// From the first point to each, in mm.
    way: Vec<f64>,
}

impl<'a> Walk<'a> {
    fn along(points: &'a [[f64; 2]]) -> Self {
        let mut so_far = 0.0;
        let mut way = vec![0.0];
        way.extend(segments(points).map(|segment| {
            so_far += length(segment);
            so_far
        }));
        Self { points, way }
    }

    fn length(&self) -> f64 {
        self.way.last().copied().unwrap_or(0.0)
    }

    fn at(&self, way: f64) -> Option<[f64; 2]> {
        let next = self.way.partition_point(|end| *end < way).max(1);
        let (Some(to), Some(end)) = (self.points.get(next), self.way.get(next)) else {
            return self.points.last().copied();
        };
        let (from, start) = (self.points.get(next - 1)?, self.way.get(next - 1)?);
        let part = if end > start {
            (way - start) / (end - start)
        } else {
            0.0
        };
        Some(between([*from, *to], part))
    }
}
