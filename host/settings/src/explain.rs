//! Explains a parse error of a TOML text: line, key, value and fix.
//!
//! The parser reports the position of a mistake and what it expected. The author of the file
//! also needs the key, and what to write instead.

use core::ops::Range;

/// The longest piece of a file that a message quotes, in characters.
const LONGEST_QUOTE: usize = 60;

/// Names less similar than this do not count as a typing mistake.
const ALIKE: f64 = 0.8;

/// Explains why `text` does not parse.
#[must_use]
pub fn explain(text: &str, error: &toml::de::Error) -> String {
    let message = error.message().trim();
    let place = Place::find(text, error.span().unwrap_or_default());
    let line = place.line;
    let what = match fix(message, &place) {
        Some(fix) => format!("{message}; {fix}"),
        None => message.to_owned(),
    };
    if let Some(field) = quoted_after(message, "missing field ") {
        let key = join(&place.table, field);
        return format!("line {line}: {key} is missing; add it, as in singletrackd.example.toml");
    }
    match place.key {
        // A message of ours, which names the key.
        _ if message.starts_with(&format!("{}.", place.table)) => format!("line {line}: {what}"),
        Some(key) => match place.value {
            Some(value) => format!("line {line}: {key} = {}: {what}", quote(value)),
            None => format!("line {line}: {key}: {what}"),
        },
        None => {
            let written = quote(text.lines().nth(line - 1).unwrap_or_default());
            format!("line {line}, {written:?}: {what}")
        }
    }
}

/// The position of a mistake in a file.
struct Place<'a> {
    /// Counted from 1.
    line: usize,
    /// The table of the line; empty before the first table.
    table: String,
    /// The key with its tables.
    key: Option<String>,
    /// The value of the key, if the value is the mistake.
    value: Option<&'a str>,
}

impl<'a> Place<'a> {
    fn find(text: &'a str, span: Range<usize>) -> Self {
        let before = text.get(..span.start).unwrap_or_default();
        let rest = text.get(span.start..).unwrap_or_default();
        let end = before.len() + rest.find('\n').unwrap_or(rest.len());
        // Up to the end of the line with the mistake.
        let seen = text.get(..end).unwrap_or(text);
        let mut table = String::new();
        let mut entry = None;
        for line in seen.lines() {
            if let Some(header) = header(line) {
                header.clone_into(&mut table);
                entry = None;
            } else if let Some((key, value)) = entry_of(line) {
                entry = Some((key, value));
            }
        }
        let marked = text.get(span).unwrap_or_default().trim();
        let is_header = seen.lines().last().and_then(header).is_some();
        let (key, value) = match entry {
            // The mistake is the header: the parser marks its last part.
            _ if is_header => (table.clone(), None),
            // The parser marks a key, perhaps one within an inline table.
            Some(_) if is_key(marked) && rest_is_assignment(rest, marked) => {
                (join(&table, marked), None)
            }
            Some((key, value)) => (
                join(&table, key),
                Some(if marked.is_empty() { value } else { marked }),
            ),
            None => (marked.to_owned(), None),
        };
        Self {
            line: before.matches('\n').count() + 1,
            table,
            key: Some(key).filter(|key| !key.is_empty()),
            value,
        }
    }
}

/// Whether an equals sign follows the marked text.
fn rest_is_assignment(rest: &str, marked: &str) -> bool {
    rest.get(marked.len()..)
        .is_some_and(|rest| rest.trim_start().starts_with('='))
}

/// The table that a line opens.
fn header(line: &str) -> Option<&str> {
    let line = line.split('#').next().unwrap_or_default().trim();
    let name = line.strip_prefix('[')?.strip_suffix(']')?.trim();
    let name = name
        .strip_prefix('[')
        .and_then(|name| name.strip_suffix(']'))
        .unwrap_or(name);
    // The last line of a list of numbers looks similar.
    (is_key(name) && name.starts_with(|c: char| c.is_ascii_alphabetic())).then_some(name)
}

/// Key and value of a line that has them.
fn entry_of(line: &str) -> Option<(&str, &str)> {
    let (key, value) = line.split_once('=')?;
    let key = key.trim();
    is_key(key).then(|| (key, value.split('#').next().unwrap_or_default().trim()))
}

fn is_key(text: &str) -> bool {
    !text.is_empty()
        && text
            .chars()
            .all(|c| c.is_ascii_alphanumeric() || matches!(c, '_' | '-' | '.'))
}

fn join(table: &str, key: &str) -> String {
    if table.is_empty() {
        key.to_owned()
    } else {
        format!("{table}.{key}")
    }
}

/// What to write instead.
fn fix(message: &str, place: &Place<'_>) -> Option<String> {
    if let Some(unknown) = quoted_after(message, "unknown field ") {
        return Some(match alike(unknown, expected(message)) {
            Some(known) => format!("did you mean {known}?"),
            None => "remove it".to_owned(),
        });
    }
    if let Some(unknown) = quoted_after(message, "unknown variant ") {
        let known = alike(unknown, expected(message))?;
        return Some(format!("did you mean \"{known}\"?"));
    }
    if message == "duplicate key" {
        return Some("keep one of the two".to_owned());
    }
    let expected = message.rsplit_once("expected ")?.1;
    let value = match expected {
        "u8" => "a whole number from 0 to 255",
        "u16" => "a whole number from 0 to 65535",
        "u32" | "u64" | "usize" => "a whole number, not negative",
        "i16" => "a whole number from -32768 to 32767",
        "i8" | "i32" | "i64" => "a whole number",
        "f32" | "f64" => "a number",
        "a boolean" => "true or false",
        "a string" | "path string" | "string or map" | "IPv4 address" => {
            "a text in quotation marks"
        }
        "literal string" => "the value like this one in the example, texts in quotation marks",
        "`=`" => "key = value",
        _ if expected.starts_with("struct ") => {
            let key = place.key.as_deref().unwrap_or_default();
            return Some(format!("write [{key}], and its keys below"));
        }
        _ if expected.starts_with("an array of length 2") => "two numbers, as [0.0, 1.0]",
        _ => return None,
    };
    Some(format!("write {value}"))
}

/// The word in backquotes that follows.
fn quoted_after<'a>(message: &'a str, words: &str) -> Option<&'a str> {
    let rest = message.strip_prefix(words)?.strip_prefix('`')?;
    Some(rest.split_once('`')?.0)
}

/// The words in backquotes that a message expects.
fn expected(message: &str) -> impl Iterator<Item = &str> {
    let list = message
        .split_once("expected ")
        .map_or("", |(_, expected)| expected);
    list.split('`').skip(1).step_by(2)
}

/// The known word most similar to the unknown one.
fn alike<'a>(unknown: &str, known: impl Iterator<Item = &'a str>) -> Option<&'a str> {
    known
        .map(|word| (strsim::jaro_winkler(unknown, word), word))
        .filter(|(likeness, _)| *likeness >= ALIKE)
        .max_by(|(a, _), (b, _)| a.total_cmp(b))
        .map(|(_, word)| word)
}

/// A value as a message shows it: on one line, and not too long.
fn quote(value: &str) -> String {
    let line = value.split_whitespace().collect::<Vec<_>>().join(" ");
    match line.char_indices().nth(LONGEST_QUOTE) {
        Some((end, _)) => format!("{}...", line.get(..end).unwrap_or_default()),
        None => line,
    }
}

#[cfg(test)]
mod tests {
    use serde::Deserialize;

    #[derive(Debug, Deserialize)]
    #[serde(deny_unknown_fields)]
    struct Car {
        #[expect(dead_code, reason = "only read")]
        wheel: Wheel,
    }

    #[derive(Debug, Deserialize)]
    #[serde(deny_unknown_fields)]
    #[expect(dead_code, reason = "only read")]
    struct Wheel {
        radius_m: f64,
        hold_ms: u32,
        sides: [f64; 2],
        kind: Option<Kind>,
    }

    #[derive(Debug, Deserialize)]
    #[serde(rename_all = "kebab-case")]
    enum Kind {
        Driven,
        Free,
    }

    fn explain(text: &str) -> String {
        super::explain(text, &toml::from_str::<Car>(text).unwrap_err())
    }

    #[test]
    fn an_error_names_line_key_value_and_fix() {
        let good = "radius_m = 1.0\nhold_ms = 2\nsides = [1.0, 2.0]\n";
        for (text, message) in [
            (
                "",
                "line 1: wheel is missing; add it, as in singletrackd.example.toml",
            ),
            (
                "# x\n[wheel]\nradius_m = 1.0\n",
                "line 2: wheel.hold_ms is missing; add it, as in singletrackd.example.toml",
            ),
            (
                &format!("[wheel]\n{good}hold_s = 2\n"),
                "line 5: wheel.hold_s: unknown field `hold_s`, expected one of `radius_m`, `hold_ms`, \
                 `sides`, `kind`; did you mean hold_ms?",
            ),
            (
                &format!("[wheel]\n{good}colour = 2\n"),
                "line 5: wheel.colour: unknown field `colour`, expected one of `radius_m`, `hold_ms`, \
                 `sides`, `kind`; remove it",
            ),
            (
                &format!("[wheels]\n{good}"),
                "line 1: wheels: unknown field `wheels`, expected `wheel`; did you mean wheel?",
            ),
            (
                &format!("[wheel]\n{good}kind = \"drived\"\n"),
                "line 5: wheel.kind = \"drived\": unknown variant `drived`, expected `driven` or `free`; \
                 did you mean \"driven\"?",
            ),
            (
                "[wheel]\nradius_m = \"wide\" # x\n",
                "line 2: wheel.radius_m = \"wide\": invalid type: string \"wide\", expected f64; write a number",
            ),
            (
                "wheel.radius_m = true\n",
                "line 1: wheel.radius_m = true: invalid type: boolean `true`, expected f64; write a number",
            ),
            (
                "[wheel]\nradius_m = 1.0\nhold_ms = -2\n",
                "line 3: wheel.hold_ms = -2: invalid value: integer `-2`, expected u32; write a whole \
                 number, not negative",
            ),
            (
                "[wheel]\nsides = [\n  1.0,\n  \"x\",\n]\n",
                "line 4: wheel.sides = \"x\": invalid type: string \"x\", expected f64; write a number",
            ),
            (
                "[wheel]\nhold_ms = 5 ms\n",
                "line 2: wheel.hold_ms = 5 ms: string values must be quoted, expected literal string; write \
                 the value like this one in the example, texts in quotation marks",
            ),
            (
                &format!("[wheel]\n{good}hold_ms = 3\n"),
                "line 5: wheel.hold_ms: duplicate key; keep one of the two",
            ),
            (
                "wheel = 3\n",
                "line 1: wheel = 3: invalid type: integer `3`, expected struct Wheel; write [wheel], and \
                 its keys below",
            ),
        ] {
            assert_eq!(explain(text), message, "{text}");
        }
    }

    #[test]
    fn any_text_is_explained() {
        for text in [
            "\u{0}",
            "[wheel",
            "=",
            "[[]]",
            "a.b = [\n\n",
            "\u{e4} = 1",
            "[wheel]\n\u{e4}",
        ] {
            assert!(explain(text).starts_with("line "), "{text}");
        }
    }
}
