//! The libraries that are compiled into programs, with their licences and notices: these go with
//! the programs.

use std::{
    collections::{BTreeMap, BTreeSet},
    fmt::Write as _,
    fs,
    path::{Path, PathBuf},
};

use crate::{
    process::{Failure, output},
    target,
    workspace::cargo,
};

/// A library from the registry.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
struct Library {
    name: String,
    version: String,
    licence: String,
}

/// Lists the libraries of packages of the workspace, for a target, and adds their notices.
pub(crate) fn notices(packages: &[&str], triple: Option<&str>) -> Result<String, Failure> {
    let mut tree = cargo();
    tree.args(["tree", "--locked", "--edges", "normal", "--prefix", "none"])
        .args(["--format", "{p}|{l}"]);
    for package in packages {
        tree.args(["--package", package]);
    }
    if let Some(triple) = triple {
        tree.args(["--target", triple]);
    }
    let tree = output(&mut tree)?;
    let libraries = libraries(&String::from_utf8_lossy(&tree));
    let metadata = output(cargo().args(["metadata", "--locked", "--format-version", "1"]))?;
    let metadata = String::from_utf8_lossy(&metadata);
    let folders: BTreeMap<String, PathBuf> = target::paths(&metadata, "manifest_path")
        .filter_map(|manifest| {
            let folder = manifest.parent()?;
            let name = folder.file_name()?.to_string_lossy().into_owned();
            Some((name, folder.to_owned()))
        })
        .collect();
    let mut of_notice: BTreeMap<String, Vec<&Library>> = BTreeMap::new();
    for library in &libraries {
        let name = format!("{}-{}", library.name, library.version);
        let folder = folders
            .get(&name)
            .ok_or_else(|| Failure::new(format!("`cargo metadata` does not know {name}")))?;
        for notice in read(folder)? {
            of_notice.entry(notice).or_default().push(library);
        }
    }
    Ok(page(&libraries, &of_notice))
}

/// The libraries in the output of `cargo tree`; packages of the workspace have a path.
fn libraries(tree: &str) -> BTreeSet<Library> {
    tree.lines()
        .filter_map(|line| {
            let (package, licence) = line.split_once('|')?;
            let (name, rest) = package.split_once(" v")?;
            // A path follows the version, or "(proc-macro)".
            if rest.contains('/') {
                return None;
            }
            Some(Library {
                name: name.to_owned(),
                version: rest.split(' ').next().unwrap_or_default().to_owned(),
                licence: licence.trim_end_matches(" (*)").to_owned(),
            })
        })
        .collect()
}

/// The files of a package that hold licences and notices.
fn read(folder: &Path) -> Result<Vec<String>, Failure> {
    const STARTS: [&str; 6] = [
        "LICENSE",
        "LICENCE",
        "COPYING",
        "COPYRIGHT",
        "NOTICE",
        "UNLICENSE",
    ];
    let failed = |error| Failure::new(format!("can't read {}: {error}", folder.display()));
    let mut files = Vec::new();
    for entry in fs::read_dir(folder).map_err(failed)? {
        let path = entry.map_err(failed)?.path();
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        let name = name.to_uppercase();
        if path.is_file() && STARTS.iter().any(|start| name.starts_with(start)) {
            files.push(path);
        }
    }
    files.sort();
    files
        .iter()
        .map(|file| {
            let text = fs::read(file).map_err(failed)?;
            Ok(String::from_utf8_lossy(&text).trim().to_owned())
        })
        .collect()
}

fn page(libraries: &BTreeSet<Library>, of_notice: &BTreeMap<String, Vec<&Library>>) -> String {
    let mut text =
        "Libraries that are compiled into the programs of Singletrack, and their licences\n\n"
            .to_owned();
    for Library {
        name,
        version,
        licence,
    } in libraries
    {
        let _ = writeln!(text, "{name} {version}: {licence}");
    }
    for (notice, of) in of_notice {
        let names: Vec<String> = of
            .iter()
            .map(|library| format!("{} {}", library.name, library.version))
            .collect();
        let _ = write!(text, "\n\n==== {}\n\n{notice}\n", names.join(", "));
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
        let found: Vec<String> = libraries(tree)
            .into_iter()
            .map(|one| format!("{} {} {}", one.name, one.version, one.licence))
            .collect();
        assert_eq!(
            found,
            ["serde_derive 1.0.1 MIT", "zstd 0.14.3 BSD-3-Clause"]
        );
    }

    #[test]
    fn a_notice_is_printed_once_for_all_its_libraries() {
        let of = |name: &str| Library {
            name: name.to_owned(),
            version: "1.0.0".to_owned(),
            licence: "MIT".to_owned(),
        };
        let (one, two) = (of("one"), of("two"));
        let notices = BTreeMap::from([("Copyright me".to_owned(), vec![&one, &two])]);
        let text = page(&BTreeSet::from([one.clone(), two.clone()]), &notices);
        assert!(text.contains("two 1.0.0: MIT\n"), "{text}");
        assert!(
            text.ends_with("==== one 1.0.0, two 1.0.0\n\nCopyright me\n"),
            "{text}"
        );
    }
}
