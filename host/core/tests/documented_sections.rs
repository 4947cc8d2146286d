//! The sections of the configuration that the pages of the documentation show.

#![allow(
    clippy::unwrap_used,
    reason = "the helpers of tests may fail as tests do"
)]

use std::{fs, path::Path};

use singletrack_core::config::{Config, SECTIONS};

const EXAMPLE: &str = include_str!("../../daemon/singletrackd.example.toml");

/// The blocks of TOML of a page.
fn blocks(page: &str) -> impl Iterator<Item = toml::Table> {
    let after = page.split("```toml\n").skip(1);
    after.map(|rest| rest.split("```").next().unwrap().parse().unwrap())
}

/// Puts the keys of a block into the example; a reference of another kind replaces its own.
fn onto_example(block: toml::Table) -> toml::Table {
    let mut whole: toml::Table = EXAMPLE.parse().unwrap();
    for (section, keys) in block {
        match (whole.get_mut(&section), keys) {
            (Some(toml::Value::Table(known)), toml::Value::Table(keys))
                if section != "reference" =>
            {
                known.extend(keys);
            }
            (_, keys) => {
                whole.insert(section, keys);
            }
        }
    }
    whole
}

#[test]
fn every_section_in_a_page_is_taken_with_the_example() {
    let docs = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs");
    let mut shown = 0;
    for page in fs::read_dir(docs).unwrap().flatten() {
        let path = page.path();
        if path.extension().is_none_or(|ending| ending != "md") {
            continue;
        }
        for block in blocks(&fs::read_to_string(&path).unwrap()) {
            // Maps of imports and the truth of simulations are other files.
            if block.contains_key("truth") || block.contains_key("pose") {
                continue;
            }
            shown += 1;
            for section in block.keys() {
                let is_known = SECTIONS.iter().any(|known| known.name == section);
                assert!(is_known, "{}: there is no [{section}]", path.display());
            }
            let text = toml::to_string(&onto_example(block)).unwrap();
            if let Err(error) = Config::from_toml(&text) {
                let error = error.to_string();
                // Keys are judged before the files of points, which are the reader's own.
                assert!(
                    error.contains(".csv: No such"),
                    "{}: {error}",
                    path.display()
                );
            }
        }
    }
    assert!(shown > 5, "{shown}");
}
