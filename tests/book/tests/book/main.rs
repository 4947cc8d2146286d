//! The commands of the documentation: `cargo verify book`.
//!
//! `cargo test -p singletrack-book --test book -- tutorial` runs one page. The programs
//! are those beside this one, from `cargo build --bins`, and the examples from `cargo test --no-run`.
//!
//! The blocks of a page run in a folder that looks like a clone of the repository. It holds links to
//! the files, so that nothing is written to the repository. Pages run beside each other: each has its
//! own address of the loopback network for the cameras, and `/tmp` in its commands is its own folder.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test may fail")]

use std::{
    collections::BTreeMap,
    env, fs,
    os::unix::fs::{PermissionsExt, symlink},
    path::{Path, PathBuf},
    process::{Command, ExitCode, Output},
    sync::{PoisonError, RwLock},
};

use libtest_mimic::{Arguments, Failed, Trial};
use singletrack_book::{Block, Kind, Line, Printed, blocks, lines, printed, quoted, spans};
use tempfile::TempDir;

/// The pages with commands, and those with kinds of blocks explained.
const KINDS_PAGE: &str = "docs/contributing.md";

/// The pages whose quotations are messages of the programs.
const QUOTES: [&str; 3] = [
    "docs/troubleshooting.md",
    "docs/first-drive.md",
    "docs/my-car.md",
];

/// A page of the documentation.
#[derive(Clone)]
pub struct Page {
    /// Its path from the root of the repository.
    pub name: String,
    /// Its text.
    pub text: String,
    /// Its blocks of shell commands.
    pub blocks: Vec<Block>,
    /// What it says that commands print.
    pub printed: Vec<Printed>,
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
        let printed = printed(&text);
        pages.push(Page {
            name,
            text,
            blocks,
            printed,
        });
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
            check(&parsed)
        }));
        if QUOTES.contains(&page.name.as_str()) {
            let page = page.clone();
            trials.push(Trial::test(format!("quoted {}", page.name), move || {
                are_messages(&page)
            }));
        }
        if !page.printed.is_empty() {
            let page = page.clone();
            trials.push(Trial::test(format!("printed {}", page.name), move || {
                compare(&page, number)
            }));
        }
        if page.blocks.iter().any(Block::runs) {
            trials.push(Trial::test(format!("run {}", page.name), move || {
                run(&page, number)
            }));
        }
    }
    libtest_mimic::run(&arguments, trials).exit_code()
}

/// Functions for the commands.
const PRELUDE: &str = include_str!("prelude.sh");

/// Pages with a simulated car run alone: it is simulated in real time.
static MACHINE: RwLock<()> = RwLock::new(());

/// How often such a page is tried on a machine that is too busy for the simulated car.
const MOST_TRIES: usize = 5;

/// What the daemon says when the simulated car, or itself, was not given the processor.
const STARVED: [&str; 3] = [
    "frames of the motion capture have stopped",
    "board lost: silence",
    "dropped for want of room",
];

/// Does it beside the others, or, with a simulated car, alone; and again while the machine is too busy
/// for the car.
fn on_machine(
    page: &Page,
    has_car: bool,
    mut once: impl FnMut() -> Result<(), Failed>,
) -> Result<(), Failed> {
    if !has_car {
        let _others = MACHINE.read().unwrap_or_else(PoisonError::into_inner);
        return once();
    }
    let _alone = MACHINE.write().unwrap_or_else(PoisonError::into_inner);
    let mut tries = 1;
    loop {
        let result = once();
        let is_starved = result.as_ref().is_err_and(|failed| {
            let said = failed.message().unwrap_or_default();
            STARVED.iter().any(|words| said.contains(words))
        });
        if !is_starved || tries == MOST_TRIES {
            return result;
        }
        eprintln!(
            "{}: the machine was too busy for the simulated car; again",
            page.name
        );
        tries += 1;
    }
}

/// What commands run in: a folder with the clone, the programs and what stands for `/tmp`, and an address
/// for the cameras.
struct Stage {
    scratch: TempDir,
    address: String,
}

impl Stage {
    fn new(number: usize) -> Result<Self, Failed> {
        let scratch = TempDir::with_prefix("book-")?;
        let folder = scratch.path();
        let address = format!("127.34.0.{}", number + 1);
        clone(&folder.join("clone"))?;
        wrap_programs(&folder.join("bin"), &address)?;
        fs::create_dir(folder.join("tmp"))?;
        Ok(Self { scratch, address })
    }

    /// Runs these commands in a shell, for five minutes at most.
    fn run(&self, commands: &str) -> Result<Output, Failed> {
        let folder = self.scratch.path();
        let script = commands
            .replace("/tmp/", &format!("{}/tmp/", folder.display()))
            .replace("127.0.0.1", &self.address);
        fs::write(folder.join("script"), script)?;
        let path = format!("{}:/usr/bin:/bin", folder.join("bin").display());
        let output = Command::new("timeout")
            .args(["--kill-after=5", "300", "bash"])
            .arg(folder.join("script"))
            .current_dir(folder.join("clone"))
            .env("PATH", path)
            .env("SCRATCH", folder)
            .env("EXAMPLES", programs().join("examples"))
            .env_remove("SINGLETRACK_SOCKET")
            .env("TERM", "dumb")
            .output()?;
        Ok(output)
    }

    /// Its text, with the names that it has on a page.
    fn text(&self, bytes: &[u8]) -> String {
        let folder = format!("{}/tmp/", self.scratch.path().display());
        let text = String::from_utf8_lossy(bytes);
        text.replace(&folder, "/tmp/")
            .replace(&self.address, "127.0.0.1")
    }
}

/// Runs a page's blocks in order, in one shell.
fn run(page: &Page, number: usize) -> Result<(), Failed> {
    let is_real_time = page
        .blocks
        .iter()
        .any(|block| block.kinds.contains(&Kind::Car) || block.kinds.contains(&Kind::Background));
    on_machine(page, is_real_time, || run_once(page, number))
}

fn run_once(page: &Page, number: usize) -> Result<(), Failed> {
    let stage = Stage::new(number)?;
    let mut script = PRELUDE.to_owned();
    let starts_daemon = page.blocks.iter().any(|block| {
        block.runs()
            && !block.kinds.contains(&Kind::Car)
            && block.text.contains("singletrackd --config")
    });
    for block in page.blocks.iter().filter(|block| block.runs()) {
        script.push_str(&commands(page, block, starts_daemon)?);
    }
    script.push_str("finish\n");
    let output = stage.run(&script)?;
    if output.status.success() {
        return Ok(());
    }
    let tail = |bytes: &[u8]| {
        let text = stage.text(bytes);
        let lines: Vec<&str> = text.lines().collect();
        lines[lines.len().saturating_sub(30)..].join("\n")
    };
    let (said, complained) = (tail(&output.stdout), tail(&output.stderr));
    Err(format!(
        "{}: {}\n{said}\n---\n{complained}",
        page.name, output.status
    )
    .into())
}

/// Compares what a page says that commands print with what they print. The functions of the prelude are
/// commands, too: `car; singletrack status`.
fn compare(page: &Page, number: usize) -> Result<(), Failed> {
    let has_car = |part: &Printed| {
        ["car;", " & "]
            .iter()
            .any(|sign| part.command.contains(sign))
    };
    let has_car = page.printed.iter().any(has_car);
    on_machine(page, has_car, || compare_once(page, number))
}

fn compare_once(page: &Page, number: usize) -> Result<(), Failed> {
    let mut outputs = BTreeMap::new();
    for Printed { command, .. } in &page.printed {
        if !outputs.contains_key(command) {
            let stage = Stage::new(number)?;
            // A refusal is printed, too.
            let script = format!("exec 2>&1\n{PRELUDE}trap - ERR\nset +e\n{command}\n");
            outputs.insert(command, stage.text(&stage.run(&script)?.stdout));
        }
    }
    let wrong = |part: &Printed| part.compare(&outputs[&part.command]).err();
    let wrong: Vec<_> = page.printed.iter().filter_map(wrong).collect();
    match wrong.is_empty() {
        true => Ok(()),
        false => Err(format!("{}: {}", page.name, wrong.join("\n")).into()),
    }
}

/// The messages that a page quotes are in the code of a program.
fn are_messages(page: &Page) -> Result<(), Failed> {
    let mut code = String::new();
    let mut folders: Vec<_> = ["host", "tools", "lab", "firmware"]
        .map(|name| root().join(name))
        .into();
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(folder)? {
            let path = entry?.path();
            if path.is_dir() {
                folders.push(path);
            } else if path.extension().is_some_and(|ending| ending == "rs") {
                code += &fs::read_to_string(&path)?;
            }
        }
    }
    let line = |text: &str| text.split_whitespace().collect::<Vec<_>>().join(" ");
    let code = line(&code.replace("\\\n", " "));
    let prose: Vec<_> = prose(&page.text).collect();
    let mut wrong = quoted(&line(&prose.join(" ")));
    wrong.retain(|message| !code.contains(message));
    match wrong.is_empty() {
        true => Ok(()),
        false => Err(format!("{}: no program has {wrong:?}", page.name).into()),
    }
}

/// The commands that run a block.
fn commands(page: &Page, block: &Block, starts_daemon: bool) -> Result<String, Failed> {
    let is = |kind| block.kinds.contains(&kind);
    let mut text = format!("at '{}:{}'\n", page.name, block.line);
    if is(Kind::Car) {
        text.push_str(if starts_daemon {
            "await_ready\n"
        } else {
            "car\n"
        });
    }
    let joined = block.text.replace("\\\n", " ");
    let lines = joined
        .lines()
        .map(|line| line.split(" #").next().unwrap_or_default().trim())
        .filter(|line| !line.is_empty() && !line.starts_with('#'));
    match (is(Kind::Background), is(Kind::Interrupted)) {
        (true, _) => {
            let lines: Vec<&str> = lines.collect();
            let [line] = lines.as_slice() else {
                return Err("a block in the background has one command".into());
            };
            text.push_str(&format!("{line} &\n"));
        }
        (_, true) => {
            for line in lines {
                text.push_str(&format!("interrupted '{}'\n", line.replace('\'', "'\\''")));
            }
        }
        _ => text.push_str(&block.text),
    }
    Ok(text)
}

/// A folder with links to the repository's files, whose own folders can be written to.
fn clone(folder: &Path) -> Result<(), Failed> {
    fs::create_dir_all(folder)?;
    for entry in fs::read_dir(root())? {
        let entry = entry?;
        let name = entry.file_name();
        if name != "target" && name != ".git" {
            symlink(entry.path(), folder.join(name))?;
        }
    }
    Ok(())
}

/// The programs; the simulator at the page's own address.
fn wrap_programs(folder: &Path, address: &str) -> Result<(), Failed> {
    fs::create_dir_all(folder)?;
    for name in [
        "singletrack",
        "singletrackd",
        "singletrack-lab",
        "singletrack-sim",
        "singletrack-faults",
    ] {
        let program = programs().join(name);
        if !program.is_file() {
            let advice = "cargo build --bins";
            return Err(format!("{} is missing: {advice}", program.display()).into());
        }
        if name == "singletrack-sim" {
            let file = folder.join(name);
            let port = "\"$SCRATCH/tmp/singletrack-board\"";
            let options = format!("--interface {address} --port {port}");
            let text = format!(
                "#!/bin/sh\n# Ahead of other programs where the system allows it, as the daemon.\n\
                 if chrt --rr 20 true 2> /dev/null; then ahead='chrt --rr 20'; fi\n\
                 exec ${{ahead:-}} {} {options} \"$@\"\n",
                program.display()
            );
            fs::write(&file, text)?;
            fs::set_permissions(&file, fs::Permissions::from_mode(0o755))?;
        } else {
            symlink(program, folder.join(name))?;
        }
    }
    Ok(())
}

/// Checks all command lines of a page, in blocks and in the text.
fn check(page: &Page) -> Result<(), Failed> {
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
