//! The certificate of the safety filter, and when the daemon refuses to arm by one.

use std::{fs, path::Path};

use serde_json::Value;
use singletrack_core::{
    Config,
    certificate::{certificate, refusal},
};

fn filtered() -> Config {
    let mut config =
        Config::from_toml(include_str!("../../daemon/singletrackd.example.toml")).unwrap();
    config.safety_filter.enabled = true;
    config
}

/// A configuration that names this file.
fn wanting(path: &Path) -> Config {
    let mut config = filtered();
    config.safety_filter.certificate = Some(path.to_owned());
    config
}

/// Every whole number in a value.
fn numbers<'a>(value: &'a mut Value, found: &mut Vec<&'a mut Value>) {
    match value {
        Value::Number(_) => found.push(value),
        Value::Array(values) => values.iter_mut().for_each(|value| numbers(value, found)),
        Value::Object(values) => {
            values.values_mut().for_each(|value| numbers(value, found));
        }
        Value::Null | Value::Bool(_) | Value::String(_) => {}
    }
}

#[test]
fn a_car_that_wants_no_certificate_needs_none() {
    assert_eq!(refusal(&filtered()), None);
}

#[test]
fn the_file_of_this_configuration_is_accepted_and_no_other() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("filter-certificate.json");
    let config = wanting(&path);
    let refused = |part: &str| {
        let why = refusal(&config).unwrap_or_else(|| panic!("accepted, not {part}"));
        let command = format!("singletrack certify CONFIG.toml --out {}", path.display());
        for part in [part, "safety_filter.certificate = ", &command] {
            assert!(why.contains(part), "{part}: {why}");
        }
    };
    refused("it can't be read");
    fs::write(&path, "{").unwrap();
    refused("it is no JSON");
    for text in ["{}", "[]", "null", "{\"settings\":{}}"] {
        fs::write(&path, text).unwrap();
        refused("actuators.speed_dead_time_ms is missing there");
    }

    let mut other = config.clone();
    other.fence.braking_m_s2 = 1.1;
    fs::write(&path, certificate(&other).unwrap()).unwrap();
    refused("another configuration: fence.braking_m_s2 is 1.1 there, and 0.9 here");

    fs::write(&path, certificate(&config).unwrap()).unwrap();
    assert_eq!(refusal(&config), None);
}

#[test]
fn a_file_with_any_other_number_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("filter-certificate.json");
    let config = wanting(&path);
    let mut given: Value = serde_json::from_str(&certificate(&config).unwrap()).unwrap();
    let count = {
        let mut found = Vec::new();
        numbers(&mut given, &mut found);
        found.len()
    };
    assert!(count > 1_000, "{count}");
    for index in (0..count).step_by(97) {
        let mut changed = given.clone();
        let mut found = Vec::new();
        numbers(&mut changed, &mut found);
        *found[index] = (found[index].as_i64().unwrap() + 1).into();
        fs::write(&path, changed.to_string()).unwrap();
        let why = refusal(&config).unwrap();
        assert!(why.contains("its figures are not those"), "{index}: {why}");
    }
}

#[test]
fn a_filter_that_is_off_and_a_car_that_goes_backward_have_none() {
    let mut config = filtered();
    config.safety_filter.enabled = false;
    let error = certificate(&config).unwrap_err().to_string();
    assert!(error.contains("safety_filter.enabled is false"), "{error}");
    let mut config = filtered();
    config.limits.max_reverse_speed_m_s = 0.5;
    let error = certificate(&config).unwrap_err().to_string();
    assert!(
        error.contains("limits.max_reverse_speed_m_s is 0.5"),
        "{error}"
    );
}
