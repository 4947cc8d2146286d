//! Text files written by a person: read whole, and refused if they are not regular files.

use std::{
    fs::OpenOptions,
    io::{self, Read as _},
    os::unix::fs::OpenOptionsExt as _,
    path::Path,
};

/// Longer than every valid configuration and every valid list of waypoints.
const LONGEST: u64 = 1 << 20;

/// The text of a file.
///
/// # Errors
///
/// The system's error; or the file is not a regular file, is too long, or is not UTF-8, each
/// with a fix.
pub(super) fn read_text(path: &Path) -> io::Result<String> {
    // Non-blocking: opening a pipe without a writer would wait for ever.
    let file = OpenOptions::new()
        .read(true)
        .custom_flags(libc::O_NONBLOCK)
        .open(path)?;
    let metadata = file.metadata()?;
    if !metadata.is_file() {
        let kind = if metadata.is_dir() {
            "a folder"
        } else {
            "a pipe, a socket or a device"
        };
        return Err(io::Error::other(format!("it is {kind}; name a file")));
    }
    let mut bytes = Vec::new();
    // A regular file may still have no end, as in /proc.
    file.take(LONGEST + 1).read_to_end(&mut bytes)?;
    let length = metadata.len().max(bytes.len() as u64);
    if length > LONGEST {
        return Err(io::Error::other(format!(
            "it is {length} bytes long; at most {LONGEST} are read, is it the right file?"
        )));
    }
    String::from_utf8(bytes).map_err(|error| {
        let good = error.utf8_error().valid_up_to();
        let before = error.as_bytes().get(..good).unwrap_or_default();
        let line = 1 + before.iter().filter(|&&byte| byte == b'\n').count();
        io::Error::other(format!("line {line} is not UTF-8; save the file as UTF-8"))
    })
}
