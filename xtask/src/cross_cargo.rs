//! Cargo with the compiler for another processor.

use std::{env, path::Path, process::Command};

use crate::{compiler::Compiler, workspace::cargo_here};

/// Cargo in a folder, with nothing in the environment that would make another
/// program: what is tested is what is flashed and installed.
pub(crate) fn cross_cargo(compiler: &Compiler, folder: &Path) -> Command {
    let mut cargo = compiler
        .cargo
        .as_ref()
        .map_or_else(cargo_here, Command::new);
    for (name, _) in env::vars_os() {
        if name.to_str().is_some_and(changes_a_build) {
            cargo.env_remove(name);
        }
    }
    cargo
        .current_dir(folder)
        // Empty: not even the one in the user's configuration.
        .envs([("RUSTC_WRAPPER", ""), ("RUSTC_WORKSPACE_WRAPPER", "")])
        // With its unstable options: building the standard library is one.
        .env("RUSTC", &compiler.rustc)
        .env("RUSTC_BOOTSTRAP", "1");
    cargo
}

/// Whether a variable of this name could make another program.
fn changes_a_build(name: &str) -> bool {
    /// What cargo does besides building.
    const HARMLESS: [&str; 7] = [
        "CARGO_HOME",
        "CARGO_HTTP_",
        "CARGO_NET_",
        "CARGO_REGISTR",
        "CARGO_SOURCE_",
        "CARGO_TERM_",
        "CARGO_BUILD_JOBS",
    ];
    name == "RUSTFLAGS"
        || (name.starts_with("CARGO_") && !HARMLESS.iter().any(|start| name.starts_with(start)))
}

#[cfg(test)]
mod tests {
    use super::changes_a_build;

    #[test]
    fn variables_that_make_another_program_are_told_from_the_others() {
        for name in [
            "RUSTFLAGS",
            "CARGO_ENCODED_RUSTFLAGS",
            "CARGO_BUILD_TARGET",
            "CARGO_PROFILE_RELEASE_OPT_LEVEL",
            "CARGO_TARGET_DIR",
            "CARGO_UNSTABLE_BUILD_STD",
        ] {
            assert!(changes_a_build(name), "{name}");
        }
        for name in [
            "PATH",
            "CARGO",
            "CARGO_HOME",
            "CARGO_NET_OFFLINE",
            "CARGO_REGISTRIES_X_INDEX",
        ] {
            assert!(!changes_a_build(name), "{name}");
        }
    }
}
