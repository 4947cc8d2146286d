//! The table of reasons in `docs/reasons.md`, for programs that show them in words.

const TABLE: &str = include_str!("../../../docs/reasons.md");

/// A row of the table. The texts are Markdown.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Explanation {
    /// Who decides: `host`, `board stop`, `board refusal` or `cameras`.
    pub who: &'static str,
    /// The word in status, log and record.
    pub word: &'static str,
    /// What it means.
    pub meaning: &'static str,
    /// What the car does, and within which time.
    pub effect: &'static str,
    /// What to do about it.
    pub remedy: &'static str,
}

/// The rows of the table, in order. A row that has not five columns is left out.
pub fn explanations() -> impl Iterator<Item = Explanation> {
    TABLE.lines().filter_map(row)
}

fn row(line: &'static str) -> Option<Explanation> {
    let mut fields = line.strip_prefix("| ")?.strip_suffix(" |")?.split(" | ");
    let mut next = || fields.next();
    let (who, word) = (next()?, next()?);
    let (meaning, effect, remedy) = (next()?, next()?, next()?);
    // The head of the table has no word in code.
    let word = word.strip_prefix('`')?.strip_suffix('`')?;
    next().is_none().then_some(Explanation {
        who,
        word,
        meaning,
        effect,
        remedy,
    })
}
