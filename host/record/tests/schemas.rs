//! The layouts of the messages are frozen for each version of records.

#![allow(clippy::unwrap_used, reason = "a test may fail")]

use std::{fs, path::Path};

use singletrack_record::{RECORD_VERSION, Topic};

/// A test that fails says that the change is wrong, or that `RECORD_VERSION`
/// has to rise and the files have to be replaced.
#[test]
fn the_layouts_are_those_of_this_version() {
    assert_eq!(RECORD_VERSION, 2);
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("msg");
    for topic in Topic::ALL {
        let name = topic.schema_name();
        let name = name.rsplit('/').next().unwrap();
        let now = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("{name}.msg"));
        fs::write(&now, topic.schema_text()).unwrap();
        let frozen = fs::read_to_string(folder.join(format!("{name}.msg"))).unwrap_or_default();
        assert!(
            topic.schema_text() == frozen,
            "the layout of {name} has changed; it is now as in {}",
            now.display()
        );
    }
}
