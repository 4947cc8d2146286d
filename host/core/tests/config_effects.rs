//! No key of the configuration is without effect: what is written reaches who acts by it.

use singletrack_core::config::{Config, SECTIONS};
use toml::{Table, Value};

/// Sections and keys that their users read as they are: threads, files, sockets, the page.
const READ_AS_THEY_ARE: &[&str] = &[
    "serial",
    "socket",
    "record",
    "state",
    "page",
    "live",
    "supervisor.require_calibration",
    "control.align_to_cameras",
    "control.realtime_priority",
    "online_calibration",
];

/// Sections whose keys depend on a kind, or come together; they have tests of their own.
const TOGETHER: &[&str] = &[
    "motion_capture.sensor",
    "outer_loop",
    "reference",
    "vehicle",
    "tuning",
    "limits.max_reverse_speed_m_s",
];

fn example() -> Table {
    let mut file: Table =
        toml::from_str(include_str!("../../daemon/singletrackd.example.toml")).unwrap();
    // On, so that their keys count.
    for section in ["safety_filter", "governor", "neighbours"] {
        let table = file.entry(section).or_insert_with(|| Table::new().into());
        let table = table.as_table_mut().unwrap();
        table.insert("enabled".to_owned(), true.into());
    }
    file
}

/// What pilot, link, board and cameras are given.
fn given(file: &Table) -> Option<String> {
    let config = Config::from_toml(&toml::to_string(file).unwrap()).ok()?;
    let pilot = config.pilot().ok()?;
    let link = config.link(0);
    let steering = config.steering_map().ok()?;
    let cameras = &config.motion_capture;
    Some(format!("{pilot:?} {link:?} {steering:?} {cameras:?}"))
}

/// Other values of the same type, a little and much away.
fn others(value: &Value) -> Vec<Value> {
    match value {
        Value::Boolean(is) => vec![(!is).into()],
        Value::Integer(number) => [1, -1, 100, -100, 1_000]
            .map(|by| (number + by).into())
            .into(),
        Value::Float(number) => [1.01, 0.99, 1.5, 0.5]
            .map(|by| (number * by).into())
            .into_iter()
            .chain([(number + 0.01).into(), (number + 1.0).into()])
            .collect(),
        Value::Array(values) => {
            let Some(first) = values.first() else {
                return Vec::new();
            };
            let changed = others(first).into_iter().map(|first| {
                let mut values = values.clone();
                values[0] = first;
                values.into()
            });
            changed.collect()
        }
        _ => Vec::new(),
    }
}

#[test]
fn every_number_and_every_switch_reaches_who_acts_by_it() {
    let file = example();
    let before = given(&file).unwrap();
    let mut without = Vec::new();
    let mut count = 0;
    for section in SECTIONS {
        let names: Vec<&str> = section.name.split('.').collect();
        for key in section.keys {
            let path = format!("{}.{}", section.name, key.name);
            let is_known = |known: &&str| *known == names[0] || *known == path;
            if READ_AS_THEY_ARE.iter().chain(TOGETHER).any(is_known) {
                continue;
            }
            let mut file = file.clone();
            let table = names.iter().fold(&mut file, |table, name| {
                let entry = table.entry(*name).or_insert_with(|| Table::new().into());
                entry.as_table_mut().unwrap()
            });
            let written = table.get(key.name).cloned();
            let Some(value) = written.or((key.example)()).or((key.default)()) else {
                continue;
            };
            let others = others(&value);
            let differing = others.iter().filter(|other| **other != value).cloned();
            let after = differing.into_iter().find_map(|other| {
                let mut file = file.clone();
                let table = names.iter().fold(&mut file, |table, name| {
                    table[*name].as_table_mut().unwrap()
                });
                table.insert(key.name.to_owned(), other);
                given(&file)
            });
            count += 1;
            if after.is_none_or(|after| after == before) && !others.is_empty() {
                without.push(path);
            }
        }
    }
    assert!(count > 100, "{count}");
    assert_eq!(without, [""; 0]);
}
