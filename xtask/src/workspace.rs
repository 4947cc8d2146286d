//! The workspace's root, its cargo, and its target folder.

use std::{
    env, fs,
    hash::{DefaultHasher, Hash as _, Hasher as _},
    path::{Path, PathBuf},
    process::Command,
    sync::OnceLock,
};

use crate::process::{Result, at, check, command, failure, text};

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
    let starts = [manifest, env::current_dir().ok()];
    let mut folders = starts.iter().flatten().flat_map(|start| start.ancestors());
    let root = folders
        .find(|folder| is_root(folder))
        .map(Path::to_path_buf);
    let elsewhere =
        "not in a checkout of Singletrack: run `cargo verify` and the other commands inside one";
    root.ok_or_else(|| failure!("{elsewhere}"))
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

/// Lets cargo change settings of a profile.
pub(crate) fn configure(cargo: &mut Command, profile: &str, settings: &[&str]) {
    for setting in settings {
        cargo.args(["--config", &format!("profile.{profile}.{setting}")]);
    }
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

/// The target folder, with environment and configuration applied.
pub(crate) fn target() -> Result<PathBuf> {
    let metadata = text(&mut cargo("metadata --no-deps --format-version 1"))?;
    let found = paths(&metadata, "target_directory").into_iter().next();
    found.ok_or_else(|| failure!("`cargo metadata` does not report the target folder"))
}

/// Rebuilds the workspace's programs if the target folder came from another
/// checkout: tests contain paths of the checkout that compiled them, and cargo
/// considers a copied or moved build fresh.
pub(crate) fn adopt() -> Result {
    let folder = target()?;
    let note = folder.join("checkout.txt");
    let here = root().display().to_string();
    if fs::read_to_string(&note).is_ok_and(|from| from != here) {
        println!("The target folder came from another checkout: building the workspace again");
        for profile in ["dev", "release"] {
            check(cargo("clean --workspace --profile").arg(profile))?;
        }
    }
    write(&note, here)
}

/// The paths of this name in cargo's JSON.
pub(crate) fn paths(metadata: &str, name: &str) -> Vec<PathBuf> {
    let key = format!("\"{name}\":\"");
    let values = metadata.split(&key).skip(1);
    values.filter_map(path_up_to_quote).collect()
}

fn path_up_to_quote(rest: &str) -> Option<PathBuf> {
    let mut text = String::new();
    let mut characters = rest.chars();
    loop {
        text.push(match characters.next()? {
            '"' => return Some(text.into()),
            // Control characters in paths are not supported.
            '\\' => characters.next().filter(|it| r#""\/"#.contains(*it))?,
            character => character,
        });
    }
}

/// Creates or empties a folder in the target folder.
pub(crate) fn emptied(name: &str) -> Result<PathBuf> {
    let folder = target()?.join(name);
    if folder.exists() {
        fs::remove_dir_all(&folder).map_err(at(&folder))?;
    }
    fs::create_dir_all(&folder).map_err(at(&folder))?;
    Ok(folder)
}

/// Writes a file, in a folder that need not be there.
pub(crate) fn write(file: &Path, text: impl AsRef<[u8]>) -> Result {
    let folder = file.parent().unwrap_or(file);
    let written = fs::create_dir_all(folder).and_then(|()| fs::write(file, text));
    written.map_err(at(file))
}

/// Copies what a folder contains into another.
pub(crate) fn copy(from: &Path, to: &Path) -> Result {
    check(command("cp --recursive --no-target-directory").args([from, to]))
}

/// Copies a program atomically to its place, unless it is already there.
pub(crate) fn put(from: &Path, to: &Path) -> Result {
    let new = fs::read(from).map_err(at(from))?;
    if fs::read(to).is_ok_and(|old| old == new) {
        return Ok(());
    }
    let folder = to.parent().unwrap_or(to);
    fs::create_dir_all(folder).map_err(at(folder))?;
    let temporary = to.with_added_extension(format!("{}.part", std::process::id()));
    // Copies the permissions too, for programs.
    fs::copy(from, &temporary).map_err(at(&temporary))?;
    fs::rename(&temporary, to).map_err(at(to))
}

/// Lets cargo compile each crate of the workspace once, and clippy and rustdoc look at it with the arguments
/// of the compiler: cargo calls a copy of the script `once.sh` in place of it. `cargo clippy` and `cargo doc`
/// would each read all dependencies again, and then every crate of the workspace.
///
/// The copy's folder is named by what its verdict depends on, such as the version of clippy: cargo compiles
/// a crate again if the path of its compiler differs, and rustdoc can't read what another version has
/// written.
pub(crate) fn lint_and_document(cargo: &mut Command, clippy: &Path) -> Result {
    let script = root().join("xtask/src/once.sh");
    let mut hasher = DefaultHasher::new();
    for file in [&script, &root().join("clippy.toml")] {
        fs::read(file).map_err(at(file))?.hash(&mut hasher);
    }
    text(Command::new(clippy).arg("--version"))?.hash(&mut hasher);
    let name = format!("once/{:016x}/compile-lint-document", hasher.finish());
    let copy = target()?.join(name);
    put(&script, &copy)?;
    cargo.env("RUSTC_WORKSPACE_WRAPPER", copy);
    // Each of clippy's arguments ends with a separator. Its warnings contain those of the compiler. The
    // variable is part of what a crate depends on that clippy's driver has compiled, so that cargo has
    // it as well.
    let arguments = "-D__CLIPPY_HACKERY__warnings__CLIPPY_HACKERY__";
    cargo.env("CLIPPY_ARGS", arguments);
    Ok(())
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

    #[test]
    fn the_target_folder_is_found_in_the_metadata() {
        let metadata = r#"{"packages":[],"target_directory":"/tmp/a \"b\" c","version":1}"#;
        let found = |metadata| paths(metadata, "target_directory");
        assert_eq!(found(metadata), [PathBuf::from("/tmp/a \"b\" c")]);
        assert!(found("{}").is_empty());
        assert!(found(r#"{"target_directory":"/tmp"#).is_empty());
    }

    #[test]
    fn a_file_is_replaced_only_if_it_differs() {
        let folder = std::env::temp_dir().join(format!("xtask-put-{}", std::process::id()));
        fs::create_dir_all(&folder).unwrap();
        let (from, to) = (folder.join("from"), folder.join("new/to"));
        fs::write(&from, "one").unwrap();
        put(&from, &to).unwrap();
        let first = fs::metadata(&to).unwrap().modified().unwrap();
        put(&from, &to).unwrap();
        assert_eq!(fs::metadata(&to).unwrap().modified().unwrap(), first);
        fs::write(&from, "two").unwrap();
        put(&from, &to).unwrap();
        assert_eq!(fs::read(&to).unwrap(), b"two");
        assert_eq!(
            fs::read_dir(folder.join("new")).unwrap().count(),
            1,
            "a temporary file is left"
        );
        fs::remove_dir_all(&folder).unwrap();
    }
}

#[cfg(test)]
mod once_tests {
    use super::*;

    /// A compiler with its clippy and rustdoc, which print their names and arguments, and a package whose
    /// library has unit tests or none.
    struct Compiler(PathBuf);

    impl Compiler {
        fn new(test: &str, manifest: &str) -> Self {
            let name = format!("singletrack-once-{test}-{}", std::process::id());
            let compiler = Self(env::temp_dir().join(name));
            // By another process: a file that is open for writing in this one can't be executed.
            let script = "mkdir -p \"$1\" && cd \"$1\" && printf '%s' \"$2\" >Cargo.toml
                          for name in rustc clippy-driver rustdoc; do
                              printf '#!/bin/sh\necho \"${0##*/} $*\"\ncase $* in *fails*) exit 3; esac' >$name
                              chmod 755 $name
                          done";
            let mut sh = Command::new("/bin/sh");
            let made = sh
                .args(["-ec", script, "sh"])
                .arg(&compiler.0)
                .arg(manifest);
            assert!(made.status().unwrap().success());
            compiler
        }

        /// What is run for such arguments of the compiler, and whether it succeeds.
        fn called(&self, line: &str, package: &str, program: Option<&str>) -> (Vec<String>, bool) {
            let mut once = Command::new(root().join("xtask/src/once.sh"));
            once.arg(self.0.join("rustc")).args(line.split_whitespace());
            once.env("CARGO_MANIFEST_DIR", &self.0);
            once.env("CARGO_PKG_NAME", package);
            once.env_remove("CARGO_BIN_NAME");
            once.envs(program.map(|name| ("CARGO_BIN_NAME", name)));
            let output = once.output().unwrap();
            let text = String::from_utf8(output.stdout).unwrap();
            (
                text.lines().map(str::to_owned).collect(),
                output.status.success(),
            )
        }

        fn runs(&self, line: &str, package: &str, program: Option<&str>) -> Vec<String> {
            let (runs, succeeds) = self.called(line, package, program);
            assert!(succeeds, "{line}");
            runs
        }
    }

    impl Drop for Compiler {
        fn drop(&mut self) {
            let _ = fs::remove_dir_all(&self.0);
        }
    }

    const UNTESTED: &str = "[package]\n\n[lib]\ntest = false\n\n[features]\n";

    #[test]
    fn clippy_and_rustdoc_get_the_arguments_of_the_compiler_and_write_elsewhere() {
        let compiler = Compiler::new("arguments", UNTESTED);
        let line = "--crate-name a --edition=2024 src/lib.rs --error-format=json \
                    --json=artifacts,diagnostic-rendered-ansi --emit=dep-info,metadata,link \
                    -C opt-level=1 --out-dir /t/debug/deps --extern b=/t/libb.rmeta -l static=c";
        let kept = "--crate-name a --edition=2024 src/lib.rs --error-format=json -C opt-level=1 \
                    --extern b=/t/libb.rmeta --json=diagnostic-rendered-ansi";
        let results = root().join("xtask/src/results");
        let results = results.display();
        assert_eq!(
            compiler.runs(line, "a", None),
            [
                format!("rustc {line} -D warnings"),
                format!("clippy-driver --emit=metadata {kept} --out-dir {results}"),
                format!("rustdoc -D warnings {kept} --out-dir {results}"),
            ]
        );
        let documented = |line: &str, program| {
            let runs = compiler.runs(line, "a", program);
            runs.iter().any(|run| run.starts_with("rustdoc "))
        };
        assert!(documented(
            "--crate-name a src/main.rs --extern b=x",
            Some("a")
        ));
        assert!(!documented(
            "--crate-name a_b src/main.rs --extern a_b=x",
            Some("a-b")
        ));
        assert!(!documented("--crate-name a src/lib.rs --test", None));
        assert!(!documented("--crate-name a tests/main.rs", None));
        assert!(!documented(
            "--crate-name build_script_build build.rs",
            None
        ));
        assert!(!documented("--crate-name a b/examples/a.rs", Some("a")));
    }

    #[test]
    fn tests_and_benchmarks_are_optimised_only_if_they_compute() {
        let compiler = Compiler::new("optimised", "");
        let optimised = |line: &str, package: &str| {
            let runs = compiler.runs(line, package, None);
            let is_plain = runs[0].starts_with(&format!("clippy-driver {line} -C opt-level=0"));
            assert!(
                is_plain || runs[0].starts_with(&format!("rustc {line} -D")),
                "{runs:?}"
            );
            !is_plain
        };
        assert!(optimised("core/src/lib.rs", "singletrack-core"));
        assert!(!optimised("core/src/lib.rs --test", "singletrack-core"));
        assert!(!optimised(
            "control/src/lib.rs --test",
            "singletrack-control"
        ));
        assert!(optimised(
            "control/tests/main.rs --test",
            "singletrack-control"
        ));
        assert!(!optimised("benches/benches/dump.rs", "singletrack-benches"));
        let program = "src/main.rs --crate-type bin";
        assert!(!optimised(program, "singletrack-sim"));
        assert!(!optimised(program, "singletrack-control"));
        assert!(!optimised(program, "singletrack-commissioning"));
        assert!(optimised("src/lib.rs --test", "singletrack-commissioning"));
        assert!(optimised(program, "singletrack-simavr-process"));
        assert!(optimised(program, "singletrack-uno"));
    }

    #[test]
    fn clippy_reads_a_library_with_its_unit_tests_if_it_has_some() {
        let linted_apart = |number: usize, line: &str, manifest: &str| {
            let compiler = Compiler::new(&format!("linted{number}"), manifest);
            let runs = compiler.runs(line, "a", None);
            runs.iter().any(|run| run.contains("--emit=metadata"))
        };
        let tested = [
            "[package]\nname = \"a\"\n\n[[test]]\ntest = false\n",
            "[package]\n\n[lib]\nname = \"a\"\n\n[[test]]\ntest = false\n",
        ];
        for (number, manifest) in tested.into_iter().enumerate() {
            assert!(!linted_apart(
                number,
                "--crate-name a core/src/lib.rs",
                manifest
            ));
            // Clippy's own driver compiles them.
            let tests = "--crate-name a core/src/lib.rs --test";
            assert!(!linted_apart(number, tests, manifest));
        }
        assert!(linted_apart(2, "--crate-name a core/src/lib.rs", UNTESTED));
    }

    #[test]
    fn the_first_that_fails_is_the_last_and_what_is_no_crate_is_only_passed_on() {
        let compiler = Compiler::new("fails", UNTESTED);
        let called = |line: &str| compiler.called(line, "a", None);
        let (runs, succeeds) = called("--crate-name fails src/lib.rs");
        assert_eq!((runs.len(), succeeds), (1, false), "{runs:?}");
        assert_eq!(called("-vV"), (vec!["rustc -vV".to_owned()], true));
    }
}
