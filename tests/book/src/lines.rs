//! The command lines of our programs in a block, without running it.

use std::collections::BTreeMap;

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
#[must_use]
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
#[must_use]
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
mod tests {
    use super::*;

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
