//! What pages say that a command prints: the texts and the numbers.
//!
//! A block whose fence is ```` ```text printed COMMAND ```` holds a part of what the command prints; a
//! line of dots stands for what is left out. In ```` ```text like COMMAND ```` the numbers are an
//! example. A comment `<!-- numbers of COMMAND -->` says that the
//! numbers of the paragraph, list or table below it are in what the command prints, in the same unit or
//! in one a thousand times as small. The command `the commands above` is the nearest block of shell
//! commands.

use crate::blocks;

/// A part of a page that a command prints.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Printed {
    /// The number of its first line in the page, from 1.
    pub line: usize,
    /// The command.
    pub command: String,
    /// The text.
    pub text: String,
    /// What of it is compared.
    pub compared: Compared,
}

/// What of a part of a page is compared with what its command prints.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Compared {
    /// Words and numbers.
    All,
    /// Words only.
    Words,
    /// Numbers only.
    Numbers,
}

/// How a part begins.
const OPENINGS: [(&str, Compared); 3] = [
    ("```text printed ", Compared::All),
    ("```text like ", Compared::Words),
    ("<!-- numbers of ", Compared::Numbers),
];
const ABOVE: &str = "the commands above";

/// What the commands of a page print, in the order of the page.
pub fn printed(page: &str) -> Vec<Printed> {
    let blocks = blocks(page).unwrap_or_default();
    let mut found = Vec::new();
    let mut lines = page.lines().enumerate();
    while let Some((index, opening)) = lines.next() {
        let begun = OPENINGS
            .iter()
            .find_map(|(sign, compared)| Some((opening.strip_prefix(sign)?, *compared)));
        let Some((command, compared)) = begun else {
            continue;
        };
        let command = command.trim_end_matches("-->").trim();
        let numbers = compared == Compared::Numbers;
        let mut before = blocks.iter().rev().filter(|block| block.line <= index);
        let command = match before.next() {
            Some(block) if command == ABOVE => &*block.text,
            _ => command,
        };
        let is_end = |line: &str| {
            if numbers {
                line.is_empty()
            } else {
                line.starts_with("```")
            }
        };
        // A comment may stand in a line of its own above its paragraph.
        let below = lines.by_ref().map(|(_, line)| line);
        let mut below = below.skip_while(|line| numbers && line.is_empty());
        let text: Vec<_> = below.by_ref().take_while(|line| !is_end(line)).collect();
        found.push(Printed {
            line: index + 1,
            command: command.to_owned(),
            text: text.join("\n"),
            compared,
        });
    }
    found
}

impl Printed {
    /// Compares it with what the command has printed.
    ///
    /// # Errors
    ///
    /// What the command does not print.
    pub fn compare(&self, output: &str) -> Result<(), String> {
        let missing = match self.compared {
            Compared::All => missing_text(&self.text, output),
            Compared::Words => missing_text(&without_numbers(&self.text), &without_numbers(output)),
            Compared::Numbers => missing_number(&self.text, output),
        };
        let Some(missing) = missing else {
            return Ok(());
        };
        Err(format!(
            "line {}: `{}` does not print {missing:?}; it prints:\n{output}",
            self.line,
            self.command.trim_end()
        ))
    }
}

/// The first part of a text that the output lacks, whatever the ends of lines.
fn missing_text(text: &str, output: &str) -> Option<String> {
    let words = |text: &str| text.split_whitespace().collect::<Vec<_>>().join(" ");
    let (text, output) = (words(text), words(output));
    let mut rest = &*output;
    for part in text.split("...").map(str::trim) {
        match rest.split_once(part) {
            Some((_, after)) => rest = after,
            None => return Some(part.to_owned()),
        }
    }
    None
}

/// A text with `#` for each number.
fn without_numbers(text: &str) -> String {
    let mut without = String::new();
    let mut rest = text;
    while let Some(start) = rest.find(|letter: char| letter.is_ascii_digit()) {
        without += rest[..start].trim_end_matches(['+', '-', '.']);
        without.push('#');
        rest = rest[start..]
            .trim_start_matches(|letter: char| letter.is_ascii_digit() || letter == '.');
    }
    without + rest
}

/// The first number of a text that the output lacks. Whole numbers of one or two digits are left out:
/// they count, or name.
fn missing_number(text: &str, output: &str) -> Option<String> {
    let known: Vec<f64> = numbers(output).map(|(value, _)| value).collect();
    let is_known = |value: f64, decimals: usize| {
        let close = 0.501 * 10_f64.powi(-(decimals as i32));
        let near = |known: f64| (known - value).abs() <= close;
        known.iter().any(|known| near(*known) || near(1e3 * known))
    };
    let shown = numbers(text).filter(|(value, decimals)| *decimals > 0 || value.abs() >= 100.0);
    let mut missing = shown.filter(|(value, decimals)| !is_known(*value, *decimals));
    let (value, decimals) = missing.next()?;
    Some(format!("{value:.decimals$}"))
}

/// The numbers of a text, each with its decimals.
fn numbers(text: &str) -> impl Iterator<Item = (f64, usize)> {
    let is_part = |letter: char| letter.is_ascii_alphanumeric() || ".+-_".contains(letter);
    let text = text.replace('\u{2212}', "-");
    let words: Vec<String> = text
        .split(|letter| !is_part(letter))
        .map(str::to_owned)
        .collect();
    words.into_iter().filter_map(|word| {
        let word = word.trim_end_matches('.');
        let value = word.parse().ok().filter(|value: &f64| value.is_finite())?;
        let decimals = word
            .split_once('.')
            .map_or(0, |(_, decimals)| decimals.len());
        Some((value, decimals))
    })
}

/// The messages that a line of prose quotes: code spans of three words and more that are neither settings
/// nor command lines. Each in the parts between what differs: dots, and words in capitals.
pub fn quoted(prose: &str) -> Vec<String> {
    const COMMANDS: [&str; 4] = ["singletrack", "cargo", "sudo", "ulimit"];
    let spans = prose.split('`').skip(1).step_by(2);
    let is_message = |span: &&str| {
        let is_command = COMMANDS.iter().any(|command| span.starts_with(command));
        span.split(' ').count() > 2 && !span.contains(" = ") && !is_command
    };
    let mut parts = vec![String::new()];
    for word in spans
        .filter(is_message)
        .flat_map(|span| span.split(' ').chain(["..."]))
    {
        let is_placeholder = word == "..." || !word.contains(|letter: char| letter.is_lowercase());
        match (is_placeholder, parts.last_mut()) {
            (false, Some(part)) => *part = format!("{part} {word}").trim().to_owned(),
            _ => parts.push(String::new()),
        }
    }
    parts.retain(|part| part.contains(' '));
    parts
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test may fail")]
mod tests {
    use super::*;

    const PAGE: &str = "a\n```text printed drive --fast\nlag 0.462 rad\n...\nerror 447\nmm\n```\n\
                        <!-- numbers of stability -->\n| 1 | 183 ms | \u{2212}0.14 |\n| 2 | 0.3414 |\n\nb 99.9\n";
    const DRIVEN: &str = "drove\nlag 0.462 rad\nspeed 1 m/s\nerror 447 mm\n";
    const STABLE: &str = "margin 0.183 s at dl = -0.142728 m\np above 0.3414 m";

    fn found() -> [Printed; 2] {
        printed(PAGE).try_into().unwrap()
    }

    #[test]
    fn blocks_and_numbers_are_found_with_their_commands() {
        let [block, numbers] = found();
        assert_eq!((block.line, &*block.command), (2, "drive --fast"));
        assert_eq!((numbers.line, &*numbers.command), (8, "stability"));
        assert_eq!(numbers.text.lines().count(), 2);
        assert_eq!(block.compare(DRIVEN), Ok(()));
        assert_eq!(numbers.compare(STABLE), Ok(()));
    }

    #[test]
    fn messages_are_code_spans_of_three_words_without_what_differs() {
        let prose = "If `singletrack arm --for 20s` says `can't arm: mode MODE: MEANING (REASON). To do: ...`, or \
                     `is nearly full now`, set `a.b = true`, not `link down`";
        let parts = ["can't arm: mode", "To do:", "is nearly full now"];
        assert_eq!(quoted(prose), parts);
    }

    #[test]
    fn the_commands_above_are_those_of_the_nearest_block() {
        let page = "```sh\na\n```\n```sh\nb\nc\n```\n<!-- numbers of the commands above -->\n1.5\n\n```sh\nd\n```\n";
        assert_eq!(printed(page)[0].command, "b\nc\n");
    }

    #[test]
    fn the_numbers_of_an_example_are_not_compared_and_its_words_are() {
        let page = "```text like drive\nlag 1.5 rad, x -3 m...\n```\n";
        let [part] = printed(page).try_into().unwrap();
        assert_eq!(part.compare("a\nlag -0.462 rad, x 3.25 m. b"), Ok(()));
        let why = part.compare("lag 0.462 m, x 3.25 m").unwrap_err();
        assert!(why.contains("lag # rad, x # m"), "{why}");
    }

    #[test]
    fn a_wrong_number_or_word_of_each_kind_is_found() {
        let [block, numbers] = found();
        let said = |part: &Printed, from: &str, to: &str, output: &str| {
            let text = part.text.replace(from, to);
            assert_ne!(text, part.text);
            let planted = Printed {
                text,
                ..part.clone()
            };
            planted.compare(output).unwrap_err()
        };
        // A number in a block, a word of a message, a number of a table with another unit, and one in
        // the digits that are shown.
        assert!(said(&block, "0.462", "0.463", DRIVEN).contains("0.463"));
        assert!(said(&block, "error", "mistake", DRIVEN).contains("mistake 447 mm"));
        assert!(said(&numbers, "183", "184", STABLE).contains("\"184\""));
        assert!(said(&numbers, "0.3414", "0.3415", STABLE).contains("0.3415"));
        assert!(said(&numbers, "0.14 ", "0.15 ", STABLE).contains("-0.15"));
    }
}
