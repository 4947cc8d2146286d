//! What a procedure found, kept from one start to the next.

use std::{
    fs, io,
    path::{Path, PathBuf},
};

use jiff::{SignedDuration, Timestamp};
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use singletrack_commissioning::{Finding, Step, Verdict, edit::Edit};
use singletrack_record::replace;

/// Age after which a finding is found again: the car may have been changed.
const VALID: SignedDuration = SignedDuration::from_hours(24);

/// A file with the findings of a procedure that is under way.
pub(super) struct FileJournal {
    path: PathBuf,
    car_id: u16,
    entries: Vec<Entry>,
}

/// A finding, and when it was found.
#[derive(Serialize, Deserialize)]
struct Entry {
    time: Timestamp,
    finding: Finding,
}

impl Entry {
    /// Whether it is of one of these steps that did not fail, not older than a day, and with
    /// measured values that the configuration still has.
    fn holds(&self, steps: &[Step], configuration: &Edit, now: Timestamp) -> bool {
        let Finding {
            step,
            verdict,
            parameters,
            ..
        } = &self.finding;
        let age = now.duration_since(self.time);
        steps.iter().any(|known| known.name == *step)
            && *verdict != Verdict::Failed
            && age < VALID
            && !age.is_negative()
            && parameters
                .iter()
                .filter_map(|parameter| parameter.key.as_ref())
                .all(|(key, value)| configuration.has(key, value))
    }
}

impl FileJournal {
    /// The findings of this car that still hold.
    pub(super) fn open(
        path: &Path,
        car_id: u16,
        steps: &[Step],
        configuration: &Edit,
        now: Timestamp,
    ) -> Self {
        let mut entries = read(path, car_id).unwrap_or_default();
        entries.retain(|entry| entry.holds(steps, configuration, now));
        Self {
            path: path.to_owned(),
            car_id,
            entries,
        }
    }

    pub(super) fn found(&self, step: &str) -> Option<Finding> {
        let mut findings = self.entries.iter().map(|entry| &entry.finding);
        findings.find(|finding| finding.step == step).cloned()
    }

    pub(super) fn keep(&mut self, finding: &Finding, time: Timestamp) -> io::Result<()> {
        self.entries
            .retain(|entry| entry.finding.step != finding.step);
        let finding = finding.clone();
        self.entries.push(Entry { time, finding });
        let json = json!({ "car_id": self.car_id, "entries": self.entries });
        replace(&self.path, json.to_string().as_bytes())
    }

    /// The procedure has run to its end: the next one begins with its first step.
    pub(super) fn close(&self) -> io::Result<()> {
        remove(&self.path)
    }
}

/// The entries of a file, without damaged ones; none of one that is missing, damaged or of another
/// car.
fn read(path: &Path, car_id: u16) -> Option<Vec<Entry>> {
    let text = fs::read_to_string(path).ok()?;
    let json: Value = serde_json::from_str(&text).ok()?;
    if json["car_id"] != car_id {
        return None;
    }
    let entries = json["entries"].as_array()?.iter();
    Some(
        entries
            .filter_map(|entry| Entry::deserialize(entry).ok())
            .collect(),
    )
}

/// Removes the file of a journal, if there is one.
pub(super) fn remove(path: &Path) -> io::Result<()> {
    match fs::remove_file(path) {
        Err(error) if error.kind() != io::ErrorKind::NotFound => Err(error),
        _ => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use singletrack_commissioning::{Bench, Interrupted, Interval, Parameter, Trouble};

    use super::*;

    fn never(_: &mut dyn Bench) -> Result<Finding, Trouble> {
        Err(Interrupted::ByOperator.into())
    }

    const STEPS: [Step; 2] = [step("first"), step("second")];

    const fn step(name: &'static str) -> Step {
        Step {
            name,
            title: name,
            essential: false,
            expected: "",
            run: never,
        }
    }

    fn finding(step: &'static str) -> Finding {
        Finding {
            step: step.into(),
            verdict: Verdict::Good,
            found: "x".to_owned(),
            expected: "x".to_owned(),
            fix: String::new(),
            parameters: vec![Parameter {
                name: "servo-centre".into(),
                unit: "us".into(),
                estimate: Interval::around(1_512.0, 2.0),
                key: Some(("board.servo.centre_us".into(), 1_512.into())),
                why: "".into(),
            }],
        }
    }

    #[test]
    fn findings_are_there_again_while_they_hold() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("doctor.json");
        let file = Edit::new("[board.servo]\ncentre_us = 1512\n").unwrap();
        let other = Edit::new("[board.servo]\ncentre_us = 1500\n").unwrap();
        let now = Timestamp::from_second(1_800_000_000).unwrap();
        let mut journal = FileJournal::open(&path, 3, &STEPS, &file, now);
        assert!(journal.found("first").is_none());
        journal.keep(&finding("first"), now).unwrap();
        journal.keep(&finding("first"), now).unwrap();

        let later = now + SignedDuration::from_hours(23);
        let too_late = now + SignedDuration::from_hours(24);
        for (car_id, file, now, holds) in [
            (3, &file, later, true),
            (3, &file, too_late, false),
            (3, &file, now - SignedDuration::from_secs(1), false),
            (4, &file, later, false),
            (3, &other, later, false),
        ] {
            let journal = FileJournal::open(&path, car_id, &STEPS, file, now);
            assert_eq!(journal.found("first").is_some(), holds, "{car_id} {now}");
            assert!(journal.found("second").is_none());
        }
        journal.close().unwrap();
        journal.close().unwrap();
        let journal = FileJournal::open(&path, 3, &STEPS, &file, now);
        assert!(journal.found("first").is_none());
    }

    #[test]
    fn a_step_that_failed_is_done_again_and_those_before_it_are_not() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("doctor.json");
        let file = Edit::new("[board.servo]\ncentre_us = 1512\n").unwrap();
        let now = Timestamp::from_second(1_800_000_000).unwrap();
        let mut journal = FileJournal::open(&path, 3, &STEPS, &file, now);
        journal.keep(&finding("first"), now).unwrap();
        let failed = Finding {
            verdict: Verdict::Failed,
            ..finding("second")
        };
        journal.keep(&failed, now).unwrap();
        let journal = FileJournal::open(&path, 3, &STEPS, &file, now);
        assert!(journal.found("first").is_some() && journal.found("second").is_none());
    }

    #[test]
    fn a_damaged_journal_is_an_empty_one() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("doctor.json");
        let file = Edit::new("").unwrap();
        for text in [
            "",
            "{",
            "[]",
            r#"{"car_id":3}"#,
            r#"{"car_id":3,"entries":[{}]}"#,
        ] {
            fs::write(&path, text).unwrap();
            let journal = FileJournal::open(&path, 3, &STEPS, &file, Timestamp::now());
            assert!(journal.entries.is_empty(), "{text}");
        }
    }
}
