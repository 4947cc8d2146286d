//! The shell commands of the documentation.
//!
//! `cargo verify book` runs them: each page in a folder of its own, its blocks in order. The word
//! after `sh` at the beginning of a block says how it runs, or why it does not: see [`Kind`].
//! The command lines of all blocks are also given to their programs with `--help`, which refuses
//! unknown commands, options and values.

mod printed;

use std::collections::{BTreeMap, BTreeSet};

pub use printed::{Compared, Printed, printed, quoted};

/// How a block is run, or why it is not: the words after `sh`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Kind {
    /// Beside the page's simulated car, when it is ready to drive.
    Car,
    /// Each command is interrupted after two seconds, as with Ctrl-C, and must end with success or by the
    /// signal.
    Interrupted,
    /// Its one command runs until the end of the page.
    Background,
    /// Not run: compiles, or runs tests; the other steps of `cargo verify` do that.
    Build,
    /// Not run: takes more than some seconds.
    Long,
    /// Not run: changes the system.
    Install,
    /// Not run: needs a car, a board, or a person at the car.
    Hardware,
    /// Not run: another computer, or a program that does not belong to the project.
    Elsewhere,
}

impl Kind {
    /// All kinds.
    pub const ALL: [Self; 8] = [
        Self::Car,
        Self::Interrupted,
        Self::Background,
        Self::Build,
        Self::Long,
        Self::Install,
        Self::Hardware,
        Self::Elsewhere,
    ];

    /// The word after `sh`.
    pub const fn word(self) -> &'static str {
        match self {
            Self::Car => "car",
            Self::Interrupted => "interrupted",
            Self::Background => "background",
            Self::Build => "build",
            Self::Long => "long",
            Self::Install => "install",
            Self::Hardware => "hardware",
            Self::Elsewhere => "elsewhere",
        }
    }

    /// Whether blocks of this kind are run.
    pub const fn runs(self) -> bool {
        matches!(self, Self::Car | Self::Interrupted | Self::Background)
    }
}

/// A block of shell commands.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Block {
    /// The number of its first line in the page, from 1.
    pub line: usize,
    /// How it is run; empty for a block that simply runs.
    pub kinds: BTreeSet<Kind>,
    /// The commands, without the indentation of the block.
    pub text: String,
}

impl Block {
    /// Whether it is run.
    pub fn runs(&self) -> bool {
        self.kinds.iter().all(|kind| kind.runs())
    }
}

/// A block that can't be read.
#[derive(Debug, PartialEq, Eq, thiserror::Error)]
pub enum BlockError {
    /// The word after `sh` is not known.
    #[error("line {line}: {word:?} is no kind of block; the kinds are {}", known())]
    UnknownKind {
        /// The number of the line, from 1.
        line: usize,
        /// The word.
        word: String,
    },
    /// A block has no end.
    #[error("line {line}: this block has no end")]
    Unclosed {
        /// The number of the line, from 1.
        line: usize,
    },
}

fn known() -> String {
    Kind::ALL.map(Kind::word).join(", ")
}

/// The blocks of shell commands of a page (`sh`, `bash`, `console`).
///
/// # Errors
///
/// For a block of an unknown kind, and for one without an end.
pub fn blocks(page: &str) -> Result<Vec<Block>, BlockError> {
    let mut found = Vec::new();
    let mut lines = page.lines().enumerate();
    while let Some((index, opening)) = lines.next() {
        let Some(info) = opening.trim_start().strip_prefix("```") else {
            continue;
        };
        let indent = opening.len() - opening.trim_start().len();
        let line = index + 1;
        let mut text = String::new();
        loop {
            let Some((_, content)) = lines.next() else {
                return Err(BlockError::Unclosed { line });
            };
            if content.trim_start().starts_with("```") {
                break;
            }
            text.push_str(content.get(indent..).unwrap_or_default());
            text.push('\n');
        }
        let mut words = info.split_whitespace();
        if !matches!(words.next(), Some("sh" | "bash" | "console")) {
            continue;
        }
        let kinds = words
            .map(|word| {
                let kind = Kind::ALL.into_iter().find(|kind| kind.word() == word);
                let word = word.to_owned();
                kind.ok_or(BlockError::UnknownKind { line, word })
            })
            .collect::<Result<_, _>>()?;
        found.push(Block { line, kinds, text });
    }
    Ok(found)
}

/// A command line of one of the programs.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Line {
    /// The program, such as `singletrack`; `cargo` for its aliases.
    pub program: String,
    /// Its arguments.
    pub arguments: Vec<String>,
}

/// Programs whose lines are read.
const PROGRAMS: [&str; 10] = [
    "singletrack",
    "singletrackd",
    "singletrack-lab",
    "singletrack-sim",
    "singletrack-exploration",
    "singletrack-faults",
    "singletrack-onboard",
    "singletrack-ros",
    "singletrack-zenoh",
    "cargo",
];

/// The command lines of our programs in the text of a block.
///
/// A variable of a `for` has its first value, any other one is empty. Commands with the arguments
/// of a shell function are left out: they are read where the function runs.
pub fn lines(text: &str) -> Vec<Line> {
    let mut variables = BTreeMap::new();
    let mut found = Vec::new();
    for words in commands(&text.replace("\\\n", " ")) {
        if let [word, name, of, values @ ..] = words.as_slice()
            && word == "for"
            && of == "in"
        {
            let value = values.first().cloned().unwrap_or_default();
            variables.insert(name.clone(), value);
            continue;
        }
        let start = words.iter().position(|word| !is_prefix(word));
        let Some((program, arguments)) = start.and_then(|start| words[start..].split_first())
        else {
            continue;
        };
        if !PROGRAMS.contains(&program.as_str()) {
            continue;
        }
        let arguments: Vec<_> = arguments
            .iter()
            .map(|word| substitute(word, &variables))
            .filter(|word| !word.is_empty() && word != "}")
            .collect();
        if arguments
            .iter()
            .any(|word| word.contains("$1") || word.contains("$2"))
        {
            continue;
        }
        found.push(Line {
            program: program.clone(),
            arguments,
        });
    }
    found
}

/// The command lines of our programs in the code spans of a line of prose.
pub fn spans(prose: &str) -> Vec<Line> {
    let spans = prose.split('`').skip(1).step_by(2);
    spans
        .filter(|span| span.contains(' ') && !span.contains("..."))
        .flat_map(lines)
        .collect()
}

/// A word before the program: keywords, assignments, the name of a function, a batch file.
fn is_prefix(word: &str) -> bool {
    let is_assignment = word.split_once('=').is_some_and(|(name, _)| {
        !name.is_empty() && !name.starts_with('-') && name.chars().all(|c| c.is_ascii_uppercase())
    });
    is_assignment
        || ["do", "then", "{", "$", "sbatch"].contains(&word)
        || word.ends_with("()")
        || word.starts_with("--array=")
        || word.ends_with(".sbatch")
}

/// The word with its variables replaced.
fn substitute(word: &str, variables: &BTreeMap<String, String>) -> String {
    let mut text = word.to_owned();
    for (name, value) in variables {
        text = text.replace(&format!("${name}"), value);
    }
    match text.find("${") {
        Some(start) => {
            let end = text[start..]
                .find('}')
                .map_or(text.len(), |end| start + end + 1);
            format!("{}{}", &text[..start], &text[end..])
        }
        None => text,
    }
}

/// The words of the simple commands, without comments and redirections.
fn commands(text: &str) -> Vec<Vec<String>> {
    let mut commands = vec![Vec::new()];
    let mut word: Option<String> = None;
    let mut quote = None;
    let mut letters = text.chars().peekable();
    while let Some(letter) = letters.next() {
        match (quote, letter) {
            (Some(open), _) if letter == open => quote = None,
            (Some(_), _) => word.get_or_insert_default().push(letter),
            (None, '\'' | '"') => {
                quote = Some(letter);
                word.get_or_insert_default();
            }
            (None, '#') if word.is_none() => {
                while letters.next_if(|next| *next != '\n').is_some() {}
            }
            (None, '\n' | ';' | '|' | '&') => {
                push(&mut commands, word.take());
                commands.push(Vec::new());
            }
            (None, _) if letter.is_whitespace() => push(&mut commands, word.take()),
            (None, _) => word.get_or_insert_default().push(letter),
        }
    }
    push(&mut commands, word);
    for command in &mut commands {
        if let Some(at) = command.iter().position(|word| word.starts_with('>')) {
            command.truncate(at);
        }
    }
    commands.retain(|command| !command.is_empty());
    commands
}

fn push(commands: &mut [Vec<String>], word: Option<String>) {
    if let (Some(command), Some(word)) = (commands.last_mut(), word) {
        command.push(word);
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test may fail")]
mod tests {
    use super::*;

    #[test]
    fn blocks_have_their_kinds_and_their_text() {
        let page =
            "a\n```sh car interrupted\nx\n```\n   ```sh\n   y\n     z\n   ```\n```toml\nq\n```\n";
        let found = blocks(page).unwrap();
        assert_eq!(found.len(), 2);
        assert_eq!((found[0].line, found[0].text.as_str()), (2, "x\n"));
        assert_eq!(found[0].kinds, [Kind::Car, Kind::Interrupted].into());
        assert_eq!((found[1].line, found[1].text.as_str()), (5, "y\n  z\n"));
        assert!(found[1].runs());
    }

    #[test]
    fn an_unknown_kind_is_refused_with_the_known_ones() {
        let error = blocks("\n```sh lengthy\n```\n").unwrap_err().to_string();
        assert!(
            error.contains("line 2") && error.contains("\"lengthy\"") && error.contains("long")
        );
        assert_eq!(blocks("```sh\n"), Err(BlockError::Unclosed { line: 1 }));
    }

    fn read(text: &str) -> Vec<String> {
        let lines = lines(text).into_iter();
        lines
            .map(|line| format!("{} {}", line.program, line.arguments.join("|")))
            .collect()
    }

    #[test]
    fn commands_are_found_behind_pipes_keywords_and_comments() {
        let text = "# singletrack no\nA=b singletrack x 'y z' > out  # singletrack no\n\
                    mine | singletrack setpoint && singletrack \\\n  more &\nother singletrack\n";
        let wanted = [
            "singletrack x|y z",
            "singletrack setpoint",
            "singletrack more",
        ];
        assert_eq!(read(text), wanted);
    }

    #[test]
    fn variables_of_loops_have_their_first_value() {
        let text = "for law in a b; do\n singletrack s --law $law --out x/$law\ndone\n\
                    for p in \"\" --predict; do singletrack s $p --out y${p:+-z}; done\n\
                    f() { singletrack plot $1; }";
        assert_eq!(
            read(text),
            ["singletrack s|--law|a|--out|x/a", "singletrack s|--out|y"]
        );
    }

    #[test]
    fn code_spans_are_read_if_they_are_command_lines() {
        let prose = "`singletrack` and `singletrack arm --for 20s`, not `singletrack --x ...`";
        assert_eq!(spans(prose).len(), 1);
    }
}
