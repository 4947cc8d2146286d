//! The documentation, compared with the repository: pages, links, anchors, paths
//! and the dependencies of the crates.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    reason = "the helpers of tests may fail as tests do"
)]

use std::{
    collections::{BTreeMap, BTreeSet},
    fs,
    path::{Component, Path, PathBuf},
};

/// The longest README that is still read, in words.
const README_WORDS: usize = 700;

/// The folder that holds the workspace.
pub(crate) fn root() -> PathBuf {
    let own = Path::new(env!("CARGO_MANIFEST_DIR"));
    let root = own.ancestors().find(|folder| {
        let file = folder.join("docs/SUMMARY.md");
        file.is_file()
    });
    root.unwrap().to_owned()
}

/// Every Markdown file of the repository, by its path from the root.
fn pages() -> BTreeMap<PathBuf, String> {
    let root = root();
    let mut pages = BTreeMap::new();
    let mut folders = vec![root.clone()];
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(&folder).unwrap() {
            let path = entry.unwrap().path();
            let name = path.file_name().unwrap().to_string_lossy();
            if name.starts_with('.') || name == "target" || name.starts_with("singletrack-") {
                continue;
            }
            if path.is_dir() {
                folders.push(path);
            } else if name.ends_with(".md") {
                let text = fs::read_to_string(&path).unwrap();
                pages.insert(path.strip_prefix(&root).unwrap().to_owned(), text);
            }
        }
    }
    assert!(pages.len() >= 25, "only {} pages", pages.len());
    pages
}

/// The lines of a page outside of its code blocks.
fn prose(text: &str) -> impl Iterator<Item = &str> {
    let mut in_code = false;
    text.lines().filter(move |line| {
        let fence = line.trim_start().starts_with("```");
        in_code ^= fence;
        !fence && !in_code
    })
}

/// The lines of a page's shell commands.
fn commands(text: &str) -> impl Iterator<Item = &str> {
    let mut in_commands = false;
    text.lines().filter(move |line| {
        let line = line.trim_start();
        if line.starts_with("```") {
            in_commands = line.split(' ').next() == Some("```sh");
        }
        in_commands && !line.starts_with("```")
    })
}

/// A line without its code spans, and the code spans.
fn split_code(line: &str) -> (String, Vec<&str>) {
    let parts: Vec<&str> = line.split('`').collect();
    let text = parts.iter().step_by(2).copied().collect();
    (text, parts.into_iter().skip(1).step_by(2).collect())
}

/// The targets of the links and pictures of a page.
fn links(text: &str) -> Vec<String> {
    prose(text)
        .flat_map(|line| {
            let (text, _) = split_code(line);
            let targets: Vec<String> = text
                .split("](")
                .skip(1)
                .filter_map(|rest| Some(rest.split_once(')')?.0.to_owned()))
                .collect();
            targets
        })
        .collect()
}

/// The anchors of a page: its headings in lower case, with `-` for spaces, as
/// code hosts and mdBook make them.
fn anchors(text: &str) -> BTreeSet<String> {
    prose(text)
        .filter(|line| line.starts_with('#'))
        .map(|line| {
            line.trim_start_matches('#')
                .trim()
                .chars()
                .filter_map(|letter| match letter {
                    ' ' => Some('-'),
                    '-' | '_' => Some(letter),
                    _ if letter.is_alphanumeric() => Some(letter.to_ascii_lowercase()),
                    _ => None,
                })
                .collect()
        })
        .collect()
}

/// A path without `.` and `..`; none if it leaves the repository.
fn normal(path: &Path) -> Option<PathBuf> {
    let mut normal = PathBuf::new();
    for part in path.components() {
        match part {
            Component::Normal(name) => normal.push(name),
            Component::CurDir => {}
            Component::ParentDir if normal.pop() => {}
            _ => return None,
        }
    }
    Some(normal)
}

#[test]
fn every_relative_link_and_anchor_resolves() {
    let pages = pages();
    let mut count = 0;
    for (page, text) in &pages {
        for link in links(text) {
            if link.contains("://") || link.starts_with("mailto:") {
                continue;
            }
            count += 1;
            let (file, anchor) = link.split_once('#').unwrap_or((&link, ""));
            let target = if file.is_empty() {
                page.clone()
            } else {
                let folder = page.parent().unwrap();
                normal(&folder.join(file))
                    .unwrap_or_else(|| panic!("{}: {link} leaves the repository", page.display()))
            };
            assert!(
                root().join(&target).exists(),
                "{}: {link} does not exist",
                page.display()
            );
            if !anchor.is_empty() {
                let anchors = anchors(&pages[&target]);
                assert!(
                    anchors.contains(anchor),
                    "{}: {link} is no heading of {}",
                    page.display(),
                    target.display()
                );
            }
        }
    }
    assert!(count >= 100, "only {count} links");
}

/// The site holds `docs/` alone: a link out of it works on a code host only.
#[test]
fn pages_of_the_site_link_to_the_site() {
    for (page, text) in pages() {
        if !page.starts_with("docs") {
            continue;
        }
        for link in links(&text) {
            assert!(!link.starts_with(".."), "{}: {link}", page.display());
        }
    }
}

#[test]
fn every_page_of_the_site_is_in_its_summary_once() {
    let pages = pages();
    let summary = &pages[Path::new("docs/SUMMARY.md")];
    let mut listed = links(summary);
    listed.sort();
    let there: Vec<String> = pages
        .keys()
        .filter_map(|page| page.strip_prefix("docs").ok())
        .map(|page| page.to_string_lossy().into_owned())
        .filter(|page| page != "SUMMARY.md")
        .collect();
    assert_eq!(listed, there);
}

/// Pictures drawn by hand: words for screen readers, and a background of their own, because a page
/// may be dark.
#[test]
fn pictures_have_words_and_a_background() {
    let mut count = 0;
    for entry in fs::read_dir(root().join("docs/images")).unwrap() {
        let path = entry.unwrap().path();
        let text = fs::read_to_string(&path).unwrap();
        for part in ["<title", "<desc", "fill=\"#fff\"/>"] {
            assert!(text.contains(part), "{}: no {part}", path.display());
        }
        count += 1;
    }
    assert!(count >= 4, "only {count} pictures");
}

/// The pins of the picture are those of the table below it.
#[test]
fn the_wiring_is_drawn_as_the_table_says() {
    let page = fs::read_to_string(root().join("docs/uno.md")).unwrap();
    let picture = fs::read_to_string(root().join("docs/images/wiring.svg")).unwrap();
    let table = page.split("| pin | what | how |\n|---|---|---|\n").nth(1);
    let mut count = 0;
    for row in table
        .unwrap()
        .lines()
        .take_while(|line| line.starts_with('|'))
    {
        for pin in row.split('|').nth(1).unwrap().split(',') {
            assert!(
                picture.contains(&format!(">{}</text>", pin.trim())),
                "{pin}"
            );
            count += 1;
        }
    }
    assert!(count >= 8, "only {count} pins");
}

#[test]
fn the_readme_is_short() {
    let words = pages()[Path::new("README.md")].split_whitespace().count();
    assert!(words <= README_WORDS, "{words} words");
}

#[test]
fn every_file_of_the_repository_that_a_page_names_exists() {
    let root = root();
    let folders = [
        "docs/",
        "firmware/",
        "firmware-sim/",
        "host/",
        "packaging/",
        "protocol/",
        "templates/",
        "tests/",
        "tools/",
        "xtask/",
    ];
    let endings = [".rs", ".toml", ".py", ".service", ".conf", ".rules", ".csv"];
    let mut count = 0;
    for (page, text) in pages() {
        let shell = commands(&text)
            .flat_map(str::split_whitespace)
            .filter(|word| !word.contains(['$', '{', '*']));
        let named = prose(&text)
            .flat_map(|line| split_code(line).1)
            .filter(|word| endings.iter().any(|ending| word.ends_with(ending)));
        for word in shell.chain(named) {
            if folders.iter().any(|folder| word.starts_with(folder)) {
                count += 1;
                assert!(
                    root.join(word).exists(),
                    "{}: {word} does not exist",
                    page.display()
                );
            }
        }
    }
    assert!(count >= 20, "only {count} files");
}

/// The crates of this repository that a manifest depends on, without those for tests.
fn dependencies(manifest: &str) -> BTreeSet<String> {
    let mut section = "";
    let mut names = BTreeSet::new();
    for line in manifest.lines() {
        if line.starts_with('[') {
            section = line;
        } else if section == "[dependencies]" && line.starts_with("singletrack") {
            let name = line.split(['.', ' ']).next().unwrap();
            names.insert(short(name).to_owned());
        }
    }
    names
}

/// The name of a crate on the architecture page.
fn short(name: &str) -> &str {
    match name {
        "singletrack" => "cli",
        "singletrackd" => "daemon",
        name => name.strip_prefix("singletrack-").unwrap_or(name),
    }
}

#[test]
fn the_crates_depend_on_each_other_as_the_architecture_page_allows() {
    let page = include_str!("../../../docs/architecture.md");
    let mut wings = ["of the car", "of the lab, or of tests"].map(|wing| {
        let head = format!("| crate {wing} | may depend on |\n|---|---|\n");
        let table = page.split(&head).nth(1).unwrap().lines();
        let mut crates = BTreeMap::new();
        for row in table.map_while(|line| line.strip_prefix("| ")) {
            let (names, dependencies) = row.trim_end_matches(" |").split_once(" | ").unwrap();
            for name in names.split(", ") {
                crates.insert(name.to_owned(), dependencies);
            }
        }
        crates
    });
    let [car, lab] = &mut wings;
    for (name, dependencies) in &*car {
        let of_lab = dependencies.split(", ").find(|one| lab.contains_key(*one));
        assert_eq!(of_lab, None, "{name} drives a car, and needs no lab");
        assert_ne!(*dependencies, "(any)", "{name}");
    }
    car.append(lab);
    let allowed = car;
    let mut manifests = vec![root()];
    let mut count = 0;
    while let Some(folder) = manifests.pop() {
        for entry in fs::read_dir(&folder).unwrap() {
            let path = entry.unwrap().path();
            let name = path.file_name().unwrap().to_string_lossy().into_owned();
            if path.is_dir() && !name.starts_with('.') && name != "target" {
                manifests.push(path);
            } else if name == "Cargo.toml" {
                let text = fs::read_to_string(&path).unwrap();
                let package = text.lines().find_map(|line| line.strip_prefix("name = \""));
                let Some(package) = package.filter(|_| text.starts_with("[package]")) else {
                    continue;
                };
                let package = short(package.trim_end_matches('"'));
                if ["xtask", "real-packets"].contains(&package) {
                    continue;
                }
                let allowed = allowed
                    .get(package)
                    .unwrap_or_else(|| panic!("{package} is not on the architecture page"));
                if *allowed != "(any)" {
                    let allowed: BTreeSet<_> = allowed.split(", ").map(str::to_owned).collect();
                    let extra: Vec<_> = dependencies(&text).difference(&allowed).cloned().collect();
                    assert!(extra.is_empty(), "{package} depends on {extra:?}");
                }
                count += 1;
            }
        }
    }
    assert_eq!(count, allowed.len(), "crates, and names on the page");
}
