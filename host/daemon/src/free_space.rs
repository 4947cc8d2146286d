//! The free space on the disk of the record.

use std::{io, path::PathBuf};

use rustix::fs::statvfs;

/// A megabyte, as disks are sold.
const MB: u64 = 1_000_000;

/// A folder, and what must be free on its disk.
#[derive(Clone, Debug)]
pub(crate) struct FreeSpace {
    /// The folder of the record.
    pub(crate) directory: PathBuf,
    /// `record.min_free_mb`.
    pub(crate) min_free_mb: u32,
}

impl FreeSpace {
    /// Why a record soon ends; `None` while there is room, and if the system does not say.
    pub(crate) fn warning(&self) -> Option<String> {
        let free_mb = self.free_mb().ok()?;
        (free_mb < u64::from(self.min_free_mb)).then(|| {
            format!(
                "the disk of the records is nearly full: {free_mb} MB are free in {}, and \
                 record.min_free_mb is {}. Move or delete old records: once it is full, nothing is \
                 recorded",
                self.directory.display(),
                self.min_free_mb,
            )
        })
    }

    fn free_mb(&self) -> io::Result<u64> {
        let disk = statvfs(&self.directory)?;
        // Without what is reserved for root.
        Ok(disk.f_bavail.saturating_mul(disk.f_frsize) / MB)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_disk_with_less_than_the_limit_is_a_warning_with_folder_and_both_values() {
        let folder = tempfile::tempdir().unwrap();
        let space = |min_free_mb| FreeSpace {
            directory: folder.path().to_owned(),
            min_free_mb,
        };
        let free_mb = space(0).free_mb().unwrap();
        assert!((1..u64::from(u32::MAX)).contains(&free_mb), "{free_mb}");
        assert_eq!(space(0).warning(), None);
        let warning = space(u32::MAX).warning().unwrap();
        for part in [
            "nearly full",
            &folder.path().display().to_string(),
            "record.min_free_mb is 4294967295",
        ] {
            assert!(warning.contains(part), "{warning}");
        }
        let gone = FreeSpace {
            directory: folder.path().join("gone"),
            min_free_mb: u32::MAX,
        };
        assert_eq!(gone.warning(), None);
    }
}
