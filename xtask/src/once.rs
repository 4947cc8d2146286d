//! Each crate is compiled once, and clippy and rustdoc look at it with the arguments of the compiler.
//!
//! `cargo clippy` and `cargo doc` would each read all dependencies again, and then every crate of the
//! workspace. Here cargo calls a copy of this program in place of the compiler, which compiles a crate,
//! lints it and, unless it is a test, documents it. Cargo takes a crate as compiled only if all succeed.
//! Clippy reads a library once, together with its unit tests; the compiler's own warnings are errors of
//! the compiler.
//!
//! What is tested is the compiler's own output: clippy's driver does not optimise as the compiler does.
//!
//! Tests are not optimised where that takes longer than they run: the unit tests of a library compile
//! all of it again. Nor are programs: what computes is in their libraries. Without optimisation both
//! drivers generate the same code, and clippy's compiles and lints such a crate in one go.

use std::{
    env, fs,
    hash::{DefaultHasher, Hash, Hasher},
    path::{Path, PathBuf},
    process::{Command, ExitCode},
};

use crate::{
    options,
    process::{At as _, Result, failure, text},
    target,
    workspace::root,
};

/// The name of the copy of this program.
const COMPILER: &str = "compile-lint-document";

/// Lets cargo call the copy for the crates of the workspace. Its folder is named by what its verdict
/// depends on, such as the version of clippy: cargo compiles a crate again if the path of its compiler
/// differs, and rustdoc can't read what another version has written.
pub(crate) fn wrap(cargo: &mut Command, clippy: &Path) -> Result {
    // Each of clippy's arguments ends with a separator. Its warnings contain those of the compiler. The
    // variable is part of what a crate depends on that clippy's driver has compiled, so that cargo has
    // it as well.
    let arguments = "-D__CLIPPY_HACKERY__warnings__CLIPPY_HACKERY__";
    let settings = root().join("clippy.toml");
    let settings = fs::read(&settings).at(&settings)?;
    let mut hasher = DefaultHasher::new();
    (include_str!("once.rs"), settings).hash(&mut hasher);
    text(Command::new(clippy).arg("--version"))?.hash(&mut hasher);
    let folder = target::folder()?.join(format!("once/{:016x}", hasher.finish()));
    let copy = folder.join(COMPILER);
    // One that is there does the same, and may be running.
    if !copy.is_file() {
        // The file that this program was started from may be another by now: cargo builds it, too.
        target::put(Path::new("/proc/self/exe"), &copy)?;
    }
    cargo.env("RUSTC_WORKSPACE_WRAPPER", copy);
    cargo.env("CLIPPY_ARGS", arguments);
    Ok(())
}

/// Acts in place of the compiler, if this program is called by that name.
pub(crate) fn called(mut arguments: impl Iterator<Item = String>) -> Option<ExitCode> {
    let name = PathBuf::from(arguments.next()?);
    if name.file_name()? != COMPILER {
        return None;
    }
    let results = name.with_file_name("results");
    let arguments: Vec<_> = arguments.collect();
    let succeeds = compile(&arguments, &results).unwrap_or_else(|failure| {
        eprintln!("error: {failure}");
        false
    });
    Some(ExitCode::from(u8::from(!succeeds)))
}

/// Compiles a crate, lints and documents it, up to the first that fails.
fn compile(arguments: &[String], results: &Path) -> Result<bool> {
    let Some((compiler, arguments)) = arguments.split_first() else {
        return Err(failure!("cargo names no compiler"));
    };
    let is_a_crate = arguments.iter().any(|argument| argument.ends_with(".rs"));
    let package = env::var("CARGO_PKG_NAME").unwrap_or_default();
    let clippy = beside(compiler, "clippy-driver");
    let is_optimised = is_optimised(arguments, &package);
    let mut first = match is_optimised {
        true => Command::new(compiler),
        false => Command::new(&clippy),
    };
    first.args(arguments);
    if !is_optimised {
        first.args(["-C", "opt-level=0"]);
    }
    if !is_a_crate {
        return succeeds(&mut first);
    }
    let look = |program: &Path, options: &[&str]| {
        let mut look = Command::new(program);
        look.args(options).args(kept(arguments));
        succeeds(look.arg("--out-dir").arg(results))
    };
    let warnings = ["-D", "warnings"];
    let is_linted_apart = is_optimised && !(is_library(arguments) && has_unit_tests()?);
    let program = env::var("CARGO_BIN_NAME").ok();
    let is_documented = is_documented(arguments, program.as_deref());
    Ok(succeeds(first.args(warnings))?
        && (!is_linted_apart || look(&clippy, &["--emit=metadata"])?)
        && (!is_documented || look(&beside(compiler, "rustdoc"), &warnings)?))
}

/// Whether a program succeeds, which says itself why it does not.
fn succeeds(program: &mut Command) -> Result<bool> {
    let status = program.status().at(Path::new(program.get_program()))?;
    Ok(status.success())
}

/// The compiler's arguments without those of its output and of the linker.
fn kept(arguments: &[String]) -> Vec<&str> {
    let left_out = ["--out-dir", "-l", "--emit", "--json"];
    let mut kept = options(arguments, &left_out);
    kept.retain(|(argument, _)| !left_out.contains(argument));
    // Without messages about files, of which cargo waits for the compiler's own.
    kept.push(("--json=diagnostic-rendered-ansi", None));
    kept.into_iter().map(|(argument, _)| argument).collect()
}

/// Whether `cargo doc` would document the crate: a library, or a program without a library of its name;
/// no test, with or without a harness of its own, no example, and no build script.
fn is_documented(arguments: &[String], program: Option<&str>) -> bool {
    let Some(program) = program else {
        return is_library(arguments);
    };
    let library = format!("{}=", program.replace('-', "_"));
    let is_left_out = |argument: &String| {
        argument.starts_with(&library)
            || argument.starts_with("examples/")
            || argument.contains("/examples/")
    };
    !is_test(arguments) && !arguments.iter().any(is_left_out)
}

/// Whether a crate keeps the optimisation of its profile: libraries, and tests that compute. A program, an
/// example and a build script call the library, which computes: they are not optimised, but for two that
/// have no library. `cargo bench`, which runs the benchmarks, compiles them in a profile of their own.
fn is_optimised(arguments: &[String], package: &str) -> bool {
    let is_test = is_test(arguments);
    match package {
        "singletrack-benches" => false,
        "singletrack-simavr-process" | "singletrack-uno" => !is_test,
        "singletrack-commissioning" => !is_program(arguments),
        "singletrack-analysis" | "singletrack-control" => {
            !(is_program(arguments) || is_test && has_library_root(arguments))
        }
        _ => !(is_test || is_program(arguments)),
    }
}

/// Whether a crate is a program; a test is none.
fn is_program(arguments: &[String]) -> bool {
    let mut pairs = arguments.windows(2);
    pairs.any(|pair| pair[0] == "--crate-type" && pair[1] == "bin")
}

fn is_test(arguments: &[String]) -> bool {
    arguments.iter().any(|argument| argument == "--test")
}

fn has_library_root(arguments: &[String]) -> bool {
    let mut arguments = arguments.iter();
    arguments.any(|argument| argument.ends_with("src/lib.rs"))
}

/// Whether a library is compiled without its unit tests.
fn is_library(arguments: &[String]) -> bool {
    has_library_root(arguments) && !is_test(arguments)
}

/// Whether cargo compiles the unit tests of the library of the package, too.
fn has_unit_tests() -> Result<bool> {
    let folder = env::var_os("CARGO_MANIFEST_DIR").unwrap_or_default();
    let manifest = Path::new(&folder).join("Cargo.toml");
    Ok(tests_library(&fs::read_to_string(&manifest).at(&manifest)?))
}

fn tests_library(manifest: &str) -> bool {
    let (_, library) = manifest.split_once("\n[lib]").unwrap_or_default();
    let library = library.split("\n[").next().unwrap_or_default();
    !library.lines().any(|line| line == "test = false")
}

/// A program that comes with the compiler: beside it, or on the search path.
fn beside(compiler: &str, program: &str) -> PathBuf {
    let path = Path::new(compiler).with_file_name(program);
    if path.is_file() { path } else { program.into() }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn words(line: &str) -> Vec<String> {
        line.split_whitespace().map(str::to_owned).collect()
    }

    #[test]
    fn clippy_and_rustdoc_get_the_arguments_of_the_compiler_and_write_elsewhere() {
        let compiler = words(
            "--crate-name a --edition=2024 src/lib.rs --error-format=json \
             --json=artifacts,diagnostic-rendered-ansi --emit=dep-info,metadata,link \
             -C opt-level=1 --out-dir /t/debug/deps --extern b=/t/libb.rmeta -l static=c",
        );
        let others = words(
            "--crate-name a --edition=2024 src/lib.rs --error-format=json -C opt-level=1 \
             --extern b=/t/libb.rmeta --json=diagnostic-rendered-ansi",
        );
        assert_eq!(kept(&compiler), others);
        let documented = |line: &str, program| is_documented(&words(line), program);
        assert!(is_documented(&compiler, None));
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
        let optimised = |line: &str, package: &str| is_optimised(&words(line), package);
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
        assert!(optimised(program, "singletrack-simavr-process"));
        assert!(optimised(program, "singletrack-uno"));
    }

    #[test]
    fn clippy_reads_a_library_with_its_unit_tests_if_it_has_some() {
        assert!(is_library(&words("--crate-name a core/src/lib.rs")));
        assert!(!is_library(&words("--crate-name a core/src/lib.rs --test")));
        assert!(tests_library(
            "[package]\nname = \"a\"\n\n[[test]]\ntest = false\n"
        ));
        assert!(tests_library(
            "[package]\n\n[lib]\nname = \"a\"\n\n[[test]]\ntest = false\n"
        ));
        assert!(!tests_library(
            "[package]\n\n[lib]\ntest = false\n\n[features]\n"
        ));
    }

    #[test]
    fn this_program_acts_for_the_compiler_only_by_that_name() {
        let called = |line: &str| called(words(line).into_iter());
        assert!(called("/t/debug/xtask verify").is_none());
        assert!(called(&format!("/t/once/{COMPILER} /no/such/rustc -vV")).is_some());
    }
}
