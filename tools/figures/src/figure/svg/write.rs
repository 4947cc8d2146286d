//! The smallest parts of a picture.

use std::fmt::{self, Write as _};

use crate::figure::{
    look::{Look, MarkKind},
    page::{INK, TEXT_SIZE},
    place::Slot,
    scale::trimmed,
    typeset,
};

/// A text in the small size, from, around or up to a place on its base line.
pub(super) fn text(svg: &mut String, [x, y]: [f64; 2], anchor: &str, content: &str) -> fmt::Result {
    write!(
        svg,
        r#"<text class="ink" fill="{INK}" text-anchor="{anchor}" x="{}" y="{}">"#,
        number(x),
        number(y),
    )?;
    typeset::content(svg, content)?;
    svg.push_str("</text>\n");
    Ok(())
}

/// A text in the middle of its slot.
pub(super) fn label(svg: &mut String, slot: &Slot, content: &str) -> fmt::Result {
    let [x, y] = slot.centre;
    write!(
        svg,
        r#"<text class="ink label" fill="{INK}" text-anchor="middle" transform="translate({} {})"#,
        number(x),
        number(y)
    )?;
    if slot.angle != 0.0 {
        write!(svg, " rotate({})", number(slot.angle.to_degrees()))?;
    }
    write!(svg, r#"" y="{}">"#, number(0.35 * TEXT_SIZE))?;
    typeset::content(svg, content)?;
    svg.push_str("</text>\n");
    Ok(())
}

pub(super) fn line(
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

/// The data of a path through points.
pub(super) fn through(svg: &mut String, points: &[[f64; 2]]) -> fmt::Result {
    for (index, [x, y]) in points.iter().enumerate() {
        let command = if index == 0 { 'M' } else { 'L' };
        write!(svg, "{command}{} {}", number(*x), number(*y))?;
    }
    Ok(())
}

/// A length to a hundredth of a mm, without needless digits.
pub(super) fn number(value: f64) -> String {
    trimmed(value, 2)
}

/// Colour, width and dashes of a look. The greys differ as the colours do.
pub(super) const fn pen(look: Look) -> &'static str {
    match look {
        Look::Nominal => r##"stroke="#9a9a9a" stroke-width="0.6" stroke-linecap="round""##,
        Look::Actual => r##"stroke="#1a1a1a" stroke-width="0.3" stroke-linecap="round""##,
        Look::Measured => r##"stroke="#d59a4a" stroke-width="0.2" stroke-linecap="round""##,
        Look::Truth => r##"stroke="#2166ac" stroke-width="0.25" stroke-dasharray="1.1 0.6""##,
        Look::Lost => r##"stroke="#f1dfb6" stroke-width="2.2" stroke-linecap="butt""##,
        Look::Other => r##"stroke="#1a1a1a" stroke-width="0.3" stroke-dasharray="2.2 0.7""##,
        Look::Boundary => r##"stroke="#1a1a1a" stroke-width="0.55" stroke-linecap="round""##,
        Look::RangeEnd => r##"stroke="#1a1a1a" stroke-width="0.22" stroke-dasharray="1.4 0.7""##,
        Look::Asymptote => {
            r##"stroke="#1a1a1a" stroke-width="0.22" stroke-dasharray="2 0.6 0.3 0.6""##
        }
    }
}

/// The opening tag of a mark.
pub(super) fn mark_shape(svg: &mut String, kind: MarkKind, [x, y]: [f64; 2]) -> fmt::Result {
    let (shape, fill) = match kind {
        MarkKind::Start => ("m0 -1.25l1.2 2.1h-2.4z", "#ffffff"),
        MarkKind::End => (
            "m-1.05 0a1.05 1.05 0 1 0 2.1 0a1.05 1.05 0 1 0 -2.1 0z",
            "#ffffff",
        ),
        MarkKind::Found => ("m-0.7 0a0.7 0.7 0 1 0 1.4 0a0.7 0.7 0 1 0 -1.4 0z", INK),
        MarkKind::Square => ("m-0.85 -0.85h1.7v1.7h-1.7z", INK),
        MarkKind::Diamond => ("m0 -1.3l1.15 1.3l-1.15 1.3l-1.15 -1.3z", "#ffffff"),
        MarkKind::None => ("m-0.9 -0.9l1.8 1.8m0 -1.8l-1.8 1.8", "none"),
    };
    write!(
        svg,
        r##"<path class="mark {}" d="M{} {}{shape}" fill="{fill}" stroke="{INK}" stroke-width="0.35">"##,
        kind.class(),
        number(x),
        number(y),
    )
}
