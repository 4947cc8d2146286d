//! `singletrack doctor|bring-up|calibrate`, from the parts to the first drive: steps, findings, page.

use std::{
    error::Error,
    fs::{self, File, TryLockError},
    io,
    path::{Path, PathBuf},
    process::ExitCode,
};

use clap::Args;
use indicatif::ProgressBar;
use jiff::Timestamp;
use serde_json::json;
use singletrack_commissioning::{
    self as commissioning, Finding, Interrupted, Journal, Step, Verdict, bring_up, calibrate,
    doctor, report,
};
use singletrack_core::{Config, configuration_hash};
use singletrack_record::replace;

use super::{
    BenchArgs, LiveBench,
    journal::{self, FileJournal},
};

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
pub fn run(procedure: &Procedure, args: &BenchArgs) -> Result<ExitCode, Box<dyn Error>> {
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
        journal::remove(&path)?;
    }
    let mut journal = SessionJournal {
        file: FileJournal::open(
            &path,
            bench.config.board.car_id,
            procedure.steps,
            &bench.before,
            Timestamp::now(),
        ),
        json: args.json,
        bar: bench.terminal.bar.clone(),
    };
    let steps = procedure.steps.iter();
    let found: Vec<_> = steps
        .filter_map(|step| journal.file.found(step.name))
        .collect();
    let begins = bench.report(if found.is_empty() { "begun" } else { "resumed" });
    begins.map_err(|error| format!("can't begin: {error}"))?;
    bench.terminal.say(procedure.about);
    for finding in found {
        let Finding { step, found, .. } = finding;
        bench
            .terminal
            .say(&format!("{step}: found before: {found}"));
    }
    let findings = commissioning::run(procedure.steps, &mut bench, &mut journal)
        .map_err(|interrupted| format!("{interrupted}; run the same command again to resume"))?;
    let page = write_page(procedure, &bench, &folder, &findings)?;
    bench.terminal.say(&format!(
        "\n{}\nThe page is {}.",
        report::summary(&findings),
        page.display()
    ));
    let failed = findings
        .iter()
        .any(|finding| finding.verdict == Verdict::Failed);
    bench.report(if failed { "failed" } else { "passed" })?;
    if failed {
        bench.terminal.say(&format!(
            "Correct what failed, and run `singletrack {}` again: it goes on with that step.",
            procedure.command
        ));
    } else {
        journal.file.close()?;
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
) -> Result<PathBuf, Box<dyn Error>> {
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
    replace(
        &folder.join(format!("{name}.json")),
        json.to_string().as_bytes(),
    )?;
    Ok(path)
}

/// Gives the pictures of this procedure, which an earlier start may have drawn, the date of the
/// page. Returns their files and titles.
fn dated_pictures(
    procedure: &str,
    folder: &Path,
    dated: &str,
) -> Result<Vec<(String, String)>, Box<dyn Error>> {
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

/// Prints what is begun and found, while the bench has the terminal, and keeps it.
struct SessionJournal {
    file: FileJournal,
    json: bool,
    /// That of the bench.
    bar: ProgressBar,
}

impl Journal for SessionJournal {
    fn found(&self, step: &str) -> Option<Finding> {
        self.file.found(step)
    }

    fn keep(&mut self, finding: &Finding) -> Result<(), Interrupted> {
        self.print(finding);
        self.file
            .keep(finding, Timestamp::now())
            .map_err(|error| Interrupted::NotKept(error.to_string()))
    }

    fn begin(&mut self, step: &Step, number: usize, of: usize) {
        self.bar.finish_and_clear();
        eprintln!("\n[{number}/{of}] {}", step.title);
        if self.json {
            println!(
                "{}",
                json!({ "step": step.name, "number": number, "of": of })
            );
        }
    }
}

impl SessionJournal {
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

/// A procedure that needs no floor.
const fn nothing(_: &Config) -> Option<String> {
    None
}

/// What can be found about a car that does not drive.
const DOCTOR: Procedure = Procedure {
    name: "doctor",
    command: "doctor",
    required: true,
    refuses: nothing,
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
    refuses: nothing,
    about: "The doctor turns the motor: the car stands on a stand in view of the cameras, with all \
            wheels off the floor, and your hand is on the supply of the ESC. It moves only while \
            you hold the space bar, and it takes about three minutes.",
    steps: &doctor::STAND_STEPS,
    next: "The floor shakes more than a stand: compare `noise` of `singletrack judge` after a drive.",
};

/// Servo and motor of a car whose wheels are off the floor.
pub const BRING_UP: Procedure = Procedure {
    name: "bring-up",
    command: "bring-up",
    required: true,
    refuses: nothing,
    about: "The bring-up turns servo and motor: the car stands on a stand in view of the cameras, \
            with all wheels off the floor, and your hand is on the supply of the ESC. It moves \
            only while you hold the space bar, and it takes about 40 minutes. Ctrl-C interrupts \
            it; the same command resumes it.",
    steps: bring_up::STEPS,
    next: "Next: singletrack calibrate, on the floor.",
};

/// What only the floor shows about a car.
pub const CALIBRATE: Procedure = Procedure {
    name: "calibrate",
    command: "calibrate",
    required: true,
    refuses: calibrate::lacks_room,
    about: "The calibration drives: the car stands on the free floor, nobody is inside the \
            geofence, and it moves only while you hold the space bar. It begins with 0.3 m/s, and \
            takes about 15 minutes. Ctrl-C interrupts it; the same command resumes it.",
    steps: &calibrate::STEPS,
    next: "The car is ready to be armed: singletrack arm.",
};

#[cfg(test)]
mod tests {
    use super::*;

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
