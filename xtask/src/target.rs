//! The workspace's target folder.

use std::{
    fs, io,
    path::{Path, PathBuf},
};

use crate::{
    process::{At as _, Result, check, command, failure, silent, text},
    workspace::{cargo, root},
};

/// The target folder, with environment and configuration applied.
pub(crate) fn folder() -> Result<PathBuf> {
    let metadata = text(&mut cargo("metadata --no-deps --format-version 1"))?;
    let found = paths(&metadata, "target_directory").into_iter().next();
    found.ok_or_else(|| failure!("`cargo metadata` does not report the target folder"))
}

/// Rebuilds the workspace's programs if the target folder came from another
/// checkout: tests contain paths of the checkout that compiled them, and cargo
/// considers a copied or moved build fresh.
pub(crate) fn adopt() -> Result {
    let folder = folder()?;
    let note = folder.join("checkout.txt");
    let here = root().display().to_string();
    if fs::read_to_string(&note).is_ok_and(|from| from != here) {
        println!("The target folder came from another checkout: building the workspace again");
        for profile in ["dev", "release"] {
            check(cargo("clean --workspace --profile").arg(profile))?;
        }
    }
    fs::create_dir_all(&folder).at(&folder)?;
    fs::write(&note, here).at(&note)
}

/// The paths of this name in cargo's JSON.
pub(crate) fn paths(metadata: &str, name: &str) -> Vec<PathBuf> {
    metadata
        .split(&format!("\"{name}\":\""))
        .skip(1)
        .filter_map(path_up_to_quote)
        .collect()
}

fn path_up_to_quote(rest: &str) -> Option<PathBuf> {
    let mut text = String::new();
    let mut characters = rest.chars();
    loop {
        text.push(match characters.next()? {
            '"' => return Some(text.into()),
            // Control characters in paths are not supported.
            '\\' => characters
                .next()
                .filter(|escaped| r#""\/"#.contains(*escaped))?,
            character => character,
        });
    }
}

/// Creates or empties a folder in the target folder.
pub(crate) fn emptied(name: &str) -> Result<PathBuf> {
    let folder = folder()?.join(name);
    match fs::remove_dir_all(&folder) {
        Err(error) if error.kind() != io::ErrorKind::NotFound => Err(error),
        _ => fs::create_dir_all(&folder),
    }
    .at(&folder)?;
    Ok(folder)
}

/// Copies what a folder contains into another.
pub(crate) fn copy(from: &Path, to: &Path) -> Result {
    check(command("cp --recursive --no-target-directory").args([from, to]))
}

/// Packs the contents of a folder into an archive.
pub(crate) fn pack(folder: &Path, archive: &Path) -> Result {
    let mut tar = command("tar --create --sort=name --gzip --file");
    silent(
        tar.arg(archive)
            .arg("--directory")
            .args([folder, Path::new(".")]),
    )
}

/// Copies a program atomically to its place, unless it is already there.
pub(crate) fn put(from: &Path, to: &Path) -> Result {
    let new = fs::read(from).at(from)?;
    if fs::read(to).is_ok_and(|old| old == new) {
        return Ok(());
    }
    if let Some(folder) = to.parent() {
        fs::create_dir_all(folder).at(folder)?;
    }
    let temporary = to.with_added_extension(format!("{}.part", std::process::id()));
    // Copies the permissions too, for programs.
    fs::copy(from, &temporary).at(&temporary)?;
    fs::rename(&temporary, to).at(to)
}

#[cfg(test)]
mod tests {
    use super::*;

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
