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
pub fn explain(text: &str, error: &toml::de::Error) -> String {
    let message = error.message().trim();
    let place = Place::find(text, error.span().unwrap_or_default());
    let line = place.line;
    let what = in_plain_words(message, &place).unwrap_or_else(|| message.to_owned());
    if let Some(field) = quoted_after(message, "missing field ") {
        let key = join(&place.table, field);
        return format!("line {line}: {key} is missing; add it, as in the example file");
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

/// Explains why a table can't be read whose text is not at hand: key and fix.
pub fn explain_table(error: &toml::de::Error) -> String {
    let (message, text) = (error.message().trim(), error.to_string());
    let what = in_plain_words(message, &Place::default()).unwrap_or_else(|| message.to_owned());
    if let Some(field) = quoted_after(message, "missing field ") {
        return format!("{field} is missing; add it");
    }
    let unknown = quoted_after(message, "unknown field ");
    let written = text.rsplit_once("\nin `").map(|(_, key)| key);
    match unknown.or(written.map(|key| key.trim_end().trim_end_matches('`'))) {
        Some(key) => format!("{key}: {what}"),
        None => what,
    }
}

/// The position of a mistake in a file.
#[derive(Default)]
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
fn header<'a>(line: &'a str) -> Option<&'a str> {
    let line = line.split('#').next().unwrap_or_default().trim();
    let name = line.strip_prefix('[')?.strip_suffix(']')?.trim();
    let of_list = |name: &'a str| name.strip_prefix('[')?.strip_suffix(']');
    let name = of_list(name).unwrap_or(name);
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

/// What is wrong and what to write instead, without the words of the parser; `None` for a message
/// of ours.
fn in_plain_words(message: &str, place: &Place<'_>) -> Option<String> {
    if let Some(unknown) = quoted_after(message, "unknown field ") {
        return Some(match alike(unknown, expected(message)) {
            Some(known) => format!("unknown key; did you mean {known}?"),
            None => format!(
                "unknown key; remove it, or use {}",
                list(expected(message), "")
            ),
        });
    }
    if let Some(unknown) = quoted_after(message, "unknown variant ") {
        let known = match alike(unknown, expected(message)) {
            Some(known) => format!("; did you mean \"{known}\"?"),
            None => String::new(),
        };
        let words = list(expected(message), "\"");
        return Some(format!("it must be {words}{known}"));
    }
    let value = place.value.unwrap_or_default();
    let value = match message
        .rsplit_once("expected ")
        .map_or(message, |(_, it)| it)
    {
        "duplicate key" => return Some("it is a duplicate; keep one of the two".to_owned()),
        "invalid IPv4 address syntax" | "IPv4 address" => {
            "an IPv4 address in quotation marks, such as \"192.168.1.10\", not a name"
        }
        "newline, `#`" if is_with_comma(value) => {
            return Some(format!(
                "write a number with a point: {}",
                value.replacen(',', ".", 1)
            ));
        }
        "newline, `#`" => return Some("write one key = value on a line".to_owned()),
        "literal string" => {
            return Some(
                "write the value like this one in the example, texts in quotation marks".to_owned(),
            );
        }
        "nothing" => {
            return Some("write one number, or a text in quotation marks".to_owned());
        }
        "`=`" => return Some("write key = value".to_owned()),
        other if other.starts_with("struct ") => {
            let key = place.key.as_deref().unwrap_or_default();
            return Some(format!("write [{key}], and its keys below"));
        }
        other if other.starts_with("an array of length 2") => "two numbers, as [0.0, 1.0]",
        "a sequence" => "a list, as [0.0, 1.0]",
        // No key takes the largest.
        "u32" => "a whole number, not negative",
        other => kind(other)?,
    };
    Some(format!("it must be {value}"))
}

/// Whether it is a number that is written with a comma.
fn is_with_comma(value: &str) -> bool {
    value.split_once(',').is_some_and(|(whole, part)| {
        [whole, part]
            .iter()
            .all(|it| it.trim().parse::<f64>().is_ok())
    })
}

/// What serde expects, in the words of an author of a file or a line; `None` for what is no type of
/// serde's.
pub fn kind(expected: &str) -> Option<&'static str> {
    Some(match expected {
        "u8" => "a whole number from 0 to 255",
        "u16" => "a whole number from 0 to 65535",
        "u32" => "a whole number from 0 to 4294967295",
        "u64" | "usize" => "a whole number, not negative",
        "i16" => "a whole number from -32768 to 32767",
        "i8" | "i32" | "i64" => "a whole number",
        "f32" | "f64" => "a number",
        "a boolean" => "true or false",
        "a string" | "path string" | "string or map" | "wanted string or table" => {
            "a text in quotation marks"
        }
        _ => return None,
    })
}

/// Words as a list, each between two of `quote`.
pub fn list<'a>(words: impl Iterator<Item = &'a str>, quote: &str) -> String {
    let words: Vec<_> = words.map(|word| format!("{quote}{word}{quote}")).collect();
    match words.as_slice() {
        [before @ .., last] if !before.is_empty() => format!("{} or {last}", before.join(", ")),
        words => words.concat(),
    }
}

/// The word in backquotes that follows these words at the start of serde's message.
pub fn quoted_after<'a>(message: &'a str, words: &str) -> Option<&'a str> {
    let rest = message.strip_prefix(words)?.strip_prefix('`')?;
    Some(rest.split_once('`')?.0)
}

/// The words in backquotes that serde's message expects.
pub fn expected(message: &str) -> impl Iterator<Item = &str> {
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
    shortened(&line)
}

/// A text of at most 60 characters.
pub fn shortened(text: &str) -> String {
    match text.char_indices().nth(LONGEST_QUOTE) {
        Some((end, _)) => format!("{}...", text.get(..end).unwrap_or_default()),
        None => text.to_owned(),
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
        hub: Option<core::net::Ipv4Addr>,
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
                "line 1: wheel is missing; add it, as in the example file",
            ),
            (
                "# x\n[wheel]\nradius_m = 1.0\n",
                "line 2: wheel.hold_ms is missing; add it, as in the example file",
            ),
            (
                &format!("[wheel]\n{good}hold_s = 2\n"),
                "line 5: wheel.hold_s: unknown key; did you mean hold_ms?",
            ),
            (
                &format!("[wheel]\n{good}colour = 2\n"),
                "line 5: wheel.colour: unknown key; remove it, or use radius_m, hold_ms, sides, \
                 kind or hub",
            ),
            (
                &format!("[wheels]\n{good}"),
                "line 1: wheels: unknown key; did you mean wheel?",
            ),
            (
                &format!("[wheel]\n{good}kind = \"drived\"\n"),
                "line 5: wheel.kind = \"drived\": it must be \"driven\" or \"free\"; did you mean \
                 \"driven\"?",
            ),
            (
                "[wheel]\nradius_m = \"wide\" # x\n",
                "line 2: wheel.radius_m = \"wide\": it must be a number",
            ),
            (
                "wheel.radius_m = true\n",
                "line 1: wheel.radius_m = true: it must be a number",
            ),
            (
                "[wheel]\nradius_m = 1.0\nhold_ms = -2\n",
                "line 3: wheel.hold_ms = -2: it must be a whole number, not negative",
            ),
            (
                "[wheel]\nsides = [\n  1.0,\n  \"x\",\n]\n",
                "line 4: wheel.sides = \"x\": it must be a number",
            ),
            (
                "[wheel]\nhold_ms = 5 ms\n",
                "line 2: wheel.hold_ms = 5 ms: write the value like this one in the example, texts in quotation marks",
            ),
            (
                &format!("[wheel]\n{good}hold_ms = 3\n"),
                "line 5: wheel.hold_ms: it is a duplicate; keep one of the two",
            ),
            (
                "[wheel]\nradius_m = 0,85\n",
                "line 2: wheel.radius_m = 0,85: write a number with a point: 0.85",
            ),
            (
                "[wheel]\nradius_m = 0.85 m, 3\n",
                "line 2: wheel.radius_m = 0.85 m, 3: write one key = value on a line",
            ),
            (
                &format!("[wheel]\n{good}hub = \"localhost\"\n"),
                "line 5: wheel.hub = \"localhost\": it must be an IPv4 address in \
                 quotation marks, such as \"192.168.1.10\", not a name",
            ),
            (
                &format!("[wheel]\n{good}kind = 3\n"),
                "line 5: wheel.kind = 3: it must be a text in quotation marks",
            ),
            (
                "wheel = 3\n",
                "line 1: wheel = 3: write [wheel], and its keys below",
            ),
        ] {
            assert_eq!(explain(text), message, "{text}");
        }
    }

    #[test]
    fn a_table_without_a_text_is_explained_by_its_key() {
        let explain = |text: &str| {
            let table: toml::Table = toml::from_str(text).unwrap();
            super::explain_table(&table.try_into::<Wheel>().unwrap_err())
        };
        assert_eq!(explain("radius_m = \"x\""), "radius_m: it must be a number");
        assert_eq!(
            explain("radius = 1.0"),
            "radius: unknown key; did you mean radius_m?"
        );
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
