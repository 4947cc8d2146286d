//! Every command line, given to its program with `--help`: it reads all options before, and
//! refuses those that it does not know.

use std::process::Command;

use libtest_mimic::Failed;
use singletrack_book::{Line, lines, spans};

use crate::{Page, programs, root};

/// Checks all command lines of a page, in blocks and in the text.
pub(crate) fn check(page: &Page) -> Result<(), Failed> {
    let mut found: Vec<Line> = page
        .blocks
        .iter()
        .flat_map(|block| lines(&block.text))
        .collect();
    found.extend(prose(&page.text).flat_map(spans));
    let wrong: Vec<String> = found.iter().filter_map(refusal).collect();
    if wrong.is_empty() {
        return Ok(());
    }
    Err(wrong.join("\n").into())
}

/// The lines outside of blocks.
fn prose(text: &str) -> impl Iterator<Item = &str> {
    let mut is_in_block = false;
    text.lines().filter(move |line| {
        let is_fence = line.trim_start().starts_with("```");
        is_in_block ^= is_fence;
        !is_fence && !is_in_block
    })
}

/// Why a command line is wrong.
fn refusal(line: &Line) -> Option<String> {
    let (program, arguments) = match line.program.as_str() {
        "cargo" => match line.arguments.split_first()? {
            (alias, rest) if alias == "demo" => ("singletrack", [&["demo".into()], rest].concat()),
            (alias, rest) if alias == "explore" => ("singletrack-exploration", rest.to_vec()),
            (alias, rest) if alias == "faults" => ("singletrack-faults", rest.to_vec()),
            (alias, rest) if alias == "onboard" => ("singletrack-onboard", rest.to_vec()),
            _ => return missing_example(line),
        },
        program => (program, line.arguments.clone()),
    };
    let output = Command::new(programs().join(program))
        .args(&arguments)
        .arg("--help")
        .output();
    match output {
        Ok(output) if output.status.success() => None,
        Ok(output) => {
            let why = String::from_utf8_lossy(&output.stderr).into_owned();
            let why = why.lines().next().unwrap_or_default().to_owned();
            Some(format!("{program} {}: {why}", arguments.join(" ")))
        }
        Err(error) => Some(format!(
            "{program}: {error}; build the programs: cargo build --bins"
        )),
    }
}

/// `cargo run --example NAME` of an example that does not exist.
fn missing_example(line: &Line) -> Option<String> {
    let at = line.arguments.iter().position(|word| word == "--example")?;
    let file = format!("examples/{}.rs", line.arguments.get(at + 1)?);
    let exists = ["host", "tools", "tests"].iter().any(|folder| {
        let packages = std::fs::read_dir(root().join(folder)).into_iter().flatten();
        packages
            .flatten()
            .any(|package| package.path().join(&file).is_file())
    });
    (!exists).then(|| format!("no package has {file}"))
}
