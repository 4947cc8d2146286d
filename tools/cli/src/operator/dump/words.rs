//! The words that a field of a record can hold.

use singletrack_record::Topic;

/// The words of a field that holds one of a few, by the schema of its topic; empty for
/// any other field.
pub(super) fn words(topic: &str, field: &str) -> Vec<String> {
    let Some(topic) = Topic::ALL.into_iter().find(|known| known.name() == topic) else {
        return Vec::new();
    };
    // The constants of a field stand before it: `uint8 MODE_DRIVING=6`, ..., `uint8 mode`.
    // Other messages, after the line of `=`, are those within this one.
    let schema = topic.schema_text();
    let mut constants = Vec::new();
    for line in schema.lines().take_while(|line| !line.starts_with('=')) {
        let Some((_, name)) = line.trim().split_once(' ') else {
            continue;
        };
        match name.split_once('=') {
            Some((constant, _)) => constants.push(constant),
            None if name == field => break,
            None => constants.clear(),
        }
    }
    let prefix = common_prefix(&constants);
    constants
        .iter()
        .filter_map(|constant| constant.get(prefix..))
        .map(|word| word.to_lowercase().replace('_', "-"))
        .collect()
}

/// The length of what all names begin with, up to and with an underscore.
fn common_prefix(names: &[&str]) -> usize {
    let (Some(first), Some(last)) = (names.iter().min(), names.iter().max()) else {
        return 0;
    };
    let shared = first
        .bytes()
        .zip(last.bytes())
        .take_while(|(one, other)| one == other)
        .count();
    first
        .get(..shared)
        .and_then(|shared| shared.rfind('_'))
        .map_or(0, |underscore| underscore + 1)
}

#[cfg(test)]
mod tests {
    use singletrack_pilot::{Mode, Reason};

    use super::*;

    #[test]
    fn the_words_of_a_field_are_those_that_its_values_print() {
        let sorted = |mut words: Vec<String>| {
            words.sort();
            words
        };
        let modes = Mode::ALL.iter().map(|mode| mode.name().to_owned());
        assert_eq!(sorted(words("tick", "mode")), sorted(modes.collect()));
        let reasons = Reason::ALL.iter().map(|reason| reason.name().to_owned());
        let reasons = reasons.chain(["none".to_owned()]);
        assert_eq!(sorted(words("tick", "reason")), sorted(reasons.collect()));
    }

    #[test]
    fn every_list_of_words_of_the_board_is_whole() {
        assert_eq!(
            words("telemetry", "mode"),
            [
                "boot",
                "neutral",
                "armed",
                "driving",
                "failsafe",
                "emergency-stopped",
                "powering-up",
                "jogging"
            ]
        );
        for (topic, field, word) in [
            ("telemetry", "stop_cause", "stop-input"),
            ("telemetry", "imu", "fresh"),
            ("status", "last_refusal", "none"),
            ("tick", "link", "ready"),
            ("pose", "state", "valid"),
            ("log", "level", "warning"),
        ] {
            let words = words(topic, field);
            assert!(
                words.iter().any(|known| known == word),
                "{field}: {words:?}"
            );
        }
    }

    #[test]
    fn numbers_texts_and_frames_have_no_words() {
        for (topic, field) in [("tick", "index"), ("log", "text"), ("hello", "mode")] {
            assert_eq!(words(topic, field), [""; 0], "{topic} {field}");
        }
    }
}
