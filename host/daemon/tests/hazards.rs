//! The hazard table of `docs/safety.md`: every test that it names exists.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    reason = "the helpers of tests may fail as tests do"
)]

use std::{collections::BTreeSet, fs, path::Path};

const PAGE: &str = include_str!("../../../docs/safety.md");

/// The names of all test functions of the repository, and of the scenarios with hardware.
fn tests() -> BTreeSet<String> {
    let mut names = BTreeSet::new();
    let mut folders = vec![Path::new(env!("CARGO_MANIFEST_DIR")).join("../..")];
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            let name = path.file_name().unwrap().to_string_lossy().into_owned();
            if path.is_dir() && !name.starts_with('.') && name != "target" {
                folders.push(path);
            } else if name.ends_with(".rs") {
                collect(&fs::read_to_string(&path).unwrap(), &mut names);
            }
        }
    }
    names
}

fn collect(text: &str, names: &mut BTreeSet<String>) {
    let mut is_test = false;
    for line in text.lines().map(str::trim) {
        if let Some(rest) = line.strip_prefix("fn ")
            && is_test
        {
            names.extend(rest.split('(').next().map(str::to_owned));
        }
        // Scenarios of the suite with hardware in the loop.
        if let Some(quoted) = line.split('"').nth(1)
            && (line.starts_with("Scenario::new(") || line.starts_with('"'))
        {
            names.insert(quoted.to_owned());
        }
        if line.starts_with("#[test]") {
            is_test = true;
        } else if !line.starts_with("#[") && !line.starts_with("//") {
            is_test = false;
        }
    }
}

/// The rows of the hazard table: hazard, cause, safeguard, test, what is left.
fn rows() -> Vec<Vec<&'static str>> {
    let (_, table) = PAGE
        .split_once("| hazard | cause | safeguard | test | what is left |\n")
        .unwrap();
    table
        .lines()
        .skip(1)
        .map_while(|line| line.strip_prefix('|')?.strip_suffix('|'))
        .map(|row| row.split('|').map(str::trim).collect())
        .collect()
}

#[test]
fn every_test_that_the_hazard_table_names_exists() {
    let tests = tests();
    let rows = rows();
    assert!(rows.len() >= 15, "{} hazards", rows.len());
    for row in rows {
        let [_, cause, safeguard, named, _] = row[..] else {
            panic!("five columns: {row:?}");
        };
        assert!(!cause.is_empty() && !safeguard.is_empty(), "{row:?}");
        let named: Vec<_> = named.split('`').skip(1).step_by(2).collect();
        assert!(!named.is_empty(), "no test proves it: {row:?}");
        for name in named {
            assert!(tests.contains(name), "there is no test {name}");
        }
    }
}

#[test]
fn a_hazard_continues_the_row_above_or_has_a_name() {
    let rows = rows();
    assert!(!rows.first().unwrap().first().unwrap().is_empty());
}
