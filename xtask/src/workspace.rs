//! The workspace's root, and its cargo.

use std::{
    env,
    path::{Path, PathBuf},
    process::Command,
    sync::OnceLock,
};

use crate::process::Failure;

/// The workspace's root. Requires a previous successful [`find`], which `main`
/// calls first.
pub(crate) fn root() -> &'static Path {
    static ROOT: OnceLock<PathBuf> = OnceLock::new();
    ROOT.get_or_init(|| find().unwrap_or_default())
}

/// Finds the workspace at run time, not at compile time: in a copied or moved
/// checkout, the existing programs must build the copy.
pub(crate) fn find() -> Result<PathBuf, Failure> {
    // Set by cargo for the program that it runs.
    let manifest = env::var_os("CARGO_MANIFEST_DIR").map(PathBuf::from);
    let here = env::current_dir().ok();
    manifest
        .iter()
        .chain(&here)
        .flat_map(|start| start.ancestors())
        .find(|folder| is_root(folder))
        .map(Path::to_path_buf)
        .ok_or_else(|| {
            Failure::new(
                "not in a checkout of Singletrack: run `cargo verify` and the other commands inside one"
                    .to_owned(),
            )
        })
}

fn is_root(folder: &Path) -> bool {
    folder.join("xtask/Cargo.toml").is_file() && folder.join("firmware/uno/Cargo.toml").is_file()
}

/// The cargo that runs this program, in the workspace's root.
pub(crate) fn cargo() -> Command {
    let mut command = cargo_here();
    command.current_dir(root());
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

/// The cargo that runs this program, in the current folder.
pub(crate) fn cargo_here() -> Command {
    Command::new(env::var_os("CARGO").unwrap_or_else(|| "cargo".into()))
}

#[cfg(test)]
mod tests {
    use super::*;

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
