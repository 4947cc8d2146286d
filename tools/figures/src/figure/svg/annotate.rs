//! What is written beside lines and points, where there is room.

use super::{
    map::draw_dotted,
    write::{END, label, line, mark, number, pen, through, title},
};
use crate::figure::{
    Estimate, Level, Panel,
    page::{Area, INK},
    place::{Obstacles, Segment, Slot},
    typeset::{self, TEXT_SIZE},
};

/// Half the height of a label's slot, in mm: 'x' and figures, not every descender.
const HALF_HEIGHT: f64 = 0.42 * TEXT_SIZE;
/// From a line to a label beside it, in mm.
const ASIDE: f64 = 0.9;
/// How long a leader is, in mm, and how long it may be.
const LEADER: f64 = 3.5;
const LEADERS: [f64; 8] = [2.0, 2.7, LEADER, 5.0, 7.0, 9.0, 12.0, 15.0];
/// Directions a leader may have, all round.
const DIRECTIONS: i32 = 24;
/// Half the width of an interval's ends, in mm.
const CAP: f64 = 0.7;

/// A label with its place.
pub(super) struct Placed<'a> {
    pub(super) slot: Slot,
    text: &'a str,
    /// From the point that it is about.
    leader: Option<Segment>,
}

/// The labels of a panel's callouts and levels, which have more choice, each clear of the obstacles, to which
/// they are added.
pub(super) fn place<'a>(
    panel: &'a Panel,
    area: &Area,
    obstacles: &mut Obstacles,
) -> Vec<Placed<'a>> {
    let mut placed = Vec::new();
    for callouts in &panel.callouts {
        let mut before = None;
        for callout in &callouts.points {
            let point = [area.x.at(callout.point[0]), area.y.at(callout.point[1])];
            let found = led(point, &callout.label, area, obstacles, before);
            if let Some((slot, leader, direction)) = found {
                obstacles.label(&slot);
                obstacles.line(&leader);
                before = Some(direction);
                placed.push(Placed {
                    slot,
                    text: &callout.label,
                    leader: Some(leader),
                });
            }
        }
    }
    for level in &panel.levels {
        if let Some(slot) = beside(level, area, obstacles) {
            obstacles.label(&slot);
            let (text, leader) = (level.label.as_str(), None);
            placed.push(Placed { slot, text, leader });
        }
    }
    placed
}

/// Beside a level, above or below, as far right as there is room.
fn beside(level: &Level, area: &Area, obstacles: &Obstacles) -> Option<Slot> {
    let width = typeset::width(&level.label);
    if width == 0.0 || !area.y.holds(level.value) {
        return None;
    }
    let y = area.y.at(level.value);
    let half = 0.5 * width;
    let steps = ((area.right - area.left) / 2.0) as usize;
    (0..steps)
        .flat_map(|step| [(step, -1.0), (step, 1.0)])
        .map(|(step, side)| Slot {
            centre: [
                area.right - 1.5 - half - 2.0 * step as f64,
                y + side * (HALF_HEIGHT + ASIDE),
            ],
            half: [half, HALF_HEIGHT],
            angle: 0.0,
        })
        .find(|slot| area.holds(slot) && obstacles.is_free(slot))
}

/// At the end of a leader from a point: a short one, in about the direction of the
/// one before.
fn led(
    point: [f64; 2],
    text: &str,
    area: &Area,
    obstacles: &Obstacles,
    before: Option<f64>,
) -> Option<(Slot, Segment, f64)> {
    let half = [0.5 * typeset::width(text), HALF_HEIGHT];
    let mut best: Option<(f64, Slot, Segment, f64)> = None;
    for reach in LEADERS {
        for index in 0..DIRECTIONS {
            let direction = std::f64::consts::TAU * f64::from(index) / f64::from(DIRECTIONS);
            let (sin, cos) = direction.sin_cos();
            let end = [point[0] + reach * cos, point[1] + reach * sin];
            // The leader ends at the nearest edge of the text.
            let slot = Slot {
                centre: [
                    end[0] + cos * (half[0] + ASIDE),
                    end[1] + sin * (half[1] + ASIDE),
                ],
                half,
                angle: 0.0,
            };
            let leader = [point, end];
            if !area.holds(&slot) || !obstacles.is_free(&slot) {
                continue;
            }
            let turn = before.map_or(0.0, |before: f64| 1.0 - (direction - before).cos());
            let crossings = obstacles.crossings(leader) as f64;
            let cost = (reach - LEADER).abs()
                + 3.0 * turn
                + 20.0 * crossings
                + 0.1 * obstacles.beneath(&slot);
            if best.is_none_or(|(least, ..)| cost < least - 1e-9) {
                best = Some((cost, slot, leader, direction));
            }
        }
    }
    best.map(|(_, slot, leader, direction)| (slot, leader, direction))
}

/// Labels over all that is drawn, with their leaders.
pub(super) fn draw_labels(placed: &[Placed]) -> String {
    let labels = placed.iter().map(|Placed { slot, text, leader }| {
        let leader = leader.as_ref().map(draw_leader);
        leader.unwrap_or_default() + &label(slot, text)
    });
    labels.collect()
}

/// A dotted line that begins with a dot.
pub(super) fn draw_leader(leader: &Segment) -> String {
    let [x, y] = leader[0].map(number);
    draw_dotted("leader", leader)
        + &format!(r#"<circle class="point" cx="{x}" cy="{y}" r="0.62" fill="{INK}"/>{END}"#)
}

pub(super) fn draw_level(level: &Level, area: &Area) -> String {
    if !area.y.holds(level.value) {
        return String::new();
    }
    let y = area.y.at(level.value);
    let (pen, data) = (pen(level.look), through(&[[area.left, y], [area.right, y]]));
    let title = title(&level.name, &format!(": {}", level.value));
    format!(r#"<path {pen} d="{data}">{title}</path>{END}"#)
}

pub(super) fn draw_estimate(estimate: &Estimate, area: &Area) -> String {
    let x = area.x.at(estimate.x);
    let value = area.y.at(estimate.value);
    if !(x.is_finite() && value.is_finite()) {
        return String::new();
    }
    let ends = estimate.interval.map(|end| area.y.at(end));
    let interval = match ends.iter().all(|end| end.is_finite()) {
        true => draw_interval(x, ends),
        false => String::new(),
    };
    let [low, high] = estimate.interval;
    let values = format!(": {} ({low} to {high})", estimate.value);
    let title = title(&estimate.name, &values);
    interval + &mark(estimate.kind, [x, value], &title)
}

/// The bar of an interval, with a cap at each end.
pub(super) fn draw_interval(x: f64, [low, high]: [f64; 2]) -> String {
    let line = |ends| line("interval", INK, 0.25, ends);
    let caps = [low, high].map(|end| line([x - CAP, end, x + CAP, end]));
    line([x, low, x, high]) + &caps.concat()
}
