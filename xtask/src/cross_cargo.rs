//! Cargo with a cross compiler.

use std::{env, path::Path, process::Command};

use crate::{compiler::Compiler, workspace::cargo_here};

/// Cargo in a folder, without environment variables that would change the program:
/// the tested program is the one that is flashed or installed.
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
        // Empty overrides the user's configuration, too.
        .envs([("RUSTC_WRAPPER", ""), ("RUSTC_WORKSPACE_WRAPPER", "")])
        // Enables unstable options, such as building the standard library.
        .env("RUSTC", &compiler.rustc)
        .env("RUSTC_BOOTSTRAP", "1");
    cargo
}

/// Whether an environment variable could change the program.
fn changes_a_build(name: &str) -> bool {
    /// Variables that do not affect the build.
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
    fn variables_that_change_a_build_are_recognised() {
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
