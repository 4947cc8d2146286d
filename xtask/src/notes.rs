//! The texts that go with the programs: the newest section of `CHANGELOG.md`, and the licences and notices
//! of the libraries that are compiled into them.

use std::{
    collections::{BTreeMap, BTreeSet},
    fs, io,
    path::Path,
};

use crate::{
    prerequisites::{AARCH64, ARMHF},
    process::{Result, at, failure, require, text},
    workspace::{cargo, paths, root},
};

/// The version of the workspace.
pub(crate) const VERSION: &str = env!("CARGO_PKG_VERSION");

/// The newest section of the changelog.
#[derive(Debug, PartialEq, Eq)]
pub(crate) struct Section {
    /// The day of the release, as in 2026-11-27; none before it.
    pub(crate) date: Option<String>,
    pub(crate) text: String,
}

impl Section {
    /// Checks that it is the section of the version with this tag.
    pub(crate) fn check_tag(&self, tag: &str) -> Result {
        require!(
            tag == format!("v{VERSION}"),
            "the tag {tag} is not v{VERSION}, the version in Cargo.toml: change one of them"
        );
        require!(
            self.date.is_some(),
            "CHANGELOG.md begins with \"## Unreleased\": name that section \"## {VERSION} (YYYY-MM-DD)\""
        );
        Ok(())
    }
}

/// The newest section, in a changelog that agrees with the version of the workspace.
pub(crate) fn newest() -> Result<Section> {
    let path = root().join("CHANGELOG.md");
    parse(&fs::read_to_string(&path).map_err(at(&path))?, VERSION)
}

fn parse(text: &str, version: &str) -> Result<Section> {
    let mut sections = text.split("\n## ").skip(1);
    let mut next = || sections.next()?.split_once('\n');
    let (heading, text) = next().ok_or_else(|| failure!("CHANGELOG.md has no section"))?;
    let text = format!("{}\n", text.trim());
    let date = match heading {
        "Unreleased" => {
            if let Some((released, _)) = next() {
                date_of(released, version)?;
            }
            None
        }
        released => Some(date_of(released, version)?),
    };
    Ok(Section { date, text })
}

/// The day in the heading of this version.
fn date_of(heading: &str, version: &str) -> Result<String> {
    let date = heading.strip_prefix(&format!("{version} ("));
    let date = date.and_then(|rest| rest.strip_suffix(')'));
    let day = date.filter(|date| date.split('-').map(str::len).eq([4, 2, 2]));
    day.map(str::to_owned).ok_or_else(|| {
        failure!(
            "CHANGELOG.md: the newest version is \"## {heading}\", but Cargo.toml has {version}: \
             give that section the heading \"## Unreleased\" or \"## {version} (YYYY-MM-DD)\", or \
             change the version in Cargo.toml"
        )
    })
}

/// The computers that a release is for.
pub(crate) const TARGETS: [&str; 3] = ["x86_64-unknown-linux-gnu", AARCH64.triple, ARMHF.triple];

/// Lists the libraries of programs, or of other packages of the workspace, and adds their notices; for
/// these targets, or for this machine.
pub(crate) fn licences(programs: &[(&str, &str)], triples: &[&str]) -> Result<String> {
    let packages = programs.iter().flat_map(|one| ["--package", one.1]);
    let targets = triples.iter().flat_map(|triple| ["--target", triple]);
    let mut tree = cargo("tree --locked --edges normal --prefix none --format {p}|{l}");
    let tree = text(tree.args(packages).args(targets))?;
    let libraries = libraries(&tree);
    let metadata = text(&mut cargo("metadata --locked --format-version 1"))?;
    let manifests = paths(&metadata, "manifest_path");
    let mut of_notice: BTreeMap<String, Vec<&str>> = BTreeMap::new();
    for library in libraries.keys() {
        let name = format!("{}/Cargo.toml", library.replace(' ', "-"));
        let manifest = manifests.iter().find(|path| path.ends_with(&name));
        let unknown = || failure!("`cargo metadata` does not know {library}");
        let folder = manifest.ok_or_else(unknown)?.with_file_name("");
        for notice in read(&folder).map_err(at(&folder))? {
            of_notice.entry(notice).or_default().push(library);
        }
    }
    Ok(page(&libraries, &of_notice))
}

/// Name and version, and the licence, of the libraries in the output of `cargo tree`; packages of
/// the workspace have a path.
fn libraries(tree: &str) -> BTreeMap<String, &str> {
    tree.lines().filter_map(library).collect()
}

fn library(line: &str) -> Option<(String, &str)> {
    let (package, licence) = line.split_once('|')?;
    // A path follows the version, or "(proc-macro)".
    let (name, rest) = package.split_once(" v")?;
    let version = rest.split(' ').next()?;
    let library = format!("{name} {version}");
    (!rest.contains('/')).then(|| (library, licence.trim_end_matches(" (*)")))
}

/// The files of a package that hold licences and notices.
fn read(folder: &Path) -> io::Result<BTreeSet<String>> {
    const STARTS: &str = "LICENSE LICENCE COPYING COPYRIGHT NOTICE UNLICENSE";
    let mut texts = BTreeSet::new();
    for entry in fs::read_dir(folder)? {
        let path = entry?.path();
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        let name = name.to_uppercase();
        if path.is_file() && STARTS.split(' ').any(|start| name.starts_with(start)) {
            let text = fs::read(path)?;
            texts.insert(String::from_utf8_lossy(&text).trim().to_owned());
        }
    }
    Ok(texts)
}

fn page(libraries: &BTreeMap<String, &str>, of_notice: &BTreeMap<String, Vec<&str>>) -> String {
    let title = "Libraries that are compiled into the programs of Singletrack, and their licences";
    let library = |(library, licence)| format!("{library}: {licence}\n");
    let libraries: String = libraries.iter().map(library).collect();
    let notice = |(text, of): (_, &Vec<&str>)| format!("\n\n==== {}\n\n{text}\n", of.join(", "));
    let notices: String = of_notice.iter().map(notice).collect();
    format!("{title}\n\n{libraries}{notices}")
}

#[cfg(test)]
mod tests {
    use super::*;

    const RELEASED: &str = "# Changelog\n\n## 0.2.0 (2026-12-01)\n\n### Board\n\n- New.\n\n\
                            ## 0.1.0 (2026-11-27)\n\n- First.\n";

    #[test]
    fn the_changelog_agrees_with_the_version() {
        newest().unwrap();
    }

    #[test]
    fn the_notes_are_the_newest_section() {
        let newest = parse(RELEASED, "0.2.0").unwrap();
        assert_eq!(newest.date.as_deref(), Some("2026-12-01"));
        assert_eq!(newest.text, "### Board\n\n- New.\n");
    }

    #[test]
    fn what_is_not_released_has_no_date() {
        for (text, version) in [
            (
                "# Changelog\n\n## Unreleased\n\n- New.\n".to_owned(),
                "0.1.0",
            ),
            (
                RELEASED.replacen("\n## ", "\n## Unreleased\n\n- New.\n\n## ", 1),
                "0.2.0",
            ),
        ] {
            let newest = parse(&text, version).unwrap();
            assert_eq!((newest.date, newest.text.as_str()), (None, "- New.\n"));
        }
    }

    #[test]
    fn a_version_that_is_not_that_of_the_workspace_is_refused() {
        for text in [
            RELEASED.to_owned(),
            RELEASED.replacen("\n## ", "\n## Unreleased\n\n- New.\n\n## ", 1),
            RELEASED.replace("0.2.0 (2026-12-01)", "0.3.0"),
            RELEASED.replace("0.2.0 (2026-12-01)", "0.3.0 (soon)"),
        ] {
            let why = parse(&text, "0.3.0").unwrap_err().to_string();
            assert!(why.contains("Cargo.toml has 0.3.0"), "{why}");
        }
    }

    #[test]
    fn a_tag_is_that_of_a_released_version() {
        let mut section = Section {
            date: None,
            text: String::new(),
        };
        let tag = format!("v{VERSION}");
        let why = section.check_tag(&tag).unwrap_err().to_string();
        assert!(why.contains("Unreleased"), "{why}");
        section.date = Some("2026-11-27".to_owned());
        section.check_tag(&tag).unwrap();
        let why = section.check_tag("v99.0.0").unwrap_err().to_string();
        assert!(why.contains("v99.0.0"), "{why}");
    }

    #[test]
    fn libraries_are_those_without_a_path() {
        let tree = "singletrack v0.1.0 (/checkout/tools/cli)|MIT OR Apache-2.0\n\
                    serde_derive v1.0.1 (proc-macro)|MIT\n\
                    zstd v0.14.3|BSD-3-Clause\n\
                    \n\
                    zstd v0.14.3|BSD-3-Clause (*)\n";
        let found: Vec<_> = libraries(tree).into_iter().collect();
        assert_eq!(
            found,
            [
                ("serde_derive 1.0.1".to_owned(), "MIT"),
                ("zstd 0.14.3".to_owned(), "BSD-3-Clause")
            ]
        );
    }

    #[test]
    fn a_notice_is_printed_once_for_all_its_libraries() {
        let libraries = ["one 1.0.0", "two 1.0.0"];
        let notices = BTreeMap::from([("Copyright me".to_owned(), libraries.to_vec())]);
        let libraries = libraries.map(|library| (library.to_owned(), "MIT")).into();
        let text = page(&libraries, &notices);
        assert!(text.contains("two 1.0.0: MIT\n"), "{text}");
        assert!(
            text.ends_with("==== one 1.0.0, two 1.0.0\n\nCopyright me\n"),
            "{text}"
        );
    }
}
