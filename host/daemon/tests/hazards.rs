//! The hazards of `docs/safety.md`: each has a safeguard, and every test that the page names exists.

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

/// A hazard of the page.
struct Hazard {
    title: &'static str,
    causes: Vec<Cause>,
}

/// A cause of a hazard: `**CAUSE.** SAFEGUARD *Remains:* RISK`, and after it a line `Tests: NAMES`.
struct Cause {
    text: &'static str,
    safeguard: &'static str,
    /// The risk that remains, if the page states one.
    risk: Option<&'static str>,
    tests: Vec<&'static str>,
}

/// The hazards of the page, one a heading of the third level.
fn hazards() -> Vec<Hazard> {
    let (_, page) = PAGE.split_once("\n## Hazards\n").unwrap();
    let (section, _) = page.split_once("\n## ").unwrap();
    section.split("\n### ").skip(1).map(hazard).collect()
}

fn hazard(section: &'static str) -> Hazard {
    let (title, text) = section.split_once('\n').unwrap();
    let mut causes = text.split("\n**");
    let before = causes.next().unwrap();
    assert!(before.trim().is_empty(), "{title}: {before}: no cause");
    Hazard {
        title: title.trim(),
        causes: causes.map(|text| cause(title, text)).collect(),
    }
}

fn cause(title: &str, paragraphs: &'static str) -> Cause {
    let (text, rest) = paragraphs
        .split_once("**")
        .unwrap_or_else(|| panic!("{title}: {paragraphs}: the bold text does not end"));
    let (rest, named) = rest
        .split_once("\n\nTests: ")
        .unwrap_or_else(|| panic!("{title}: {text}: no test proves it"));
    let (safeguard, risk) = match rest.split_once("*Remains:*") {
        Some((safeguard, risk)) => (safeguard, Some(risk.trim())),
        None => (rest, None),
    };
    let names: Vec<&str> = named.trim().split('`').collect();
    for between in names.iter().step_by(2) {
        let separator = between.trim();
        assert!(
            ["", ","].contains(&separator),
            "{title}: {text}: {separator}: no name of a test"
        );
    }
    Cause {
        text: text.trim(),
        safeguard: safeguard.trim(),
        risk,
        tests: names.into_iter().skip(1).step_by(2).collect(),
    }
}

#[test]
fn every_test_that_the_hazards_name_exists() {
    let tests = tests();
    let hazards = hazards();
    assert!(hazards.len() >= 15, "{} hazards", hazards.len());
    for hazard in hazards {
        for cause in hazard.causes {
            let place = format!("{}: {}", hazard.title, cause.text);
            assert!(!cause.text.is_empty(), "{place}: no cause");
            assert!(!cause.safeguard.is_empty(), "{place}: no safeguard");
            assert!(cause.risk != Some(""), "{place}: no risk");
            assert!(!cause.tests.is_empty(), "{place}: no test proves it");
            for name in cause.tests {
                assert!(tests.contains(name), "{place}: there is no test {name}");
            }
        }
    }
}

#[test]
fn every_hazard_has_a_title_of_its_own_and_a_cause() {
    let mut titles = BTreeSet::new();
    for hazard in hazards() {
        let title = hazard.title;
        assert!(!title.is_empty() && titles.insert(title), "{title}");
        assert!(!hazard.causes.is_empty(), "{title}: no cause");
    }
}
