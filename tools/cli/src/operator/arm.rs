//! `singletrack arm`: arms the car and attends the drive.
//!
//! By default this program is the dead-man switch: it renews the drive ten times a second, and
//! the car stops when it ends, however it ends.

use std::{
    io::{self, Write as _},
    path::{Path, PathBuf},
    process::ExitCode,
    time::{Duration, Instant},
};

use clap::Args;
use indicatif::ProgressBar;
use singletrack_api::{
    Arm, Attendance, Connection, Ended, HeldDrive, RENEWAL, Reply, Request, ask, ask_within,
};
use singletrack_core::reasons::Why;

use crate::operator::control::{ControlArgs, print};
use crate::{Result, arguments::duration_within, interrupt::Interrupt, progress::progress_bar};

/// Options of `singletrack arm`.
#[derive(Clone, Debug, Args)]
pub struct ArmArgs {
    #[command(flatten)]
    control: ControlArgs,
    /// Hold the drive (the default): it ends when this command ends, with Ctrl-C or any other
    /// way
    #[arg(long, conflicts_with_all = ["time", "unattended"])]
    hold: bool,
    /// Drive for this time, such as 60s, and stop; also if this command ends
    #[arg(long = "for", value_name = "DURATION", value_parser = parse_time)]
    time: Option<Duration>,
    /// Arm and return: the drive is unattended and continues until a stop
    #[arg(long, conflicts_with = "time")]
    unattended: bool,
    /// Arm also if doctor, bring-up and calibrate have not passed with this configuration on
    /// this car: it then drives with values that have not been measured on it, and can steer to
    /// the wrong side, be faster than commanded and stop later than the geofence allows
    #[arg(long)]
    uncalibrated: bool,
}

/// What `--unattended` means.
const UNATTENDED: &str = "driving unattended: the car drives on when this shell, this terminal or \
                          this network ends, until `singletrack disarm` or `singletrack stop`, or \
                          until the daemon stops it";

/// The longest wait for a line, so that renewals and Ctrl-C are not late.
const WAIT: Duration = Duration::from_millis(20);

/// The longest wait for a daemon that does not read.
const PATIENCE: Duration = Duration::from_secs(1);

/// What is shown with the mode of a drive.
const CTRL_C: &str = "(Ctrl-C stops the car)";

/// Reasons with which a drive ends as its operator wanted.
const WANTED: [&str; 3] = ["requested", "reference-finished", "time-up"];

/// Whether a drive ended as its operator wanted.
pub(crate) fn is_wanted(ended: &Ended) -> bool {
    let reason = ended.reason.as_deref();
    reason.is_none_or(|reason| WANTED.contains(&reason)) && ended.mode != "fault"
}

/// The exit status of a drive that ended as wanted, or that something else than the operator stopped.
pub(crate) fn ended_as_wanted(is_so: bool) -> ExitCode {
    ExitCode::from(if is_so { 0 } else { 3 })
}

/// Arms the car. With `--hold` or `--for`, returns when the drive has ended: with success if it
/// ended as wanted, otherwise with status 3.
///
/// # Errors
///
/// When the car can't be armed, or the connection is lost; the reason is the daemon's.
pub fn run(args: &ArmArgs) -> Result<ExitCode> {
    if args.unattended {
        let answer = ask(&args.request(Attendance::Unattended), &args.control.socket)?;
        warn(&answer.warnings);
        print(UNATTENDED)?;
        return Ok(ExitCode::SUCCESS);
    }
    let interrupt = Interrupt::listen()?;
    let mut drive = Drive::connect(&args.control, "the drive", RENEWAL)?;
    let (attendance, renewal) = match args.time {
        None => (Attendance::Hold, Request::Hold {}),
        Some(_) => (Attendance::Timed, Request::Status {}),
    };
    drive.held.connection.send(&args.request(attendance))?;
    drive.attend(&interrupt, &renewal, None)
}

impl ArmArgs {
    fn request(&self, attendance: Attendance) -> Request {
        Request::Arm(Arm {
            attendance: Some(attendance),
            for_s: self.time.map(|time| time.as_secs_f64()),
            uncalibrated: self.uncalibrated,
            ..Arm::default()
        })
    }
}

/// A connection that attends a drive.
pub(crate) struct Drive {
    pub(crate) held: HeldDrive,
    progress: Progress,
    socket: PathBuf,
}

impl Drive {
    /// `what` names the drive in the message about its end.
    pub(crate) fn connect(
        args: &ControlArgs,
        what: &'static str,
        interval: Duration,
    ) -> Result<Self> {
        Ok(Self {
            held: HeldDrive::new(Connection::open(&args.socket, PATIENCE)?, interval),
            progress: Progress::new(what),
            socket: args.socket.clone(),
        })
    }

    /// Sends `renewal` at every interval until the drive has ended. Ctrl-C disarms the car, as
    /// does the end of this time after it was armed, and the end is still waited for.
    pub(crate) fn attend(
        &mut self,
        interrupt: &Interrupt,
        renewal: &Request,
        time: Option<Duration>,
    ) -> Result<ExitCode> {
        self.attend_with(interrupt, time, || {
            Ok(Some((renewal.clone(), CTRL_C.to_owned())))
        })
    }

    /// Attends the drive with the renewal that `renewal` gives at every interval, and what to show with the mode; `None` disarms the car, as Ctrl-C does.
    pub(crate) fn attend_with(
        &mut self,
        interrupt: &Interrupt,
        time: Option<Duration>,
        mut renewal: impl FnMut() -> Result<Option<(Request, String)>>,
    ) -> Result<ExitCode> {
        let begun = Instant::now();
        let mut armed: Option<Instant> = None;
        let mut is_disarmed = false;
        let mut is_let_go = false;
        loop {
            let is_over_time = armed
                .zip(time)
                .is_some_and(|(armed, time)| armed.elapsed() >= time);
            if (interrupt.is_raised() || is_over_time || is_let_go) && !is_disarmed {
                is_disarmed = true;
                // On a connection of its own: this one may wait for the board to arm.
                ask(&Request::DISARM, &self.socket)?;
            }
            if self.held.is_due() {
                match renewal()? {
                    Some((renewal, note)) => {
                        self.held.connection.send(&renewal)?;
                        self.progress.bar.set_message(note);
                    }
                    None => is_let_go = true,
                }
            }
            let Some(line) = self.held.connection.receive_within(WAIT)? else {
                continue;
            };
            let answer = match line {
                Reply::Ended { ended, .. } => {
                    return self.progress.end(&ended, begun, &self.socket);
                }
                Reply::Drive { drive, .. } => {
                    let (mode, reason) = (drive.mode, drive.reason);
                    let state = Ended { mode, reason };
                    self.progress.show(&state, drive.drive_time_s);
                    continue;
                }
                answer => answer.agreed()?,
            };
            match answer.status {
                // Of a timed drive, which the daemon does not report.
                Some(status) => {
                    let Some(state) = status.state.filter(|_| armed.is_some()) else {
                        continue;
                    };
                    let (mode, reason) = (state.mode, state.reason);
                    let ended = Ended { mode, reason };
                    if is_over(&ended.mode) {
                        return self.progress.end(&ended, begun, &self.socket);
                    }
                    self.progress.show(&ended, state.drive_time_s);
                }
                None if armed.is_none() => {
                    self.progress.bar.suspend(|| warn(&answer.warnings));
                    armed = Some(Instant::now());
                }
                None => {}
            }
        }
    }
}

/// Prints what the daemon warns of, above the line that shows the drive.
pub(crate) fn warn(warnings: &[String]) {
    for warning in warnings {
        // A terminal that has gone takes no output.
        let _ = writeln!(io::stderr(), "singletrack: warning: {warning}");
    }
}

/// Whether a mode is one of a car that does not drive.
fn is_over(mode: &str) -> bool {
    matches!(mode, "idle" | "ready" | "disconnected" | "fault")
}

/// Shows on a terminal how the drive goes on.
struct Progress {
    what: &'static str,
    bar: ProgressBar,
}

impl Progress {
    fn new(what: &'static str) -> Self {
        Self {
            what,
            bar: progress_bar(0, "{prefix}  {msg}").with_prefix("mode arming"),
        }
    }

    /// Shows how the drive goes on.
    fn show(&self, state: &Ended, drive_time_s: Option<f64>) {
        let time = drive_time_s.map(|time_s| format!(" {time_s:5.1} s"));
        self.bar
            .set_prefix(state.to_string() + &time.unwrap_or_default());
    }

    /// Prints how the drive ended, and chooses the exit status.
    fn end(&self, ended: &Ended, begun: Instant, socket: &Path) -> Result<ExitCode> {
        self.bar.finish_and_clear();
        print(&format!(
            "{} has ended after {:.1} s: {}",
            self.what,
            begun.elapsed().as_secs_f64(),
            ended
        ))?;
        let as_wanted = is_wanted(ended);
        if let Some(word) = ended.reason.as_deref().filter(|_| !as_wanted) {
            // What the board says about it, if the daemon still answers.
            let status = ask_within(&Request::Status {}, socket, PATIENCE).ok();
            print(&match status.and_then(|answer| answer.status) {
                Some(status) => Why::explain(word, &status).to_string(),
                None => Why::of_word("host", word).to_string(),
            })?;
        }
        Ok(ended_as_wanted(as_wanted))
    }
}

pub(crate) fn parse_time(text: &str) -> Result<Duration, String> {
    duration_within(text, 0.5, 86_400.0)
}
