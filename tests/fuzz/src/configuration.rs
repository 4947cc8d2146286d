//! Fuzz target: configuration files.

use singletrack_core::Config;
use singletrack_link::Session;

use crate::choices::Choices;

/// The example configuration of the daemon.
const EXAMPLE: &str = include_str!("../../../host/daemon/singletrackd.example.toml");

/// Values that are valid for some keys and invalid for most.
const VALUES: [&str; 24] = [
    "0",
    "-1",
    "1",
    "2",
    "300",
    "65536",
    "-9223372036854775808",
    "0.0",
    "-0.0",
    "0.5",
    "1e308",
    "nan",
    "inf",
    "true",
    "false",
    "\"\"",
    "\"y\"",
    "\"coast\"",
    "\"0.0.0.0\"",
    "\"239.1.1.1\"",
    "[]",
    "[0.0, 1.0]",
    "{}",
    "1979-05-27",
];

/// Largest length of an error message, without the quoted text.
const MAX_MESSAGE: usize = 2_048;

/// Parses texts as configurations.
///
/// The first byte selects the use of the rest: as the text itself, or as changes of
/// the example's lines.
///
/// # Panics
///
/// If an accepted configuration is invalid, does not round-trip, is rejected by
/// controller, link or cameras, or has a reference that is not finite; if a refusal
/// has no message or one that is too long.
///
/// Returns the number of texts.
pub fn configuration(data: &[u8]) -> u64 {
    let mut choices = Choices::new(data);
    if choices.byte() & 1 != 0 {
        check(&changed_example(&mut choices));
    } else if let Ok(text) = core::str::from_utf8(choices.rest()) {
        check(text);
    } else {
        return 0;
    }
    1
}

fn check(text: &str) {
    match Config::from_toml(text) {
        Ok(config) => check_accepted(&config),
        Err(error) => {
            let message = error.to_string();
            assert!(!message.trim().is_empty(), "refused without a message");
            assert!(
                message.len() <= MAX_MESSAGE + 4 * text.len(),
                "{} bytes about {}",
                message.len(),
                text.len()
            );
        }
    }
}

fn check_accepted(config: &Config) {
    assert!(config.validate().is_ok());
    let written = config.to_toml().expect("all paths came from a text");
    let read = Config::from_toml(&written);
    assert!(
        read.as_ref().is_ok_and(|read| read == config),
        "{read:?} instead of {config:?}"
    );
    let pilot = config
        .pilot()
        .expect("the controller accepts a valid configuration");
    for time_s in [0.0, 0.01, 1.0, 1_000.0] {
        let point = pilot.reference.at(time_s);
        let position = point.position.map(|position| [position.x, position.y]);
        let numbers = [
            position.unwrap_or_default(),
            [point.velocity.x, point.velocity.y],
        ];
        assert!(
            numbers.iter().flatten().all(|number| number.is_finite()),
            "{point:?} is not finite"
        );
    }
    assert!(Session::new(config.link(1)).is_ok(), "refused by the link");
    let cameras = config.motion_capture.session();
    assert!(
        cameras.is_ok_and(|cameras| singletrack_mocap::planar::PlanarSession::new(cameras).is_ok()),
        "not for the cameras"
    );
}

/// The example's lines with a few changes.
fn changed_example(choices: &mut Choices<'_>) -> String {
    let mut lines: Vec<String> = EXAMPLE
        .lines()
        .filter(|line| !line.is_empty() && !line.starts_with("# "))
        .map(str::to_owned)
        .collect();
    let mut changes = 0;
    while !choices.is_empty() && changes < 16 {
        changes += 1;
        let operation = choices.byte();
        let at = usize::from(choices.byte()) % lines.len();
        let Some(line) = lines.get_mut(at) else { break };
        match operation % 8 {
            // A commented default, enabled.
            0 => *line = line.trim_start_matches('#').to_owned(),
            1 => set_value(line, choices.one_of(VALUES)),
            2 => set_value(line, &choices.i32().to_string()),
            3 => set_value(line, &format!("{:?}", choices.f64())),
            4 => set_value(line, &String::from_utf8_lossy(choices.bytes())),
            5 => *line = String::from_utf8_lossy(choices.bytes()).into_owned(),
            6 => {
                let again = line.clone();
                lines.insert(at, again);
            }
            _ => line.clear(),
        }
    }
    lines.join("\n")
}

/// Sets another value for the line's key, and enables the line.
fn set_value(line: &mut String, value: &str) {
    if let Some((key, _)) = line.trim_start_matches('#').split_once('=') {
        *line = format!("{key}= {value}");
    }
}

#[cfg(test)]
mod tests {
    use super::{Choices, Config, changed_example};

    #[test]
    fn the_example_unchanged_is_accepted() {
        let text = changed_example(&mut Choices::new(&[]));
        Config::from_toml(&text).unwrap();
    }

    #[test]
    fn a_change_applies_to_the_selected_line() {
        let example = changed_example(&mut Choices::new(&[]));
        let port = example.lines().position(|line| line.starts_with("port ="));
        let text = changed_example(&mut Choices::new(&[1, port.unwrap() as u8, 4]));
        assert!(text.contains("\nport = 300\n"), "{text}");
        let message = Config::from_toml(&text).unwrap_err().to_string();
        assert!(message.contains("port"), "{message}");
    }
}
