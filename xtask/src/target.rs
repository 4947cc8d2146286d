//! The workspace's target folder, and files put into it.

use std::{
    fs, io,
    path::{Path, PathBuf},
};

use crate::{
    process::{Failure, check, output},
    workspace::{cargo, root},
};

/// Where cargo builds the workspace, whatever environment or configuration say.
pub(crate) fn folder() -> Result<PathBuf, Failure> {
    let metadata = output(cargo().args(["metadata", "--no-deps", "--format-version", "1"]))?;
    target_directory(&String::from_utf8_lossy(&metadata))
        .ok_or_else(|| Failure::new("`cargo metadata` does not tell the target folder".to_owned()))
}

/// Rebuilds the workspace's own programs if the target folder came from another checkout:
/// tests know the paths of the checkout where they were compiled, and cargo takes those of
/// a copied or moved one as fresh.
pub(crate) fn adopt() -> Result<(), Failure> {
    let folder = folder()?;
    let note = folder.join("checkout.txt");
    let here = root().display().to_string();
    if fs::read_to_string(&note).is_ok_and(|from| from != here) {
        println!("The target folder came from another checkout: building the workspace again");
        for profile in ["dev", "release"] {
            check(cargo().args(["clean", "--workspace", "--profile", profile]))?;
        }
    }
    fs::create_dir_all(&folder)
        .and_then(|()| fs::write(&note, here))
        .map_err(|error| Failure::new(format!("cannot write {}: {error}", note.display())))
}

/// The one string in cargo's JSON that is of interest.
fn target_directory(metadata: &str) -> Option<PathBuf> {
    let (_, rest) = metadata.split_once("\"target_directory\":\"")?;
    let mut path = String::new();
    let mut characters = rest.chars();
    loop {
        match characters.next()? {
            '"' => return Some(path.into()),
            '\\' => match characters.next()? {
                escaped @ ('"' | '\\' | '/') => path.push(escaped),
                // A control character in a path: nobody who means it.
                _ => return None,
            },
            character => path.push(character),
        }
    }
}

/// Copies a program to where others run it: whole or not at all, and not when
/// it is there already.
pub(crate) fn put(from: &Path, to: &Path) -> Result<(), Failure> {
    place(from, to).map_err(|error| {
        Failure::new(format!(
            "can't copy {} to {}: {error}",
            from.display(),
            to.display()
        ))
    })
}

fn place(from: &Path, to: &Path) -> io::Result<()> {
    let new = fs::read(from)?;
    if fs::read(to).is_ok_and(|old| old == new) {
        return Ok(());
    }
    if let Some(folder) = to.parent() {
        fs::create_dir_all(folder)?;
    }
    let beside = to.with_added_extension(format!("{}.part", std::process::id()));
    // With the permissions: one of them is a program.
    fs::copy(from, &beside)?;
    fs::rename(&beside, to)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_target_folder_is_found_in_the_metadata() {
        let metadata = r#"{"packages":[],"target_directory":"/tmp/a \"b\" c","version":1}"#;
        assert_eq!(
            target_directory(metadata),
            Some(PathBuf::from("/tmp/a \"b\" c"))
        );
        assert_eq!(target_directory("{}"), None);
        assert_eq!(target_directory(r#"{"target_directory":"/tmp"#), None);
    }

    #[test]
    fn a_file_is_replaced_when_it_differs_and_left_alone_when_not() {
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
            "nothing is left beside it"
        );
        fs::remove_dir_all(&folder).unwrap();
    }
}
