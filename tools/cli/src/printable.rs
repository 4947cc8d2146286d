//! Text from files and from other computers, for a terminal.

use std::{borrow::Cow, fmt::Write as _};

/// The text with its control characters, but for ends of lines and tabulators, as `\u001b`: what a
/// record or a program sent must not command the terminal. JSON stays JSON.
#[must_use]
pub fn printable(text: &str) -> Cow<'_, str> {
    let commands = |letter: char| letter.is_control() && !matches!(letter, '\n' | '\t');
    if !text.contains(commands) {
        return Cow::Borrowed(text);
    }
    let mut printable = String::with_capacity(text.len());
    for letter in text.chars() {
        if commands(letter) {
            // Writing to a string does not fail.
            let _ = write!(printable, "\\u{:04x}", u32::from(letter));
        } else {
            printable.push(letter);
        }
    }
    Cow::Owned(printable)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_control_character_reaches_the_terminal_and_ends_of_lines_do() {
        assert_eq!(printable("a\tb\n"), "a\tb\n");
        assert_eq!(
            printable("\u{1b}]0;title\u{7}\u{9b}2J\r\u{7f}"),
            "\\u001b]0;title\\u0007\\u009b2J\\u000d\\u007f"
        );
    }
}
