//! The workspace's root, and its cargo.

use std::{
    env,
    path::{Path, PathBuf},
    process::Command,
    sync::OnceLock,
};

use crate::process::{Result, failure};

/// The workspace's root. Requires a previous successful [`find`], which `main`
/// calls first.
pub(crate) fn root() -> &'static Path {
    static ROOT: OnceLock<PathBuf> = OnceLock::new();
    ROOT.get_or_init(|| find().unwrap_or_default())
}

/// Finds the workspace at run time, not at compile time: in a copied or moved
/// checkout, the existing programs must build the copy.
pub(crate) fn find() -> Result<PathBuf> {
    // Set by cargo for the program that it runs.
    let manifest = env::var_os("CARGO_MANIFEST_DIR").map(PathBuf::from);
    let here = env::current_dir().ok();
    let starts = manifest.iter().chain(&here);
    let mut folders = starts.flat_map(|start| start.ancestors());
    let root = folders.find(|folder| is_root(folder));
    root.map(Path::to_path_buf).ok_or_else(|| {
        failure!(
            "not in a checkout of Singletrack: run `cargo verify` and the other commands inside one"
        )
    })
}

fn is_root(folder: &Path) -> bool {
    folder.join("xtask/Cargo.toml").is_file() && folder.join("firmware/uno/Cargo.toml").is_file()
}

/// The cargo that runs this program, in the workspace's root, with arguments without blanks.
pub(crate) fn cargo(arguments: &str) -> Command {
    let mut command = cargo_here();
    command.current_dir(root()).args(arguments.split(' '));
    // Otherwise programs would be in that target's folder, and older ones be found.
    command.env_remove("CARGO_BUILD_TARGET");
    // A fresh clone is built only once, so incremental data is useless.
    if env::var_os("CI").is_some() {
        command.env("CARGO_INCREMENTAL", "0");
    }
    // Cargo resolves a relative path against the current folder, which may not be the root.
    if let Some(Ok(target)) = env::var_os("CARGO_TARGET_DIR").map(std::path::absolute) {
        command.env("CARGO_TARGET_DIR", target);
    }
    command
}

/// Lets cargo change a setting of a profile.
pub(crate) fn configure(cargo: &mut Command, setting: &str) {
    cargo.args(["--config", &format!("profile.{setting}")]);
}

/// A script of this checkout, to be started in the workspace's root.
pub(crate) fn script(path: &str) -> Command {
    let mut script = Command::new(root().join(path));
    script.current_dir(root());
    script
}

/// The cargo that runs this program, in the current folder.
pub(crate) fn cargo_here() -> Command {
    Command::new(env::var_os("CARGO").unwrap_or_else(|| "cargo".into()))
}

#[cfg(test)]
mod tests {
    use std::{collections::BTreeSet, fs};

    use super::*;

    /// The folders below this one that hold a package.
    fn packages(folder: &Path, found: &mut Vec<PathBuf>) {
        for entry in fs::read_dir(folder).unwrap().flatten() {
            let path = entry.path();
            let name = entry.file_name();
            if !path.is_dir() || name == "target" || name.to_string_lossy().starts_with('.') {
                continue;
            }
            if path.join("Cargo.toml").is_file() {
                found.push(path.clone());
            }
            packages(&path, found);
        }
    }

    /// The files of its folder `tests` that a package would compile if cargo looked for them.
    fn test_files(package: &Path) -> BTreeSet<String> {
        let Ok(entries) = fs::read_dir(package.join("tests")) else {
            return BTreeSet::new();
        };
        entries
            .flatten()
            .filter_map(|entry| {
                let path = entry.path();
                let is_test = match path.extension() {
                    Some(extension) => extension == "rs",
                    None => path.join("main.rs").is_file(),
                };
                let name = path.file_stem()?.to_str()?.to_owned();
                (is_test && name != "main").then_some(name)
            })
            .collect()
    }

    #[test]
    fn every_file_of_tests_belongs_to_a_program() {
        let mut found = Vec::new();
        packages(&find().unwrap(), &mut found);
        let mut listed = 0;
        for package in found {
            let manifest = fs::read_to_string(package.join("Cargo.toml")).unwrap();
            if !manifest.contains("autotests = false") {
                continue;
            }
            let main = fs::read_to_string(package.join("tests/main.rs")).unwrap();
            for name in test_files(&package) {
                let is_module = main.lines().any(|line| line == format!("mod {name};"));
                // A bench may have the same name.
                let is_program = manifest
                    .split("[[")
                    .filter(|target| target.starts_with("test]]"))
                    .flat_map(str::lines)
                    .any(|line| line == format!("name = \"{name}\""));
                assert!(
                    is_module || is_program,
                    "{}: tests/{name} is in no test program; add `mod {name};` to tests/main.rs",
                    package.display()
                );
                listed += 1;
            }
        }
        assert!(listed > 80, "{listed}");
    }

    /// Whether a text has an example that rustdoc would compile: of a language, or of none that is named.
    fn has_example(text: &str) -> bool {
        let comments = text.lines().map(str::trim_start);
        let comments = comments.filter_map(|line| {
            line.strip_prefix("///")
                .or_else(|| line.strip_prefix("//!"))
        });
        let fences = comments.filter_map(|line| line.trim().strip_prefix("```"));
        // Each second one ends a block.
        let mut languages = fences.step_by(2);
        languages.any(|language| !["text", "sh", "toml", "console"].contains(&language))
    }

    /// Whether a file below a folder has an example, or takes its documentation from another file.
    fn has_examples(folder: &Path) -> bool {
        fs::read_dir(folder).unwrap().flatten().any(|entry| {
            let path = entry.path();
            if path.is_dir() {
                return has_examples(&path);
            }
            let text = fs::read_to_string(&path).unwrap_or_default();
            path.extension().is_some_and(|ending| ending == "rs")
                && (has_example(&text) || text.contains("doc = include_str!"))
        })
    }

    #[test]
    fn a_library_s_examples_are_tested_if_it_has_some() {
        assert!(has_example("    /// ```\n    /// let a = 1;\n    /// ```"));
        assert!(has_example("//! ```should_panic\n//! ```"));
        assert!(!has_example(
            "//! ```text\n//! a\n//! ```\nlet a = \"```\";"
        ));
        let mut found = Vec::new();
        packages(&find().unwrap(), &mut found);
        found.retain(|package| package.join("src/lib.rs").is_file());
        for package in &found {
            let manifest = fs::read_to_string(package.join("Cargo.toml")).unwrap();
            if manifest.contains("\n[workspace]") {
                continue;
            }
            let is_tested = !manifest.lines().any(|line| line == "doctest = false");
            assert_eq!(
                is_tested,
                has_examples(&package.join("src")),
                "{}: the line `doctest = false` below [lib] of Cargo.toml belongs to a library \
                 without examples in its documentation, and to no other: cargo compiles a library \
                 once more in search of them",
                package.display()
            );
        }
        assert!(found.len() > 25, "{}", found.len());
    }

    #[test]
    fn the_root_holds_this_package() {
        let root = find().unwrap();
        assert!(root.join("xtask/src/workspace.rs").is_file());
    }

    #[test]
    fn a_folder_without_the_image_is_not_the_root() {
        assert!(!is_root(&find().unwrap().join("xtask")));
    }
}
