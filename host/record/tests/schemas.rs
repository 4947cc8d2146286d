//! The layouts of the messages are frozen for each version of records.

#![allow(clippy::unwrap_used, reason = "a test may fail")]

use std::{fs, path::Path};

use singletrack_record::{Channel, RECORD_VERSION};

/// If this test fails, the change is wrong, or `RECORD_VERSION` has to rise and the files
/// have to be replaced. A word (a constant) may be added within a version: readers take records
/// that lack it. The layouts of the messages of ROS never change here.
#[test]
fn the_layouts_are_those_of_this_version() {
    assert_eq!(RECORD_VERSION, 12);
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("msg");
    for channel in Channel::all() {
        let name = channel.schema_name();
        let (package, name) = name.split_once("/msg/").unwrap();
        let file = match package {
            "singletrack_msgs" => format!("{name}.msg"),
            standard => format!("{standard}/{name}.msg"),
        };
        let now = Path::new(env!("CARGO_TARGET_TMPDIR")).join(&file);
        fs::create_dir_all(now.parent().unwrap()).unwrap();
        fs::write(&now, channel.schema_text()).unwrap();
        let frozen = fs::read_to_string(folder.join(&file)).unwrap_or_default();
        assert!(
            channel.schema_text() == frozen,
            "the layout of {file} has changed; it is now as in {}",
            now.display()
        );
    }
}
