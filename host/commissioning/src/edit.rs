//! Changes of the configuration's file: values are replaced, everything else stays.
//!
//! A file is replaced as a whole: after a crash it is the old one or the new one, and the old
//! one is kept beside it.

use core::fmt;
use std::{
    fs::{self, File, Metadata},
    io::{self, Write as _},
    os::unix::fs::{MetadataExt as _, fchown},
    path::{Path, PathBuf},
};

use similar::TextDiff;
use singletrack_core::Config;
use singletrack_record::put_in_place;
use toml_edit::{DocumentMut, Item, Table, TableLike, TomlError, Value};

/// Why a file was not changed: which, and what is wrong with it, with a key or with new values.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub struct EditError(String);

impl EditError {
    /// What is wrong with a file.
    pub fn of<W: fmt::Display>(path: &Path) -> impl Fn(W) -> Self + Copy {
        move |why| Self(format!("{}: {why}", path.display()))
    }
}

/// The text of a configuration, with its comments.
#[derive(Clone, Debug)]
pub struct Edit {
    old: String,
    new: String,
}

impl Edit {
    /// For a text.
    ///
    /// # Errors
    ///
    /// It is not valid TOML.
    pub fn new(text: &str) -> Result<Self, EditError> {
        parsed(text)?;
        Ok(Self {
            old: text.to_owned(),
            new: text.to_owned(),
        })
    }

    /// For a file.
    ///
    /// # Errors
    ///
    /// It can't be read, or is not valid TOML.
    pub fn read(path: &Path) -> Result<Self, EditError> {
        let text = fs::read_to_string(path).map_err(EditError::of(path))?;
        Self::new(&text)
    }

    /// Gives a key such as `board.servo.centre_us` a value. A key that is commented out, as in
    /// the example file (`#key = value`), is given its value in that place.
    ///
    /// # Errors
    ///
    /// The key names a table, or one of its tables is a value.
    pub fn set(&mut self, key: &str, value: &Value) -> Result<(), EditError> {
        let refused = || EditError(format!("{key} can't be set in this file"));
        let mut document = parsed(&self.new)?;
        let (tables, name) = key.rsplit_once('.').unwrap_or(("", key));
        if find(&document, key).is_none()
            && let Some(text) = uncommented(&self.new, tables, name, value)
            && is_set(&text, key, value)
        {
            self.new = text;
            return Ok(());
        }
        let mut table: &mut dyn TableLike = document.as_table_mut();
        for part in tables.split('.').filter(|part| !part.is_empty()) {
            let item = table.entry(part).or_insert_with(|| {
                let mut table = Table::new();
                table.set_implicit(true);
                Item::Table(table)
            });
            table = item.as_table_like_mut().ok_or_else(refused)?;
        }
        match table.get_mut(name) {
            None => {
                table.insert(name, Item::Value(value.clone()));
            }
            Some(Item::Value(old)) => {
                let decor = old.decor().clone();
                *old = value.clone();
                *old.decor_mut() = decor;
            }
            Some(_) => return Err(refused()),
        }
        self.new = document.to_string();
        Ok(())
    }

    /// Whether a value has changed.
    pub fn is_changed(&self) -> bool {
        self.old != self.new
    }

    /// The text with the new values.
    pub fn text(&self) -> &str {
        &self.new
    }

    /// Whether a key is written with this value.
    pub fn has(&self, key: &str, value: &Value) -> bool {
        is_set(&self.new, key, value)
    }

    /// The change from the old text of this one to the new text of a later one.
    pub fn until(&self, later: &Self) -> Self {
        Self {
            old: self.old.clone(),
            new: later.new.clone(),
        }
    }

    /// Gives a file that was just written its old text again.
    ///
    /// # Errors
    ///
    /// It can't be written.
    pub fn take_back(&self, path: &Path) -> Result<(), EditError> {
        let (path, staged) = places(path)?;
        stage(&path, &staged, &self.old)?;
        put_in_place(&staged, &path).map_err(EditError::of(&path))
    }

    /// Writes the text beside the file and removes it, as the first half of [`Self::write`].
    ///
    /// # Errors
    ///
    /// It can't be written.
    pub fn rehearse(&self, path: &Path) -> Result<(), EditError> {
        let (path, staged) = places(path)?;
        let result = stage(&path, &staged, &self.new);
        let _ = fs::remove_file(&staged);
        result
    }

    /// What has changed, as a unified diff; empty if nothing has.
    pub fn diff(&self, name: &str) -> String {
        TextDiff::from_lines(&*self.old, &*self.new)
            .unified_diff()
            .header(&format!("{name} (old)"), &format!("{name} (new)"))
            .to_string()
    }

    /// Replaces the file, after a check that it is a valid configuration, and gives the path of the
    /// old file, which is kept as `FILE.old-DATE`. A file that did not change is not written.
    ///
    /// # Errors
    ///
    /// It can't be written, or the new text is not a valid configuration; the file then stays as it
    /// was.
    pub fn write(&self, path: &Path, date: &str) -> Result<Option<PathBuf>, EditError> {
        if !self.is_changed() {
            return Ok(None);
        }
        let (path, staged) = places(path)?;
        let kept = kept_name(&path, date);
        let result = stage(&path, &staged, &self.new)
            .and_then(|()| {
                // In the file's folder: its relative paths start there.
                let read = Config::read(&staged).map(drop);
                read.map_err(|error| EditError(format!("the new values do not fit: {error}")))
            })
            .and_then(|()| keep(&path, &kept))
            .and_then(|()| put_in_place(&staged, &path).map_err(EditError::of(&path)));
        if result.is_err() {
            let _ = fs::remove_file(&staged);
        }
        result.map(|()| Some(kept))
    }
}

/// The file itself, so that a link stays a link, and where its new text is written.
fn places(path: &Path) -> Result<(PathBuf, PathBuf), EditError> {
    let path = fs::canonicalize(path).map_err(EditError::of(path))?;
    let staged = path.with_added_extension("new");
    Ok((path, staged))
}

/// Writes the new text beside the file, with its owner and permissions, down to the disk.
fn stage(path: &Path, staged: &Path, text: &str) -> Result<(), EditError> {
    let failed = EditError::of(staged);
    let mut file = File::create(staged).map_err(failed)?;
    file.write_all(text.as_bytes()).map_err(failed)?;
    let old = fs::metadata(path).map_err(failed)?;
    keep_owner(&file, &old).map_err(failed)?;
    file.set_permissions(old.permissions()).map_err(failed)?;
    file.sync_all().map_err(failed)
}

/// Gives a new file the owner and the group of the old one. Only root may give away a file: in
/// another's name the group is enough, if others may read it.
fn keep_owner(file: &File, old: &Metadata) -> io::Result<()> {
    const READABLE_BY_OTHERS: u32 = 0o004;
    let new = file.metadata()?;
    if new.gid() != old.gid()
        && let Err(error) = fchown(file, None, Some(old.gid()))
        && old.mode() & READABLE_BY_OTHERS == 0
    {
        // The daemon could not read it any more.
        let why = format!("its group {} can't be kept: {error}", old.gid());
        return Err(io::Error::new(error.kind(), why));
    }
    if new.uid() != old.uid() {
        let _ = fchown(file, Some(old.uid()), None);
    }
    Ok(())
}

/// Copies the file, down to the disk.
fn keep(path: &Path, kept: &Path) -> Result<(), EditError> {
    let failed = EditError::of(kept);
    fs::copy(path, kept).map_err(failed)?;
    File::open(kept)
        .and_then(|file| file.sync_all())
        .map_err(failed)
}

/// An unused name for the old file.
fn kept_name(path: &Path, date: &str) -> PathBuf {
    let mut name = path.with_added_extension(format!("old-{date}"));
    let mut number = 2;
    while name.exists() {
        name = path.with_added_extension(format!("old-{date}-{number}"));
        number += 1;
    }
    name
}

fn parsed(text: &str) -> Result<DocumentMut, EditError> {
    text.parse()
        .map_err(|error: TomlError| EditError(format!("not valid TOML: {error}")))
}

/// The value of a key; none if it is not written.
fn find<'a>(document: &'a DocumentMut, key: &str) -> Option<&'a Item> {
    key.split('.')
        .try_fold(document.as_item(), |item, part| item.get(part))
}

/// Whether the text is valid and gives the key this value.
fn is_set(text: &str, key: &str, value: &Value) -> bool {
    text.parse::<DocumentMut>().is_ok_and(|document| {
        find(&document, key)
            .and_then(Item::as_value)
            .is_some_and(|found| same(found, value))
    })
}

/// Whether two values are equal; spaces and comments do not count.
pub(crate) fn same(left: &Value, right: &Value) -> bool {
    match (left, right) {
        (Value::Array(left), Value::Array(right)) => {
            let mut pairs = left.iter().zip(right.iter());
            left.len() == right.len() && pairs.all(|(left, right)| same(left, right))
        }
        (Value::String(left), Value::String(right)) => left.value() == right.value(),
        (Value::Boolean(left), Value::Boolean(right)) => left.value() == right.value(),
        _ => {
            let number = |value: &Value| {
                let integer = value.as_integer().map(|integer| integer as f64);
                value.as_float().or(integer)
            };
            let numbers = number(left).zip(number(right));
            numbers.is_some_and(|(left, right)| left.total_cmp(&right).is_eq())
        }
    }
}

/// The text with a commented-out key of a table given a value; none if there is no such line.
fn uncommented(text: &str, table: &str, name: &str, value: &Value) -> Option<String> {
    let header = format!("[{table}]");
    let mut lines: Vec<&str> = text.split_inclusive('\n').collect();
    let is_header = |line: &&str| line.split('#').next().unwrap_or("").trim() == header;
    let begin = match table {
        "" => 0,
        _ => 1 + lines.iter().position(is_header)?,
    };
    let of_table = lines[begin..]
        .iter()
        .take_while(|line| !line.starts_with('['));
    let mut of_table = of_table.map(|line| line.strip_prefix('#').unwrap_or("").trim_start());
    let is_meant = |line: &str| {
        let rest = line.strip_prefix(name);
        rest.is_some_and(|rest| rest.trim_start().starts_with('='))
    };
    let index = begin + of_table.position(is_meant)?;
    let mut value = value.clone();
    value.decor_mut().clear();
    let line = format!("{name} = {value}\n");
    lines[index] = &line;
    Some(lines.concat())
}

#[cfg(test)]
mod tests {
    use super::*;

    const EXAMPLE: &str = include_str!("../../daemon/singletrackd.example.toml");

    fn changed(text: &str, key: &str, value: impl Into<Value>) -> String {
        let mut edit = Edit::new(text).unwrap();
        edit.set(key, &value.into()).unwrap();
        edit.text().to_owned()
    }

    #[test]
    fn a_value_is_replaced_and_its_comments_stay() {
        let text =
            "# The car.\n[board.servo] # steering\ncentre_us = 1500 # by eye\nmin_us = 1080\n";
        assert_eq!(
            changed(text, "board.servo.centre_us", 1512),
            text.replace("1500", "1512")
        );
    }

    #[test]
    fn every_key_that_is_commented_out_in_the_example_is_set_in_its_place() {
        for (key, value, before, after) in [
            (
                "board.imu.left",
                Value::from("-x"),
                "#left = \"+y\"\n",
                "left = \"-x\"\n",
            ),
            (
                "motion_capture.marker_yaw_rad",
                Value::from(-0.02),
                "#marker_yaw_rad = 0.0\n",
                "marker_yaw_rad = -0.02\n",
            ),
            (
                "motion_capture.pose.height_m",
                Value::from_iter([0.06, 0.14]),
                "# height_m = [0.05, 0.25]\n",
                "height_m = [0.06, 0.14]\n",
            ),
        ] {
            assert_eq!(
                changed(EXAMPLE, key, value),
                EXAMPLE.replacen(before, after, 1),
                "{key}"
            );
        }
    }

    #[test]
    fn a_key_without_a_line_of_its_own_is_added_to_its_table() {
        assert_eq!(
            changed(
                "[board.esc]\nneutral_us = 1500\n\n[board]\ncar_id = 3\n",
                "board.esc.kind",
                "car"
            ),
            "[board.esc]\nneutral_us = 1500\nkind = \"car\"\n\n[board]\ncar_id = 3\n"
        );
        assert_eq!(
            changed("[fence]\nbraking_m_s2 = 0.9\n", "board.imu.up", "-z"),
            "[fence]\nbraking_m_s2 = 0.9\n\n[board.imu]\nup = \"-z\"\n"
        );
        // The commented-out key of another table is not meant.
        assert_eq!(
            changed("[a]\n#x = 1\n[b]\ny = 2\n", "b.x", 3),
            "[a]\n#x = 1\n[b]\ny = 2\nx = 3\n"
        );
    }

    #[test]
    fn a_table_is_no_value() {
        let mut edit = Edit::new("[board.servo]\ncentre_us = 1500\n").unwrap();
        assert!(edit.set("board.servo", &1.into()).is_err());
        assert!(edit.set("board.servo.centre_us.x", &1.into()).is_err());
        assert!(!edit.is_changed());
        assert!(Edit::new("[board").is_err());
    }

    #[test]
    fn the_file_is_replaced_and_the_old_one_kept() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("car.toml");
        fs::write(&path, EXAMPLE).unwrap();
        for (value, kept) in [
            (1512, "car.toml.old-2026-01-02"),
            (1513, "car.toml.old-2026-01-02-2"),
        ] {
            let before = fs::read_to_string(&path).unwrap();
            let mut edit = Edit::read(&path).unwrap();
            edit.set("board.servo.centre_us", &value.into()).unwrap();
            let old = edit.write(&path, "2026-01-02").unwrap().unwrap();
            assert_eq!(old.file_name().unwrap(), kept);
            assert_eq!(fs::read_to_string(&old).unwrap(), before);
            assert_eq!(fs::read_to_string(&path).unwrap(), edit.text());
        }
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 3);
    }

    #[test]
    fn a_value_that_makes_no_configuration_leaves_the_file_as_it_is() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("car.toml");
        fs::write(&path, EXAMPLE).unwrap();
        let mut edit = Edit::read(&path).unwrap();
        edit.set("board.servo.centre_us", &9_999.into()).unwrap();
        let error = edit.write(&path, "2026-01-02").unwrap_err().to_string();
        assert!(error.contains("centre_us"), "{error}");
        assert_eq!(fs::read_to_string(&path).unwrap(), EXAMPLE);
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
    }

    #[test]
    fn a_file_that_does_not_change_is_not_written() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("car.toml");
        fs::write(&path, EXAMPLE).unwrap();
        let mut edit = Edit::read(&path).unwrap();
        edit.set("board.servo.centre_us", &1500.into()).unwrap();
        assert_eq!(edit.write(&path, "2026-01-02").unwrap(), None);
        assert_eq!(edit.diff("car.toml"), "");
    }

    #[test]
    fn a_file_keeps_its_permissions_and_its_group() {
        use std::os::unix::fs::PermissionsExt as _;

        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("car.toml");
        fs::write(&path, EXAMPLE).unwrap();
        fs::set_permissions(&path, fs::Permissions::from_mode(0o640)).unwrap();
        // Another group, where the user may choose one.
        let _ = std::os::unix::fs::chown(&path, None, Some(12));
        let before = fs::metadata(&path).unwrap();
        let mut edit = Edit::read(&path).unwrap();
        edit.set("board.servo.centre_us", &1512.into()).unwrap();
        edit.write(&path, "2026-01-02").unwrap();
        let after = fs::metadata(&path).unwrap();
        assert_eq!(
            (after.mode(), after.uid(), after.gid()),
            (before.mode(), before.uid(), before.gid())
        );
    }

    #[test]
    fn a_rehearsal_leaves_nothing_and_says_where_nothing_can_be_written() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("car.toml");
        fs::write(&path, EXAMPLE).unwrap();
        let edit = Edit::read(&path).unwrap();
        edit.rehearse(&path).unwrap();
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
        // A folder is in the way of the new file; root may write everywhere else.
        fs::create_dir(folder.path().join("car.toml.new")).unwrap();
        let error = edit.rehearse(&path).unwrap_err().to_string();
        assert!(error.contains("car.toml.new"), "{error}");
        assert_eq!(fs::read_to_string(&path).unwrap(), EXAMPLE);
    }
}
