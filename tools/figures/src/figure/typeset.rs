//! Texts: escaped for XML, how symbols in them are set, and about how wide they are.

use super::scale::trimmed;

/// Text that means nothing to XML.
pub fn escaped(text: &str) -> String {
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

/// Size of all text but the axes' names, in mm: 7 pt.
pub(super) const TEXT_SIZE: f64 = 2.47;
/// A part of a text.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Part<'a> {
    Plain(&'a str),
    Symbol { letter: &'a str, below: &'a str },
}

/// What stands between two dollar signs is a symbol; a dollar sign without a second
/// one is a dollar sign.
fn parts(text: &str) -> Vec<Part<'_>> {
    let mut parts = Vec::new();
    let mut rest = text;
    while let Some((before, (symbol, after))) = rest
        .split_once('$')
        .and_then(|(before, after)| Some((before, after.split_once('$')?)))
    {
        let (letter, below) = symbol.split_once('_').unwrap_or((symbol, ""));
        parts.push(Part::Plain(before));
        parts.push(Part::Symbol { letter, below });
        rest = after;
    }
    parts.push(Part::Plain(rest));
    parts.retain(|part| *part != Part::Plain(""));
    parts
}

/// The text where nothing can be set: in a title, or beside a picture.
pub fn plain(text: &str) -> String {
    let parts = parts(text).into_iter().map(|part| match part {
        Part::Plain(text) => text.to_owned(),
        Part::Symbol { letter, below: "" } => letter.to_owned(),
        Part::Symbol { letter, below } => format!("{letter}_{below}"),
    });
    parts.collect()
}

/// A name in lines that are at most `room` wide, broken after hyphens.
pub(super) fn broken(name: &str, room: f64) -> Vec<String> {
    let mut lines: Vec<String> = Vec::new();
    for part in name.split_inclusive('-') {
        match lines.last_mut() {
            Some(last) if width(last) + width(part) <= room => last.push_str(part),
            _ => lines.push(part.to_owned()),
        }
    }
    lines
}

/// The text as the content of an SVG text element of this size, in mm.
pub(super) fn content(text: &str, size: f64) -> String {
    let parts = parts(text).into_iter().map(|part| match part {
        Part::Plain(text) => escaped(text),
        Part::Symbol { letter, below } => symbol(letter, below, size),
    });
    parts.collect()
}

/// A letter in italics and what stands below it, upright; `size` is that of the text around it, in mm.
fn symbol(letter: &str, below: &str, size: f64) -> String {
    let letter = format!(r#"<tspan font-style="italic">{}</tspan>"#, escaped(letter));
    if below.is_empty() {
        return letter;
    }
    let below = escaped(below);
    // As a number: some renderers take a percentage to be that of the page.
    let size = trimmed(0.7 * size, 2);
    format!(
        r#"{letter}<tspan font-size="{size}" dy="0.7">{below}</tspan><tspan dy="-0.7">&#8203;</tspan>"#
    )
}

/// About how wide a text is in the small size, in mm: no font is known here, and too
/// wide is better than too narrow.
pub(super) fn width(text: &str) -> f64 {
    let parts = parts(text).into_iter();
    let widths = parts.map(|part| match part {
        Part::Plain(text) => plain_width(text),
        Part::Symbol { letter, below } => plain_width(letter) + 0.7 * plain_width(below),
    });
    widths.sum()
}

fn plain_width(text: &str) -> f64 {
    let per_letter = |letter: char| match letter {
        'i' | 'j' | 'l' | 't' | 'f' | '.' | ',' | ' ' | '(' | ')' => 0.32,
        'm' | 'w' | 'M' | 'W' => 0.86,
        letter if letter.is_uppercase() => 0.7,
        _ => 0.57,
    };
    TEXT_SIZE * text.chars().map(per_letter).sum::<f64>()
}

/// The digits of a power, raised.
pub fn superscript(digits: &str) -> String {
    let raised = |digit: char| "⁰¹²³⁴⁵⁶⁷⁸⁹".chars().nth(digit.to_digit(10)? as usize);
    let digits = digits.chars().map(|digit| match digit {
        '-' => '⁻',
        other => raised(other).unwrap_or(other),
    });
    digits.collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn symbols_are_set_and_the_rest_is_as_it_was() {
        assert_eq!(content("markers lost", TEXT_SIZE), "markers lost");
        let set = content("−$l_f$ & more", TEXT_SIZE);
        let letter = r#"−<tspan font-style="italic">l</tspan><tspan font-size="1.73" dy="0.7">f<"#;
        assert!(set.starts_with(letter), "{set}");
        assert!(set.ends_with("</tspan> &amp; more"), "{set}");
    }

    #[test]
    fn a_single_dollar_is_a_dollar() {
        assert_eq!(content("5 $", TEXT_SIZE), "5 $");
        assert_eq!(plain("$a$ costs 5 $"), "a costs 5 $");
    }

    #[test]
    fn what_cannot_be_set_is_readable() {
        assert_eq!(plain("dl from −$l_f$ to $l_r$"), "dl from −l_f to l_r");
    }

    #[test]
    fn a_subscript_is_narrower_than_what_it_stands_under() {
        let wide = width("$CC$");
        assert!(width("$C_C$") < wide && width("$C_C$") > width("$C$"));
    }
}
