//! The libraries that are compiled into programs, with their licences and notices: these go with
//! the programs.

use std::{
    collections::{BTreeMap, BTreeSet},
    fmt::Write as _,
    fs,
    path::Path,
};

use crate::{
    process::{Failure, failure, text},
    target,
    toolchain::{AARCH64, ARMHF},
    workspace::cargo,
};

/// The computers that a release is for.
pub(crate) const TARGETS: [&str; 3] = ["x86_64-unknown-linux-gnu", AARCH64.triple, ARMHF.triple];

/// Lists the libraries of programs, or of other packages of the workspace, and adds their notices; for
/// these targets, or for this machine.
pub(crate) fn notices(programs: &[(&str, &str)], triples: &[&str]) -> Result<String, Failure> {
    let mut tree = cargo();
    tree.args(["tree", "--locked", "--edges", "normal", "--prefix", "none"])
        .args(["--format", "{p}|{l}"])
        .args(
            programs
                .iter()
                .flat_map(|(_, package)| ["--package", package]),
        )
        .args(triples.iter().flat_map(|triple| ["--target", triple]));
    let tree = text(&mut tree)?;
    let libraries = libraries(&tree);
    let metadata = text(cargo().args(["metadata", "--locked", "--format-version", "1"]))?;
    let manifests = target::paths(&metadata, "manifest_path");
    let mut of_notice: BTreeMap<String, Vec<&str>> = BTreeMap::new();
    for library in libraries.keys() {
        let folder = library.replace(' ', "-");
        let folder = manifests
            .iter()
            .filter_map(|manifest| manifest.parent())
            .find(|place| place.ends_with(&folder))
            .ok_or_else(|| failure!("`cargo metadata` does not know {library}"))?;
        for notice in read(folder)? {
            of_notice.entry(notice).or_default().push(library);
        }
    }
    Ok(page(&libraries, &of_notice))
}

/// Name and version, and the licence, of the libraries in the output of `cargo tree`; packages of
/// the workspace have a path.
fn libraries(tree: &str) -> BTreeMap<String, &str> {
    tree.lines()
        .filter_map(|line| {
            let (package, licence) = line.split_once('|')?;
            // A path follows the version, or "(proc-macro)".
            let (name, rest) = package.split_once(" v")?;
            let version = rest.split(' ').next()?;
            (!rest.contains('/')).then(|| {
                (
                    format!("{name} {version}"),
                    licence.trim_end_matches(" (*)"),
                )
            })
        })
        .collect()
}

/// The files of a package that hold licences and notices.
fn read(folder: &Path) -> Result<BTreeSet<String>, Failure> {
    const STARTS: [&str; 6] = [
        "LICENSE",
        "LICENCE",
        "COPYING",
        "COPYRIGHT",
        "NOTICE",
        "UNLICENSE",
    ];
    let texts = || {
        let mut texts = BTreeSet::new();
        for entry in fs::read_dir(folder)? {
            let path = entry?.path();
            let name = path.file_name().unwrap_or_default().to_string_lossy();
            let name = name.to_uppercase();
            if path.is_file() && STARTS.iter().any(|start| name.starts_with(start)) {
                let text = fs::read(path)?;
                texts.insert(String::from_utf8_lossy(&text).trim().to_owned());
            }
        }
        Ok(texts)
    };
    texts().map_err(|error: std::io::Error| failure!("can't read {}: {error}", folder.display()))
}

fn page(libraries: &BTreeMap<String, &str>, of_notice: &BTreeMap<String, Vec<&str>>) -> String {
    let mut text =
        "Libraries that are compiled into the programs of Singletrack, and their licences\n\n"
            .to_owned();
    for (library, licence) in libraries {
        let _ = writeln!(text, "{library}: {licence}");
    }
    for (notice, of) in of_notice {
        let _ = write!(text, "\n\n==== {}\n\n{notice}\n", of.join(", "));
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn libraries_are_those_without_a_path() {
        let tree = "singletrack v0.1.0 (/work/tools/cli)|MIT OR Apache-2.0\n\
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
