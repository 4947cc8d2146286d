//! The blocks of shell commands of a page.

use std::collections::BTreeSet;

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
    #[must_use]
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
    #[must_use]
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
    #[must_use]
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
}
