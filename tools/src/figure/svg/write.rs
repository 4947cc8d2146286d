//! The smallest parts of a picture.

use std::fmt::{self, Write as _};

use super::{INK, TEXT_SIZE};
use crate::figure::{place::Slot, typeset};

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
