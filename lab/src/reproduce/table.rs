//! The table of claims on standard output.

use std::{
    io::{self, Write},
    path::Path,
};

use super::{
    claims::{Claim, Quantity, Verdict, surprises},
    section::Reproduction,
    text::with_digits,
};

/// Columns with their widths, in characters.
const COLUMNS: [(&str, usize); 5] = [
    ("verdict", 9),
    ("claim", 27),
    ("the paper", 30),
    ("measured", 20),
    ("why", 34),
];

/// Prints the table and the path of the report. A closed pipe is not an error.
pub(super) fn print(reproduction: &Reproduction, report: &Path) {
    let mut out = io::stdout().lock();
    let _ = write(&mut out, reproduction, report);
}

fn write(out: &mut impl Write, reproduction: &Reproduction, report: &Path) -> io::Result<()> {
    let heads = COLUMNS.map(|(name, _)| name.to_owned());
    row(out, &heads)?;
    rule(out)?;
    for claim in &reproduction.claims {
        row(out, &cells(claim))?;
        rule(out)?;
    }
    for section in &reproduction.sections {
        for note in &section.notes {
            writeln!(out, "note on section {}: {note}", section.number)?;
        }
    }
    writeln!(out, "{}", counts(&reproduction.claims))?;
    writeln!(out, "{}", report.display())
}

/// The number of claims by verdict, in a sentence.
pub(super) fn counts(claims: &[Claim]) -> String {
    let count = |verdict| claims.iter().filter(|one| one.verdict == verdict).count();
    let mut text = format!(
        "{} claims: {} agree, {} differ",
        claims.len(),
        count(Verdict::Agrees),
        count(Verdict::Differs)
    );
    for (verdict, name) in [
        (Verdict::NotComparable, "can't be compared"),
        (Verdict::NotMeasured, "were not measured"),
    ] {
        if count(verdict) > 0 {
            text += &format!(", {} {name}", count(verdict));
        }
    }
    text + &match surprises(claims) {
        0 => "; all as expected.".to_owned(),
        count => format!("; {count} of them otherwise than expected."),
    }
}

/// Each number with its label.
pub(super) fn measured(claim: &Claim) -> Vec<String> {
    let quantities = claim.quantities.iter();
    quantities
        .map(|Quantity { label, value, .. }| match value {
            None => format!("{label}: none"),
            // No line break between number and unit.
            Some(value) => format!("{label}: {}\u{a0}{}", with_digits(*value, 4), claim.unit)
                .trim_end()
                .to_owned(),
        })
        .collect()
}

fn cells(claim: &Claim) -> [String; 5] {
    let mark = if claim.surprise.is_some() { "! " } else { "" };
    let why = match &claim.surprise {
        Some(surprise) => format!("UNEXPECTED: {surprise}. {}", claim.why),
        None => claim.why.clone(),
    };
    [
        format!("{mark}{}", claim.verdict.name()),
        format!("{}. {}", claim.section, claim.claim),
        claim.paper.clone(),
        measured(claim).join("; "),
        why,
    ]
}

/// The table in Markdown.
pub(super) fn markdown(claims: &[Claim]) -> String {
    let mut table =
        "| § | claim | the paper | measured | verdict | why |\n|---|---|---|---|---|---|\n"
            .to_owned();
    for claim in claims {
        let [verdict, _, paper, measured, why] = cells(claim);
        let cells = [
            claim.section.to_string(),
            claim.claim.clone(),
            paper,
            measured,
            verdict,
            why,
        ];
        table += &format!(
            "| {} |\n",
            cells.map(|cell| cell.replace('|', "\\|")).join(" | ")
        );
    }
    table
}

/// Writes cells side by side, each wrapped to its column.
fn row(out: &mut impl Write, cells: &[String; 5]) -> io::Result<()> {
    let wrapped: Vec<Vec<String>> = cells
        .iter()
        .zip(COLUMNS)
        .map(|(cell, (_, width))| wrap(cell, width))
        .collect();
    let lines = wrapped.iter().map(Vec::len).max().unwrap_or(0);
    for line in 0..lines {
        let mut text = String::new();
        for (column, (_, width)) in wrapped.iter().zip(COLUMNS) {
            let part = column.get(line).map_or("", String::as_str);
            let padding = width.saturating_sub(part.chars().count()) + 2;
            text.push_str(part);
            text.extend(std::iter::repeat_n(' ', padding));
        }
        writeln!(out, "{}", text.trim_end())?;
    }
    Ok(())
}

fn rule(out: &mut impl Write) -> io::Result<()> {
    let width: usize = COLUMNS.iter().map(|(_, width)| width + 2).sum();
    writeln!(out, "{}", "─".repeat(width - 2))
}

/// Breaks a text between words into lines no wider than `width`, a longer word apart.
fn wrap(text: &str, width: usize) -> Vec<String> {
    let mut lines = vec![String::new()];
    for word in text.split(' ') {
        let Some(line) = lines.last_mut() else { break };
        let length = line.chars().count();
        if length == 0 {
            line.push_str(word);
        } else if length + 1 + word.chars().count() <= width {
            line.push(' ');
            line.push_str(word);
        } else {
            lines.push(word.to_owned());
        }
    }
    lines
}

#[cfg(test)]
mod tests {
    use super::{
        super::claims::{Measurements, judge},
        Verdict, markdown, wrap,
    };

    #[test]
    fn a_bar_in_a_cell_is_no_border_in_markdown() {
        let claim = crate::reproduce::claims::Claim {
            id: "deviation".to_owned(),
            section: 2,
            scope: crate::reproduce::claims::Scope::AnyCar,
            claim: "2 |dl|".to_owned(),
            paper: "none".to_owned(),
            unit: "m".to_owned(),
            quantities: Vec::new(),
            verdict: Verdict::NotMeasured,
            why: "it is so".to_owned(),
            surprise: None,
        };
        let judged = judge(vec![claim], &Measurements::default(), true);
        let table = markdown(&judged);
        assert!(
            table.ends_with("| 2 | 2 \\|dl\\| | none |  | agrees | it is so |\n"),
            "{table}"
        );
    }

    #[test]
    fn lines_are_broken_between_words() {
        assert_eq!(wrap("one two three", 7), ["one two", "three"]);
        assert_eq!(
            wrap("incomprehensible is long", 6),
            ["incomprehensible", "is", "long"]
        );
        assert_eq!(wrap("", 6), [""]);
    }
}
