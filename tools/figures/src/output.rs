//! Results in files and on standard output, and pages with places for their parts.

use std::{
    fs,
    io::{self, Write as _},
    path::{Path, PathBuf},
};

use indicatif::{ProgressBar, ProgressStyle};

/// A file or folder that can't be written.
#[derive(Debug, thiserror::Error)]
#[error("can't write {}: {source}; choose another folder with --out", path.display())]
pub struct WriteError {
    /// The file or folder.
    pub path: PathBuf,
    /// The system's error.
    pub source: io::Error,
}

impl WriteError {
    /// The error of the system about this file or folder.
    pub fn of(path: &Path) -> impl FnOnce(io::Error) -> Self + use<> {
        let path = path.to_owned();
        move |source| Self { path, source }
    }
}

/// Makes a folder, if it is not there.
///
/// # Errors
///
/// When it can't be made.
pub fn make_folder(path: &Path) -> Result<(), WriteError> {
    fs::create_dir_all(path).map_err(WriteError::of(path))
}

/// Writes a file.
///
/// # Errors
///
/// When it can't be written.
pub fn write(path: &Path, text: &str) -> Result<(), WriteError> {
    fs::write(path, text).map_err(WriteError::of(path))
}

/// Writes a file into a folder, which is made if it is not there. Returns its path.
///
/// # Errors
///
/// When it can't be written.
pub fn write_into(folder: &Path, name: &str, text: &str) -> Result<PathBuf, WriteError> {
    make_folder(folder)?;
    let path = folder.join(name);
    write(&path, text)?;
    Ok(path)
}

/// Prints a text as it is. The reader of a pipe may close it at any time.
///
/// # Errors
///
/// When standard output can't be written.
pub fn print(text: &str) -> io::Result<()> {
    let mut out = io::stdout().lock();
    match out.write_all(text.as_bytes()).and_then(|()| out.flush()) {
        Err(error) if error.kind() == io::ErrorKind::BrokenPipe => Ok(()),
        result => result,
    }
}

/// A progress bar on standard error, in the form of `template`; hidden when that is no terminal.
pub fn progress_bar(length: u64, template: &str) -> ProgressBar {
    let bar = ProgressBar::new(length);
    match ProgressStyle::with_template(template) {
        Ok(style) => bar.with_style(style),
        Err(_) => bar,
    }
}

/// Puts each part in the place of its name in braces. What is in a part is not looked
/// at again, and braces around no name stay.
pub fn fill(template: &str, parts: &[(&str, impl AsRef<str>)]) -> String {
    let mut page = String::with_capacity(template.len());
    let mut rest = template;
    while let Some((before, after)) = rest.split_once('{') {
        page.push_str(before);
        let part = after.split_once('}').and_then(|(name, after)| {
            let part = parts.iter().find(|(known, _)| *known == name);
            part.map(|(_, part)| (part.as_ref(), after))
        });
        let (part, after) = part.unwrap_or(("{", after));
        page.push_str(part);
        rest = after;
    }
    page + rest
}
