//! The smallest parts of a picture.

use crate::figure::{
    page::{INK, Look, MarkKind},
    place::Slot,
    scale::trimmed,
    typeset::{self, TEXT_SIZE, escaped},
};

const PAPER: &str = "#ffffff";
/// Ends an element: each has a line.
pub(super) const END: char = '\n';
const ROUND: &str = r#"linecap="round""#;

/// A text in the small size, from, around or up to a place on its base line.
pub(super) fn text(place: [f64; 2], anchor: &str, text: &str) -> String {
    let (x, anchor) = match anchor {
        "middle" => centred(place[0], text, TEXT_SIZE),
        other => (place[0], other),
    };
    let ([x, y], content) = ([x, place[1]].map(number), typeset::content(text, TEXT_SIZE));
    format!(
        r#"<text class="ink" fill="{INK}" text-anchor="{anchor}" x="{x}" y="{y}">{content}</text>{END}"#
    )
}

/// A text in the middle of its slot.
pub(super) fn label(slot: &Slot, text: &str) -> String {
    let turn = (slot.centre, slot.angle.to_degrees());
    turned("ink label", turn, 0.35 * TEXT_SIZE, (text, TEXT_SIZE))
}

/// A text with its size, around a place and turned there by an angle in degrees; its base line is `below`.
pub(super) fn turned(
    class: &str,
    ([x, y], degrees): ([f64; 2], f64),
    below: f64,
    (text, size): (&str, f64),
) -> String {
    let ([x, y], below) = ([x, y].map(number), number(below));
    let mut transform = format!("translate({x} {y})");
    if degrees != 0.0 {
        transform += &format!(" rotate({})", number(degrees));
    }
    let (start, anchor) = centred(0.0, text, size);
    let (start, content) = (number(start), typeset::content(text, size));
    format!(
        r#"<text class="{class}" fill="{INK}" font-size="{size}" text-anchor="{anchor}" transform="{transform}" x="{start}" y="{below}">{content}</text>{END}"#
    )
}

/// Where a text around `x` begins, and how it is anchored. One with symbols begins where its estimated
/// width says: some renderers centre each of its parts by itself.
fn centred(x: f64, text: &str, size: f64) -> (f64, &'static str) {
    if typeset::content(text, size).contains('<') {
        (x - 0.46 * typeset::width(text) * size / TEXT_SIZE, "start")
    } else {
        (x, "middle")
    }
}

pub(super) fn line(class: &str, colour: &str, width: f64, ends: [f64; 4]) -> String {
    let [x1, y1, x2, y2] = ends.map(number);
    format!(
        r#"<path class="{class}" stroke="{colour}" stroke-width="{width}" d="M{x1} {y1}L{x2} {y2}"/>{END}"#
    )
}

/// The attributes of a rectangle, from its corner, width and height.
pub(super) fn rectangle(class: &str, edges: [f64; 4]) -> String {
    let [x, y, width, height] = edges.map(number);
    format!(r#"class="{class}" x="{x}" y="{y}" width="{width}" height="{height}""#)
}

/// The data of a path through points.
pub(super) fn through(points: &[[f64; 2]]) -> String {
    let mut data = String::new();
    for [x, y] in points {
        data.push(if data.is_empty() { 'M' } else { 'L' });
        data += &format!("{} {}", number(*x), number(*y));
    }
    data
}

/// A length to a hundredth of a mm, without needless digits.
pub(super) fn number(value: f64) -> String {
    trimmed(value, 2)
}

/// Class, colour, width and dashes of a look. The greys differ as the colours do.
pub(super) fn pen(look: Look) -> String {
    let (colour, width, end) = match look {
        Look::Nominal => ("#9a9a9a", 0.6, ROUND),
        Look::Actual => (INK, 0.3, ROUND),
        Look::Measured => ("#d59a4a", 0.2, ROUND),
        Look::Truth => ("#2166ac", 0.25, r#"dasharray="1.1 0.6""#),
        Look::Lost => ("#f1dfb6", 2.2, r#"linecap="butt""#),
        Look::Other => (INK, 0.3, r#"dasharray="2.2 0.7""#),
        Look::Boundary => (INK, 0.55, ROUND),
        Look::RangeEnd => (INK, 0.22, r#"dasharray="1.4 0.7""#),
        Look::Asymptote => (INK, 0.22, r#"dasharray="2 0.6 0.3 0.6""#),
    };
    format!(r#"class="{look}" stroke="{colour}" stroke-width="{width}" stroke-{end}"#)
}

/// A mark; `title` is its element, or empty.
pub(super) fn mark(kind: MarkKind, place: [f64; 2], title: &str) -> String {
    let (shape, fill) = match kind {
        MarkKind::Start => ("m0 -1.25l1.2 2.1h-2.4z", PAPER),
        MarkKind::End => (
            "m-1.05 0a1.05 1.05 0 1 0 2.1 0a1.05 1.05 0 1 0 -2.1 0z",
            PAPER,
        ),
        MarkKind::Found => ("m-0.7 0a0.7 0.7 0 1 0 1.4 0a0.7 0.7 0 1 0 -1.4 0z", INK),
        MarkKind::Square => ("m-0.85 -0.85h1.7v1.7h-1.7z", INK),
        MarkKind::Diamond => ("m0 -1.3l1.15 1.3l-1.15 1.3l-1.15 -1.3z", PAPER),
        MarkKind::None => ("m-0.9 -0.9l1.8 1.8m0 -1.8l-1.8 1.8", "none"),
    };
    let [x, y] = place.map(number);
    format!(
        r#"<path class="mark {kind}" d="M{x} {y}{shape}" fill="{fill}" stroke="{INK}" stroke-width="0.35">{title}</path>{END}"#
    )
}

/// The element that names what it is in; a screen shows it under the pointer.
pub(super) fn title(name: &str, values: &str) -> String {
    format!("<title>{}{values}</title>", escaped(&typeset::plain(name)))
}
