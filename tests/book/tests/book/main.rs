//! The commands of the documentation: `cargo verify book`.
//!
//! `cargo test -p singletrack-book --test book -- tutorial` runs one page. The programs
//! are those beside this one, from `cargo build --bins`.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test may fail")]

mod parsed;
mod run;

use std::{
    env, fs,
    path::{Path, PathBuf},
    process::ExitCode,
};

use libtest_mimic::{Arguments, Failed, Trial};
use singletrack_book::{Block, Kind, blocks};

/// The pages with commands, and those with kinds of blocks explained.
const KINDS_PAGE: &str = "docs/contributing.md";

/// A page of the documentation.
#[derive(Clone)]
pub struct Page {
    /// Its path from the root of the repository.
    pub name: String,
    /// Its text.
    pub text: String,
    /// Its blocks of shell commands.
    pub blocks: Vec<Block>,
}

/// The root of the repository.
pub fn root() -> PathBuf {
    let own = Path::new(env!("CARGO_MANIFEST_DIR"));
    own.ancestors().nth(2).unwrap().to_owned()
}

/// The folder with the programs: that of this program's profile.
pub fn programs() -> PathBuf {
    let own = env::current_exe().unwrap();
    own.ancestors().nth(2).unwrap().to_owned()
}

fn pages() -> Result<Vec<Page>, String> {
    let root = root();
    let mut paths = vec![root.join("README.md")];
    let mut folders = vec![root.join("docs")];
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                folders.push(path);
            } else if path.extension().is_some_and(|ending| ending == "md") {
                paths.push(path);
            }
        }
    }
    paths.sort();
    let mut pages = Vec::new();
    for path in paths {
        let name = path.strip_prefix(&root).unwrap().display().to_string();
        let text = fs::read_to_string(&path).unwrap();
        let blocks = blocks(&text).map_err(|error| format!("{name}: {error}"))?;
        pages.push(Page { name, text, blocks });
    }
    Ok(pages)
}

/// Every kind is explained, and used; most blocks that could run do.
fn kinds_are_explained(pages: &[Page]) -> Result<(), Failed> {
    let page = pages.iter().find(|page| page.name == KINDS_PAGE).unwrap();
    for kind in Kind::ALL {
        let row = format!("| `{}` |", kind.word());
        if !page.text.contains(&row) {
            return Err(format!("{KINDS_PAGE} does not explain {row}").into());
        }
        let mut blocks = pages.iter().flat_map(|page| &page.blocks);
        if !blocks.any(|block| block.kinds.contains(&kind)) {
            return Err(format!("no block is {}: remove the kind", kind.word()).into());
        }
    }
    let blocks: Vec<_> = pages.iter().flat_map(|page| &page.blocks).collect();
    let run = blocks.iter().filter(|block| block.runs()).count();
    println!("{run} of {} blocks run", blocks.len());
    if 2 * run < blocks.len() - excused(&blocks) {
        return Err(format!("only {run} of {} blocks run", blocks.len()).into());
    }
    Ok(())
}

/// Blocks that a test can't run on any machine.
fn excused(blocks: &[&Block]) -> usize {
    let outside = [Kind::Install, Kind::Hardware, Kind::Elsewhere, Kind::Build];
    let is_outside = |block: &&&Block| outside.iter().any(|kind| block.kinds.contains(kind));
    blocks.iter().filter(is_outside).count()
}

fn main() -> ExitCode {
    let arguments = Arguments::from_args();
    let pages = match pages() {
        Ok(pages) => pages,
        Err(error) => {
            eprintln!("{error}");
            return ExitCode::FAILURE;
        }
    };
    let mut trials = Vec::new();
    let all = pages.clone();
    trials.push(Trial::test("kinds_are_explained", move || {
        kinds_are_explained(&all)
    }));
    for (number, page) in pages.into_iter().enumerate() {
        let parsed = page.clone();
        trials.push(Trial::test(format!("parsed {}", page.name), move || {
            parsed::check(&parsed)
        }));
        if page.blocks.iter().any(Block::runs) {
            trials.push(Trial::test(format!("run {}", page.name), move || {
                run::run(&page, number)
            }));
        }
    }
    libtest_mimic::run(&arguments, trials).exit_code()
}
