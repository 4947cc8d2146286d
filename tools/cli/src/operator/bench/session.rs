//! `singletrack doctor|bring-up|calibrate`, from the parts to the first drive: steps, findings, page.

use std::{
    fs::{self, File, TryLockError},
    io,
    path::{Path, PathBuf},
    process::ExitCode,
};

use clap::Args;
use indicatif::ProgressBar;
use jiff::{SignedDuration, Timestamp};
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use singletrack_commissioning::{
    self as commissioning, Finding, Interrupted, Journal, Step, Verdict, bring_up, calibrate,
    doctor, edit::Edit, report,
};
use singletrack_core::{Config, configuration_hash};
use singletrack_record::replace;

use super::{BenchArgs, LiveBench};
use crate::Result;

/// A procedure.
#[derive(Clone, Copy)]
pub struct Procedure {
    /// Its name, such as `doctor`: that of its files.
    pub name: &'static str,
    /// Its command, after `singletrack`.
    pub command: &'static str,
    /// Whether `arm` requires it: its results are reported to the daemon.
    pub required: bool,
    /// Why a car of this configuration can't go through it, whatever the steps find.
    pub refuses: fn(&Config) -> Option<String>,
    /// What it does, in one sentence.
    pub about: &'static str,
    /// Its steps.
    pub steps: &'static [Step],
    /// What to do after it.
    pub next: &'static str,
}

/// The exit status of a procedure with a step that failed.
const FAILED: u8 = 3;

/// Runs a procedure to its end and writes its page. The status is 0 if no step failed, otherwise
/// 3.
///
/// # Errors
///
/// It was interrupted, or files can't be read or written.
pub fn run(procedure: &Procedure, args: &BenchArgs) -> Result<ExitCode> {
    let reported = procedure.required.then_some(procedure.name);
    let mut bench = LiveBench::open(reported, args)?;
    if let Some(refusal) = (procedure.refuses)(&bench.config) {
        return Err(format!("can't begin: {refusal}").into());
    }
    let folder = args.state.clone();
    let folder = folder.unwrap_or_else(|| args.config.with_added_extension("commissioning"));
    let lock = lock(&folder);
    if matches!(lock, Ok(None)) {
        return Err("another procedure is running with this configuration".into());
    }
    // Before a quarter of an hour of measurements is lost.
    bench.before.rehearse(&args.config).map_err(|error| {
        format!(
            "{error}; measured values are written there: use sudo, or let the group write to the \
             configuration and its folder (docs/onboarding.md)"
        )
    })?;
    let _lock = lock.map_err(|error| {
        let folder = folder.display();
        format!("{folder}: {error}; --state takes another folder")
    })?;
    bench.pictures = folder.join(procedure.name);
    let path = folder.join(format!("{}.json", procedure.name));
    if args.again {
        remove(&path)?;
    }
    let (car_id, now) = (bench.config.board.car_id, Timestamp::now());
    let mut journal = FileJournal {
        json: args.json,
        bar: bench.terminal.bar.clone(),
        ..FileJournal::open(&path, car_id, procedure.steps, &bench.before, now)
    };
    let steps = procedure.steps.iter();
    let found: Vec<_> = steps.filter_map(|step| journal.found(step.name)).collect();
    let begins = bench.report(if found.is_empty() { "begun" } else { "resumed" });
    begins.map_err(|error| format!("can't begin: {error}"))?;
    bench.terminal.say(procedure.about);
    for finding in found {
        let Finding { step, found, .. } = finding;
        let told = format!("{step}: found before: {found}");
        bench.terminal.say(&told);
    }
    let findings = commissioning::run(procedure.steps, &mut bench, &mut journal)
        .map_err(|interrupted| format!("{interrupted}; run the same command again to resume"))?;
    let page = write_page(procedure, &bench, &folder, &findings)?;
    let (summary, shown) = (report::summary(&findings), page.display());
    let told = format!("\n{summary}\nThe page is {shown}.");
    bench.terminal.say(&told);
    let is_failed = |finding: &Finding| finding.verdict == Verdict::Failed;
    let failed = findings.iter().any(is_failed);
    bench.report(if failed { "failed" } else { "passed" })?;
    if failed {
        bench.terminal.say(&format!(
            "Correct what failed, and run `singletrack {}` again: it goes on with that step.",
            procedure.command
        ));
    } else {
        journal.close()?;
        bench.terminal.say(procedure.next);
    }
    bench.terminal.tell(&json!({
        "procedure": procedure.name,
        "failed": failed,
        "page": page,
    }))?;
    Ok(ExitCode::from(if failed { FAILED } else { 0 }))
}

/// Makes the folder and locks it until the file is closed: two procedures would write the same
/// files. None if another one has locked it.
fn lock(folder: &Path) -> io::Result<Option<File>> {
    fs::create_dir_all(folder)?;
    let file = File::create(folder.join("lock"))?;
    match file.try_lock() {
        Ok(()) => Ok(Some(file)),
        Err(TryLockError::WouldBlock) => Ok(None),
        Err(TryLockError::Error(error)) => Err(error),
    }
}

fn write_page(
    procedure: &Procedure,
    bench: &LiveBench,
    folder: &Path,
    findings: &[Finding],
) -> Result<PathBuf> {
    let now = Timestamp::now();
    let name = format!("{}-{}", procedure.name, now.strftime("%Y-%m-%dT%H%M%SZ"));
    let date = now.strftime("%Y-%m-%d %H:%M UTC").to_string();
    let configuration = configuration_hash(&bench.config).map_err(io::Error::other)?;
    let figures = dated_pictures(procedure.name, folder, &name)?;
    let about = report::About {
        procedure: procedure.name,
        date: &date,
        car_id: bench.config.board.car_id,
        configuration,
        figures: &figures,
        diff: &bench.diff()?,
    };
    let path = folder.join(format!("{name}.md"));
    replace(&path, report::page(&about, findings).as_bytes())?;
    let json = json!({
        "procedure": procedure.name,
        "time": now.to_string(),
        "car_id": about.car_id,
        "configuration": format!("{configuration:016x}"),
        "findings": findings,
    });
    let path_of_json = folder.join(format!("{name}.json"));
    replace(&path_of_json, json.to_string().as_bytes())?;
    Ok(path)
}

/// Gives the pictures of this procedure, which an earlier start may have drawn, the date of the
/// page. Returns their files and titles.
fn dated_pictures(procedure: &str, folder: &Path, dated: &str) -> Result<Vec<(String, String)>> {
    let mut pictures = Vec::new();
    for entry in fs::read_dir(folder)? {
        let file = entry?.file_name();
        let Some(name) = file
            .to_str()
            .and_then(|file| file.strip_prefix(procedure)?.strip_prefix('-'))
            .and_then(|rest| rest.strip_suffix(".svg"))
            // Those of earlier pages begin with a date.
            .filter(|name| !name.starts_with(|first: char| first.is_ascii_digit()))
        else {
            continue;
        };
        let new = format!("{dated}-{name}.svg");
        fs::rename(folder.join(&file), folder.join(&new))?;
        pictures.push((new, name.to_owned()));
    }
    pictures.sort();
    Ok(pictures)
}

/// Age after which a finding is found again: the car may have been changed.
const VALID: SignedDuration = SignedDuration::from_hours(24);

/// A file with the findings of a procedure that is under way, from one start to the next; prints what
/// is begun and found, while the bench has the terminal.
struct FileJournal {
    path: PathBuf,
    car_id: u16,
    entries: Vec<Entry>,
    json: bool,
    /// That of the bench.
    bar: ProgressBar,
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
        let finding = &self.finding;
        let age = now.duration_since(self.time);
        let mut keys = finding.parameters.iter().filter_map(|it| it.key.as_ref());
        steps.iter().any(|known| known.name == finding.step)
            && finding.verdict != Verdict::Failed
            && age < VALID
            && !age.is_negative()
            && keys.all(|(key, value)| configuration.has(key, value))
    }
}

impl FileJournal {
    /// The findings of this car that still hold.
    fn open(
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
            json: false,
            bar: ProgressBar::hidden(),
        }
    }

    fn keep_at(&mut self, finding: &Finding, time: Timestamp) -> io::Result<()> {
        self.entries
            .retain(|entry| entry.finding.step != finding.step);
        let finding = finding.clone();
        self.entries.push(Entry { time, finding });
        let json = json!({ "car_id": self.car_id, "entries": self.entries });
        replace(&self.path, json.to_string().as_bytes())
    }

    fn print(&self, finding: &Finding) {
        self.bar.finish_and_clear();
        eprintln!("{}: {}", finding.verdict.name(), finding.found);
        if matches!(finding.verdict, Verdict::Failed | Verdict::Warning) {
            eprintln!("  should be: {}", finding.expected);
            if !finding.fix.is_empty() {
                eprintln!("  to do: {}", finding.fix);
            }
        }
        for parameter in &finding.parameters {
            eprintln!("  {}", report::line(parameter));
        }
        if self.json {
            println!("{}", json!(finding));
        }
    }

    /// The procedure has run to its end: the next one begins with its first step.
    fn close(&self) -> io::Result<()> {
        remove(&self.path)
    }
}

impl Journal for FileJournal {
    fn found(&self, step: &str) -> Option<Finding> {
        let mut findings = self.entries.iter().map(|entry| &entry.finding);
        findings.find(|finding| finding.step == step).cloned()
    }

    fn keep(&mut self, finding: &Finding) -> Result<(), Interrupted> {
        self.print(finding);
        self.keep_at(finding, Timestamp::now())
            .map_err(|error| Interrupted::NotKept(error.to_string()))
    }

    fn begin(&mut self, step: &Step, number: usize, of: usize) {
        self.bar.finish_and_clear();
        eprintln!("\n[{number}/{of}] {}", step.title);
        if self.json {
            let begun = json!({ "step": step.name, "number": number, "of": of });
            println!("{begun}");
        }
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
    let entries = entries.filter_map(|entry| Entry::deserialize(entry).ok());
    Some(entries.collect())
}

/// Removes the file of a journal, if there is one.
fn remove(path: &Path) -> io::Result<()> {
    match fs::remove_file(path) {
        Err(error) if error.kind() != io::ErrorKind::NotFound => Err(error),
        _ => Ok(()),
    }
}

/// Options of `singletrack doctor`.
#[derive(Clone, Debug, Args)]
pub struct DoctorArgs {
    #[command(flatten)]
    /// Those of every procedure.
    pub bench: BenchArgs,
    /// Measure the IMU's noise with the wheels turning, on a stand, and nothing else
    #[arg(long)]
    stand: bool,
}

impl DoctorArgs {
    /// The procedure that is asked for.
    pub const fn procedure(&self) -> &'static Procedure {
        if self.stand { &ON_STAND } else { &DOCTOR }
    }
}

/// What can be found about a car that does not drive.
const DOCTOR: Procedure = Procedure {
    name: "doctor",
    command: "doctor",
    required: true,
    refuses: |_| None,
    about: "The doctor moves nothing: the car stays disarmed, and your hands move it where that \
            is needed. It takes about 15 minutes. Ctrl-C interrupts it; the same command resumes \
            it.",
    steps: &doctor::STEPS,
    next: "Next: singletrack bring-up, with the wheels off the floor.",
};

/// How much the IMU vibrates with turning wheels.
const ON_STAND: Procedure = Procedure {
    name: "imu-on-stand",
    command: "doctor --stand",
    required: false,
    about: "The doctor turns the motor: the car stands on a stand in view of the cameras, with all \
            wheels off the floor, and your hand is on the supply of the ESC. It moves only while \
            you hold the space bar, and it takes about three minutes.",
    steps: &doctor::STAND_STEPS,
    next: "The floor shakes more than a stand: compare `noise` of `singletrack judge` after a drive.",
    ..DOCTOR
};

/// Servo and motor of a car whose wheels are off the floor.
pub const BRING_UP: Procedure = Procedure {
    name: "bring-up",
    command: "bring-up",
    about: "The bring-up turns servo and motor: the car stands on a stand in view of the cameras, \
            with all wheels off the floor, and your hand is on the supply of the ESC. It moves \
            only while you hold the space bar, and it takes about 40 minutes. Ctrl-C interrupts \
            it; the same command resumes it.",
    steps: bring_up::STEPS,
    next: "Next: singletrack calibrate, on the floor.",
    ..DOCTOR
};

/// What only the floor shows about a car.
pub const CALIBRATE: Procedure = Procedure {
    name: "calibrate",
    command: "calibrate",
    refuses: calibrate::lacks_room,
    about: "The calibration drives: the car stands on the free floor, nobody is inside the \
            geofence, and it moves only while you hold the space bar. It begins with 0.3 m/s, and \
            takes about 15 minutes. Ctrl-C interrupts it; the same command resumes it.",
    steps: &calibrate::STEPS,
    next: "The car is ready to be armed: singletrack arm.",
    ..DOCTOR
};

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
        journal.keep_at(&finding("first"), now).unwrap();
        journal.keep_at(&finding("first"), now).unwrap();

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
        journal.keep_at(&finding("first"), now).unwrap();
        let failed = Finding {
            verdict: Verdict::Failed,
            ..finding("second")
        };
        journal.keep_at(&failed, now).unwrap();
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

    #[test]
    fn a_folder_is_locked_for_one_procedure_at_a_time() {
        let parent = tempfile::tempdir().unwrap();
        let folder = parent.path().join("car.toml.commissioning");
        let first = lock(&folder).unwrap();
        assert!(first.is_some());
        assert!(lock(&folder).unwrap().is_none());
        drop(first);
        assert!(lock(&folder).unwrap().is_some());
        // A file is in the way.
        assert!(lock(&folder.join("lock")).is_err());
    }
}
