//! Text for a terminal: the list of the commands, wrapped lines, and no control characters.

use std::{borrow::Cow, fmt::Write as _};

use clap::Command;

/// Breaks a text between its words.
pub(crate) fn wrap(text: &str, columns: usize) -> impl Iterator<Item = String> {
    let mut lines = vec![String::new()];
    for word in text.split_whitespace() {
        match lines.last_mut() {
            Some(line) if line.is_empty() => line.push_str(word),
            Some(line) if line.chars().count() + 1 + word.chars().count() <= columns => {
                line.push(' ');
                line.push_str(word);
            }
            _ => lines.push(word.to_owned()),
        }
    }
    lines.into_iter()
}

/// The text with its control characters, but for ends of lines and tabulators, as `\u001b`: what a
/// record or a program sent must not command the terminal. JSON stays JSON.
pub fn printable(text: &str) -> Cow<'_, str> {
    let commands = |letter: char| letter.is_control() && !matches!(letter, '\n' | '\t');
    if !text.contains(commands) {
        return Cow::Borrowed(text);
    }
    let shown = |letter: char| match commands(letter) {
        true => format!("\\u{:04x}", u32::from(letter)),
        false => letter.to_string(),
    };
    Cow::Owned(text.chars().map(shown).collect())
}

/// What the commands are for, and their names.
pub const GROUPS: [(&str, &str); 4] = [
    (
        "Drive",
        "arm disarm stop fleet drive tune setpoint set-reference",
    ),
    (
        "Set up a car",
        "cameras doctor bring-up calibrate accept jog",
    ),
    ("Look", "status page live dump plot"),
    (
        "Simulate and analyse",
        "demo simulate compare reproduce stability certify identify benchmark merge import judge recover replay completions",
    ),
];

/// Columns of a line.
const COLUMNS: usize = 100;
/// Columns of the names.
const NAMES: usize = 15;

/// Lists the subcommands of `command` by [`GROUPS`] in its help.
pub fn grouped(command: Command) -> Command {
    let header = *command.get_styles().get_header();
    let literal = *command.get_styles().get_literal();
    let mut template = "{about-with-newline}\n{usage-heading} {usage}\n".to_owned();
    for (group, names) in GROUPS {
        let mut lines = String::new();
        let commands = names.split(' ');
        for one in commands.filter_map(|name| command.find_subcommand(name)) {
            let about = one.get_about().map(ToString::to_string).unwrap_or_default();
            let mut name = one.get_name();
            for line in wrap(&about, COLUMNS - NAMES - 2) {
                let _ = writeln!(lines, "  {literal}{name:<NAMES$}{literal:#}{line}");
                name = "";
            }
        }
        if !lines.is_empty() {
            let _ = write!(template, "\n{header}{group}:{header:#}\n{lines}");
        }
    }
    template += &format!("\n{header}Options:{header:#}\n{{options}}{{after-help}}");
    command.help_template(template)
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
