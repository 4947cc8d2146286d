//! `singletrack arm`: arms the car and attends the drive.
//!
//! By default this program is the dead-man switch: it renews the drive ten times a second, and
//! the car stops when it ends, however it ends.

use std::{
    io::{self, Write as _},
    path::PathBuf,
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
pub(crate) const CTRL_C: &str = "(Ctrl-C stops the car)";

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
    let mut drive = Drive::connect(&args.control, interrupt, "the drive", RENEWAL)?;
    let (attendance, renewal) = match args.time {
        None => (Attendance::Hold, Request::Hold {}),
        Some(_) => (Attendance::Timed, Request::Status {}),
    };
    drive.held.connection.send(&args.request(attendance))?;
    drive.attend(None, || Ok(Some((renewal.clone(), CTRL_C.to_owned()))))
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

/// A connection that attends a drive, and what a terminal shows of it.
pub(crate) struct Drive {
    pub(crate) held: HeldDrive,
    socket: PathBuf,
    interrupt: Interrupt,
    /// Names the drive in the message about its end.
    what: &'static str,
    bar: ProgressBar,
}

impl Drive {
    /// Connects, for a renewal at every `interval`.
    pub(crate) fn connect(
        args: &ControlArgs,
        interrupt: Interrupt,
        what: &'static str,
        interval: Duration,
    ) -> Result<Self> {
        Ok(Self {
            held: HeldDrive::new(Connection::open(&args.socket, PATIENCE)?, interval),
            socket: args.socket.clone(),
            interrupt,
            what,
            bar: progress_bar(0, "{prefix}  {msg}").with_prefix("mode arming"),
        })
    }

    /// Sends the renewal that `renewal` gives at every interval until the drive has ended, and shows
    /// its text with the mode. Ctrl-C disarms the car, as does the end of this time after it was
    /// armed, or no renewal; and the end is still waited for.
    pub(crate) fn attend(
        &mut self,
        time: Option<Duration>,
        mut renewal: impl FnMut() -> Result<Option<(Request, String)>>,
    ) -> Result<ExitCode> {
        let begun = Instant::now();
        let mut armed: Option<Instant> = None;
        let (mut is_disarmed, mut is_let_go) = (false, false);
        loop {
            let is_over = |(armed, time): (Instant, Duration)| armed.elapsed() >= time;
            let is_over_time = armed.zip(time).is_some_and(is_over);
            if (self.interrupt.is_raised() || is_over_time || is_let_go) && !is_disarmed {
                is_disarmed = true;
                // On a connection of its own: this one may wait for the board to arm.
                ask(&Request::DISARM, &self.socket)?;
            }
            if self.held.is_due() {
                match renewal()? {
                    Some((renewal, note)) => {
                        self.held.connection.send(&renewal)?;
                        self.bar.set_message(note);
                    }
                    None => is_let_go = true,
                }
            }
            let Some(line) = self.held.connection.receive_within(WAIT)? else {
                continue;
            };
            let (mode, reason, time_s) = match line {
                Reply::Ended { ended, .. } => return self.end(&ended, begun),
                Reply::Drive { drive, .. } => (drive.mode, drive.reason, drive.drive_time_s),
                answer => {
                    let answer = answer.agreed()?;
                    let Some(status) = answer.status else {
                        if armed.is_none() {
                            self.bar.suspend(|| warn(&answer.warnings));
                            armed = Some(Instant::now());
                        }
                        continue;
                    };
                    // A timed drive is asked for its status: the daemon does not report its changes.
                    let Some(state) = status.state.filter(|_| armed.is_some()) else {
                        continue;
                    };
                    let (mode, reason) = (state.mode, state.reason);
                    if matches!(&*mode, "idle" | "ready" | "disconnected" | "fault") {
                        return self.end(&Ended { mode, reason }, begun);
                    }
                    (mode, reason, state.drive_time_s)
                }
            };
            let time = time_s.map(|time_s| format!(" {time_s:5.1} s"));
            let state = Ended { mode, reason }.to_string();
            self.bar.set_prefix(state + &time.unwrap_or_default());
        }
    }

    /// Prints how the drive ended, and chooses the exit status.
    fn end(&self, ended: &Ended, begun: Instant) -> Result<ExitCode> {
        self.bar.finish_and_clear();
        let (what, time_s) = (self.what, begun.elapsed().as_secs_f64());
        print(&format!("{what} has ended after {time_s:.1} s: {ended}"))?;
        let as_wanted = is_wanted(ended);
        if let Some(word) = ended.reason.as_deref().filter(|_| !as_wanted) {
            // What the board says about it, if the daemon still answers.
            let status = ask_within(&Request::Status {}, &self.socket, PATIENCE).ok();
            print(&match status.and_then(|answer| answer.status) {
                Some(status) => Why::explain(word, &status).to_string(),
                None => Why::of_word("host", word).to_string(),
            })?;
        }
        Ok(ended_as_wanted(as_wanted))
    }
}

/// Prints what the daemon warns of, above the line that shows the drive.
pub(crate) fn warn(warnings: &[String]) {
    for warning in warnings {
        // A terminal that has gone takes no output.
        let _ = writeln!(io::stderr(), "singletrack: warning: {warning}");
    }
}

pub(crate) fn parse_time(text: &str) -> Result<Duration, String> {
    duration_within(text, 0.5, 86_400.0)
}
