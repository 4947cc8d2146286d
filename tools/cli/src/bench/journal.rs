//! What a procedure found, kept from one start to the next.

use std::{
    fs::{self, File},
    io::{self, Write as _},
    path::{Path, PathBuf},
};

use jiff::{SignedDuration, Timestamp};
use serde_json::{Value, json};
use singletrack_commissioning::{Finding, Step, Verdict, edit::Edit, report};

/// Age after which a finding is found again: the car may have been changed.
const VALID: SignedDuration = SignedDuration::from_hours(24);

/// A file with the findings of a procedure that is under way.
pub(super) struct FileJournal {
    path: PathBuf,
    car_id: u16,
    entries: Vec<(Finding, Value)>,
}

impl FileJournal {
    /// The findings that still hold, of these steps: of this car, not older than a day, of a step
    /// that did not fail, and with measured values that the configuration still has.
    pub(super) fn open(
        path: &Path,
        car_id: u16,
        steps: &[Step],
        configuration: &Edit,
        now: Timestamp,
    ) -> Self {
        let entries = read(path, car_id)
            .into_iter()
            .filter_map(|entry| {
                let time: Timestamp = entry.get("time")?.as_str()?.parse().ok()?;
                let age = now.duration_since(time);
                let json = entry.get("finding")?;
                let name = json.get("step")?.as_str()?;
                let step = steps.iter().find(|step| step.name == name)?;
                let finding = report::from_json(step.name, json)?;
                let holds = finding.verdict != Verdict::Failed
                    && age < VALID
                    && !age.is_negative()
                    && finding
                        .parameters
                        .iter()
                        .filter_map(|parameter| parameter.key.as_ref())
                        .all(|(key, value)| configuration.has(key, value));
                holds.then_some((finding, entry))
            })
            .collect();
        Self {
            path: path.to_owned(),
            car_id,
            entries,
        }
    }

    pub(super) fn found(&self, step: &str) -> Option<Finding> {
        self.entries
            .iter()
            .map(|(finding, _)| finding)
            .find(|finding| finding.step == step)
            .cloned()
    }

    pub(super) fn keep(&mut self, finding: &Finding, now: Timestamp) -> io::Result<()> {
        self.entries.retain(|(kept, _)| kept.step != finding.step);
        let entry = json!({ "time": now.to_string(), "finding": report::to_json(finding) });
        self.entries.push((finding.clone(), entry));
        let entries: Vec<&Value> = self.entries.iter().map(|(_, entry)| entry).collect();
        let text = json!({ "car_id": self.car_id, "entries": entries }).to_string();
        write(&self.path, &text)
    }

    /// The procedure has run to its end: the next one begins with its first step.
    pub(super) fn close(&self) -> io::Result<()> {
        match fs::remove_file(&self.path) {
            Err(error) if error.kind() != io::ErrorKind::NotFound => Err(error),
            _ => Ok(()),
        }
    }
}

/// The entries of a file; none of one that is missing, damaged or of another car.
fn read(path: &Path, car_id: u16) -> Vec<Value> {
    let Some(mut json) = fs::read_to_string(path)
        .ok()
        .and_then(|text| serde_json::from_str::<Value>(&text).ok())
    else {
        return Vec::new();
    };
    if json.get("car_id").and_then(Value::as_u64) != Some(car_id.into()) {
        return Vec::new();
    }
    match json.get_mut("entries").map(Value::take) {
        Some(Value::Array(entries)) => entries,
        _ => Vec::new(),
    }
}

/// Replaces a file as a whole, down to the disk.
pub(super) fn write(path: &Path, text: &str) -> io::Result<()> {
    let mut staged = path.as_os_str().to_owned();
    staged.push(".new");
    let mut file = File::create(&staged)?;
    file.write_all(text.as_bytes())?;
    file.sync_all()?;
    fs::rename(&staged, path)
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
            step,
            verdict: Verdict::Good,
            found: "x".to_owned(),
            expected: "x".to_owned(),
            fix: String::new(),
            parameters: vec![Parameter {
                name: "servo-centre",
                unit: "us",
                estimate: Interval::around(1_512.0, 2.0),
                key: Some(("board.servo.centre_us", 1_512.into())),
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
