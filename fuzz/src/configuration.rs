//! Texts that somebody calls a configuration.

use singletrack_link::Session;
use singletrackd::Config;

use crate::choices::Choices;

/// The example that is shipped with the daemon.
const EXAMPLE: &str = include_str!("../../host/daemon/singletrackd.example.toml");

/// Values that are wrong at most keys, and right at some.
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

/// How long a message about a mistake may be, beside the text that it quotes.
const MESSAGE: usize = 2_048;

/// Texts that somebody calls a configuration.
///
/// The first byte says what is made of the rest: the text itself, or changes of
/// the example's lines.
///
/// # Panics
///
/// When what is accepted is not valid, does not survive being written and read,
/// can't be given to controller, link and cameras, or is a reference that is
/// anywhere not finite; when what is refused is
/// refused without a word, or with more than the text deserves.
///
/// Returns how many texts were tried.
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
            assert!(!message.trim().is_empty(), "refused without a word");
            assert!(
                message.len() <= MESSAGE + 4 * text.len(),
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
    let pilot = config.pilot().expect("what is valid is for the controller");
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
    assert!(Session::new(config.link(1)).is_ok(), "not for the link");
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
            // A default, switched on.
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

/// Gives the line's key another value, and switches it on.
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
    fn a_change_is_made_where_it_says() {
        let example = changed_example(&mut Choices::new(&[]));
        let port = example.lines().position(|line| line.starts_with("port ="));
        let text = changed_example(&mut Choices::new(&[1, port.unwrap() as u8, 4]));
        assert!(text.contains("\nport = 300\n"), "{text}");
        let message = Config::from_toml(&text).unwrap_err().to_string();
        assert!(message.contains("port"), "{message}");
    }
}
