//! Unified diffs of short texts.

use std::fmt::Write as _;

/// Lines around a change.
const CONTEXT: usize = 3;

/// A line of both texts, of the old one or of the new one.
#[derive(Clone, Copy, PartialEq)]
enum Line<'a> {
    Both(&'a str),
    Old(&'a str),
    New(&'a str),
}

/// The differences between two texts, by lines; empty if there are none.
pub(crate) fn unified(name: &str, old: &str, new: &str) -> String {
    let lines = compare(
        &old.lines().collect::<Vec<_>>(),
        &new.lines().collect::<Vec<_>>(),
    );
    let changed: Vec<usize> = lines
        .iter()
        .enumerate()
        .filter(|(_, line)| !matches!(line, Line::Both(_)))
        .map(|(index, _)| index)
        .collect();
    let mut text = String::new();
    let mut rest = changed.as_slice();
    while let [first, ..] = rest {
        // Changes whose surroundings touch are one hunk.
        let apart = rest
            .windows(2)
            .position(|pair| pair[1] - pair[0] > 2 * CONTEXT + 1)
            .map_or(rest.len(), |index| index + 1);
        let (hunk, after) = rest.split_at(apart);
        let last = hunk.last().unwrap_or(first);
        let begin = first.saturating_sub(CONTEXT);
        let end = (last + CONTEXT + 1).min(lines.len());
        if text.is_empty() {
            let _ = writeln!(text, "--- {name} (old)\n+++ {name} (new)");
        }
        write_hunk(&mut text, &lines, begin, end);
        rest = after;
    }
    text
}

fn write_hunk(text: &mut String, lines: &[Line<'_>], begin: usize, end: usize) {
    let count = |part: &[Line<'_>], other: fn(&Line<'_>) -> bool| {
        part.iter().filter(|line| !other(line)).count()
    };
    let is_new: fn(&Line<'_>) -> bool = |line| matches!(line, Line::New(_));
    let is_old: fn(&Line<'_>) -> bool = |line| matches!(line, Line::Old(_));
    let (before, hunk) = (&lines[..begin], &lines[begin..end]);
    let _ = writeln!(
        text,
        "@@ -{},{} +{},{} @@",
        count(before, is_new) + 1,
        count(hunk, is_new),
        count(before, is_old) + 1,
        count(hunk, is_old),
    );
    for line in hunk {
        let _ = match line {
            Line::Both(line) => writeln!(text, " {line}"),
            Line::Old(line) => writeln!(text, "-{line}"),
            Line::New(line) => writeln!(text, "+{line}"),
        };
    }
}

/// The longest common subsequence of lines, with the lines of only one text between them.
fn compare<'a>(old: &[&'a str], new: &[&'a str]) -> Vec<Line<'a>> {
    // lengths[i][j]: that of old[i..] and new[j..].
    let width = new.len() + 1;
    let mut lengths = vec![0_u32; (old.len() + 1) * width];
    for i in (0..old.len()).rev() {
        for j in (0..new.len()).rev() {
            lengths[i * width + j] = if old[i] == new[j] {
                lengths[(i + 1) * width + j + 1] + 1
            } else {
                lengths[(i + 1) * width + j].max(lengths[i * width + j + 1])
            };
        }
    }
    let (mut i, mut j) = (0, 0);
    let mut lines = Vec::new();
    while i < old.len() || j < new.len() {
        if i < old.len() && j < new.len() && old[i] == new[j] {
            lines.push(Line::Both(old[i]));
            (i, j) = (i + 1, j + 1);
        } else if i < old.len()
            && (j == new.len() || lengths[(i + 1) * width + j] >= lengths[i * width + j + 1])
        {
            lines.push(Line::Old(old[i]));
            i += 1;
        } else {
            lines.push(Line::New(new[j]));
            j += 1;
        }
    }
    lines
}

#[cfg(test)]
mod tests {
    use super::unified;

    #[test]
    fn equal_texts_have_no_difference() {
        assert_eq!(unified("a", "x\ny\n", "x\ny\n"), "");
    }

    #[test]
    fn a_change_is_shown_with_three_lines_around_it() {
        let old = "1\n2\n3\n4\n5\n6\n7\n8\n9\n";
        assert_eq!(
            unified("car.toml", old, &old.replace('5', "five")),
            "--- car.toml (old)\n+++ car.toml (new)\n@@ -2,7 +2,7 @@\n 2\n 3\n 4\n-5\n+five\n 6\n 7\n 8\n"
        );
    }

    #[test]
    fn changes_that_are_far_apart_are_hunks_of_their_own() {
        let old: String = (1..=20).map(|line| format!("{line}\n")).collect();
        let new = old.replace("2\n3\n", "2\nthree\n").replace("20\n", "");
        let diff = unified("a", &old, &new);
        assert_eq!(diff.matches("@@ ").count(), 2, "{diff}");
        assert!(diff.contains("@@ -1,6 +1,6 @@"), "{diff}");
        assert!(
            diff.contains("@@ -17,4 +17,3 @@\n 17\n 18\n 19\n-20\n"),
            "{diff}"
        );
    }

    #[test]
    fn a_new_line_counts_in_the_new_text_only() {
        assert_eq!(
            unified("a", "", "x\n"),
            "--- a (old)\n+++ a (new)\n@@ -1,0 +1,1 @@\n+x\n"
        );
    }
}
