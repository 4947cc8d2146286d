//! A car behind the daemon, a person at the terminal, and pictures of measurements: what the procedures `doctor`,
//! `bring-up` and `calibrate` run on.

mod held;
mod session;
mod terminal;

use std::{
    io,
    path::PathBuf,
    thread,
    time::{Duration, Instant},
};

use clap::Args;
use jiff::Timestamp;
use serde_json::json;
use singletrack_api::{ClientError, Code, Request, Setpoint, ask};
use singletrack_commissioning::{
    Answer, Attendance, Bench, Interrupted, Jog, Observation, Plot, PlotKind, Question, Refused,
    edit::{Edit, EditError},
};
use singletrack_control::{Position, Velocity};
use singletrack_core::Config;
use singletrack_figures::figure::{Axis, Column, Curve, Figure, Look, Panel};
use singletrack_record::{Entry, LinkPhase, Topic};

use crate::{
    Result,
    arguments::ConfiguredSocket,
    interrupt::Interrupt,
    operator::entries::{Entries, Heard},
};
use held::BenchDrive;
use terminal::Terminal;

pub use session::{BRING_UP, CALIBRATE, DoctorArgs, Procedure, run};

/// The longest wait for a daemon that does not read.
const PATIENCE: Duration = Duration::from_secs(1);

/// Options of the procedures.
#[derive(Clone, Debug, Args)]
pub struct BenchArgs {
    #[command(flatten)]
    control: ConfiguredSocket,
    /// The daemon's configuration file; measured values are written to it
    #[arg(long, value_name = "FILE")]
    #[arg(default_value = "/etc/singletrackd/singletrackd.toml")]
    config: PathBuf,
    /// Folder of the page with the findings, and of what is needed to resume
    /// [default: FILE.commissioning beside the configuration]
    #[arg(long, value_name = "DIR")]
    state: Option<PathBuf>,
    /// Begin also if the procedures before it have not passed with this configuration on this car:
    /// the car then moves with values that have not been measured on it
    #[arg(long)]
    uncalibrated: bool,
    /// Begin with the first step, also if a procedure was interrupted less than a day ago
    #[arg(long)]
    again: bool,
    /// Print questions, findings and changes on standard output, one JSON object a line
    #[arg(long)]
    json: bool,
}

/// Time without a line from the daemon after which it counts as gone. It reports every tick.
const SILENCE: Duration = Duration::from_secs(2);

/// The longest wait for a line, so that renewals and Ctrl-C are not late.
const WAIT: Duration = Duration::from_millis(20);

/// Time until a request that was refused is tried again.
const AGAIN: Duration = Duration::from_millis(300);

/// The topics that are watched.
const TOPICS: [Topic; 4] = [Topic::Tick, Topic::Telemetry, Topic::Status, Topic::Pose];

/// The longest wait for an answer of the daemon.
const ANSWER: Duration = Duration::from_secs(5);

/// A car behind the daemon, with an operator at the terminal.
pub(crate) struct LiveBench {
    /// The name under which the daemon keeps the results of the procedure, if `arm` requires it.
    reported: Option<&'static str>,
    /// Whether it begins without the procedures before it.
    uncalibrated: bool,
    socket: PathBuf,
    path: PathBuf,
    config: Config,
    entries: Entries,
    heard: Instant,
    is_linked: Option<bool>,
    drive: Option<BenchDrive>,
    /// The reference in force is another than that of the file.
    has_reference: bool,
    terminal: Terminal,
    interrupt: Interrupt,
    /// The text of the configuration at the start, for the page.
    before: Edit,
    /// The text of the configuration now.
    known: Edit,
    /// Begin of the paths of pictures.
    pictures: PathBuf,
    /// Why the procedure can't go on.
    interrupted: Option<Interrupted>,
}

impl LiveBench {
    /// # Errors
    ///
    /// The configuration can't be read, or the daemon can't be reached.
    pub(crate) fn open(reported: Option<&'static str>, args: &BenchArgs) -> Result<Self> {
        let config = Config::read(&args.config)?;
        let before = Edit::read(&args.config)?;
        let interrupt = Interrupt::listen()?;
        let socket = args.control.or(config.socket.path.clone());
        Ok(Self {
            reported,
            uncalibrated: args.uncalibrated,
            entries: Entries::watch(&socket, TOPICS.to_vec())?,
            socket,
            path: args.config.clone(),
            config,
            heard: Instant::now(),
            is_linked: None,
            drive: None,
            has_reference: false,
            terminal: Terminal::new(args.json),
            interrupt,
            known: before.clone(),
            before,
            pictures: PathBuf::new(),
            interrupted: None,
        })
    }

    /// Waits for an entry of the watched topics, renews the drive and looks for Ctrl-C.
    fn pump(&mut self) -> Result<Option<Entry>, Interrupted> {
        let pumped = self.try_pump();
        pumped.inspect_err(|interrupted| self.interrupted = Some(interrupted.clone()))
    }

    fn try_pump(&mut self) -> Result<Option<Entry>, Interrupted> {
        if self.interrupt.is_raised() {
            return Err(Interrupted::ByOperator);
        }
        self.renew();
        let next = self.entries.next(WAIT);
        let next = next.map_err(|error| Interrupted::DaemonGone(error.to_string()))?;
        if next.is_some() {
            self.heard = Instant::now();
        } else if self.heard.elapsed() > SILENCE {
            let why = format!("nothing for {} s", SILENCE.as_secs());
            return Err(Interrupted::DaemonGone(why));
        }
        Ok(match next {
            Some(Heard::Entry(entry)) => Some(*entry),
            // What was missed is not observed.
            Some(Heard::Missed(_)) | None => None,
        })
    }

    /// Puts a question and waits for its answer; `watched` is whether the daemon must be there
    /// meanwhile.
    fn ask_of(&mut self, question: &Question, watched: bool) -> Result<Answer, Interrupted> {
        let ended = |error: io::Error| match error.kind() {
            io::ErrorKind::UnexpectedEof => Interrupted::ByOperator,
            _ => Interrupted::NotKept(error.to_string()),
        };
        self.terminal.put(question).map_err(ended)?;
        loop {
            if let Some(answer) = self.terminal.answer(question).map_err(ended)? {
                return Ok(answer);
            }
            if watched {
                // What is observed meanwhile is lost.
                self.pump()?;
            } else if self.interrupt.is_raised() {
                return Err(Interrupted::ByOperator);
            } else {
                thread::sleep(WAIT);
            }
        }
    }

    /// What has changed in the configuration's file since the start, as a unified diff.
    pub(super) fn diff(&self) -> Result<String, EditError> {
        let now = Edit::read(&self.path)?;
        let name = self.path.display().to_string();
        Ok(self.before.until(&now).diff(&name))
    }

    /// Reports to the daemon what becomes of a procedure that `arm` requires.
    pub(super) fn report(&self, result: &str) -> Result<(), ClientError> {
        let Some(procedure) = self.reported else {
            return Ok(());
        };
        let request = Request::Commissioned {
            procedure: procedure.to_owned(),
            result: result.to_owned(),
            uncalibrated: self.uncalibrated,
        };
        ask(&request, &self.socket).map(drop)
    }

    /// Writes new values to the file and prints what changes. Gives the change for taking it
    /// back, or none if there is none.
    fn write(&mut self, values: &[(&str, toml_edit::Value)]) -> Result<Option<Edit>, EditError> {
        let mut edit = Edit::read(&self.path)?;
        if edit.text() != self.known.text() {
            // What was measured may not hold with what somebody else has changed.
            let why = "it was changed by somebody else meanwhile";
            return Err(EditError::of(&self.path)(why));
        }
        for (key, value) in values {
            edit.set(key, value)?;
        }
        let date = Timestamp::now().strftime("%Y-%m-%dT%H%M%SZ").to_string();
        let Some(kept) = edit.write(&self.path, &date)? else {
            return Ok(None);
        };
        let diff = edit.diff(&self.path.display().to_string());
        self.terminal
            .say(&format!("{diff}The old file is {}.", kept.display()));
        let told = json!({ "changed": diff, "kept": kept });
        let _ = self.terminal.tell(&told);
        Ok(Some(edit))
    }

    /// Has the daemon read its file again. What takes a restart is done by the operator.
    fn reload(&mut self) -> Result<(), Refused> {
        match ask(&Request::Reload {}, &self.socket) {
            Ok(_) => Ok(()),
            Err(ClientError::Refused(refused)) if refused.code == Code::NeedsRestart => {
                self.restart()
            }
            Err(error) => Err(Refused::because(error)),
        }
    }

    /// Asks the operator to restart the daemon, until it is there again.
    fn restart(&mut self) -> Result<(), Refused> {
        let question = Question::begin(
            "restart-daemon",
            "These values take a restart of the daemon: sudo systemctl restart \
                   singletrackd. Press Enter when that is done.",
        );
        match self.ask_of(&question, false).map_err(Refused::because)? {
            Answer::Skip => return Err(Refused("the daemon was not restarted".to_owned())),
            _ => self.terminal.say("Waiting for the daemon..."),
        }
        let asked = Instant::now();
        loop {
            match Entries::watch(&self.socket, TOPICS.to_vec()) {
                Ok(entries) => {
                    self.entries = entries;
                    self.heard = Instant::now();
                    self.is_linked = None;
                    return Ok(());
                }
                Err(_) if asked.elapsed() < ANSWER => thread::sleep(WAIT),
                Err(error) => return Err(Refused::because(error)),
            }
        }
    }
}

impl Bench for LiveBench {
    fn wait(&mut self, observed: &mut Vec<Observation>) -> Result<(), Interrupted> {
        loop {
            let Some(entry) = self.pump()? else { continue };
            let Entry::Tick(tick) = &entry else {
                observed.extend(Observation::of(&entry, &self.config.watch));
                continue;
            };
            let is_linked = tick.link == LinkPhase::Ready;
            // The first one is no change.
            if self.is_linked.replace(is_linked) == Some(!is_linked) {
                observed.push(Observation::Link(is_linked));
            }
            observed.extend(Observation::of(&entry, &self.config.watch));
            return Ok(());
        }
    }

    fn ask(&mut self, question: &Question) -> Result<Answer, Interrupted> {
        if self.terminal.holds_key() {
            // A jog that ended by itself: the terminal echoes again.
            let _ = self.disarm();
        }
        self.ask_of(question, true)
    }

    fn interrupted(&self) -> Option<Interrupted> {
        self.interrupted.clone()
    }

    fn show(&mut self, text: &str, done: f64) {
        self.terminal.show(text, done);
    }

    fn plot(&mut self, plot: &Plot) {
        let mut path = self.pictures.clone().into_os_string();
        path.push(format!("-{}.svg", plot.name));
        let path = PathBuf::from(path);
        if let Err(error) = singletrack_record::replace(&path, svg(plot).as_bytes()) {
            self.terminal
                .say(&format!("no figure {}: {error}", path.display()));
        }
    }

    fn arm(&mut self, attendance: Attendance) -> Result<(), Refused> {
        let before = self.drive.take();
        if let Some(ended) = before.and_then(|drive| drive.ended)
            && self.terminal.holds_key()
        {
            self.terminal
                .say(&format!("The car was disarmed: {ended}."));
        }
        if attendance == Attendance::Drive && !self.has_reference {
            let request = Request::SetReference {
                reference: json!({ "kind": "external", "setpoint_timeout_ms": 200 }),
            };
            ask(&request, &self.socket).map_err(Refused::because)?;
            self.has_reference = true;
        }
        self.terminal.hold_key().map_err(Refused::because)?;
        let armed = self.arm_by_key(attendance);
        if armed.is_err() {
            self.release_key();
        }
        self.drive = Some(armed?);
        Ok(())
    }

    fn jog(&mut self, jog: Jog) -> Result<(), Refused> {
        self.command_drive(&Request::Jog {
            servo_us: jog.servo_us,
            esc_us: jog.esc_us,
        })
    }

    fn drive(&mut self, velocity: Velocity, position: Option<Position>) -> Result<(), Refused> {
        self.command_drive(&Request::Setpoint(Setpoint {
            velocity_m_s: Some([velocity.x, velocity.y]),
            position_m: position.map(|position| [position.x, position.y]),
            ..Setpoint::default()
        }))
    }

    fn disarm(&mut self) -> Result<(), Refused> {
        self.release_key();
        // The connection stays until its drive has ended: its end would be another stop.
        match &mut self.drive {
            Some(drive) => drive.held.connection.send(&Request::DISARM),
            None => ask(&Request::DISARM, &self.socket).map(drop),
        }
        .map_err(Refused::because)
    }

    fn emergency_stop(&mut self) -> Result<(), Refused> {
        self.release_key();
        ask(&Request::Stop {}, &self.socket)
            .map(drop)
            .map_err(Refused::because)
    }

    fn configuration(&self) -> &Config {
        &self.config
    }

    fn change(&mut self, values: &[(&str, toml_edit::Value)]) -> Result<(), Refused> {
        let Some(edit) = self.write(values).map_err(Refused::because)? else {
            return Ok(());
        };
        if let Err(error) = self.reload() {
            // The file says what is in force.
            edit.take_back(&self.path).map_err(Refused::because)?;
            return Err(error);
        }
        self.known = edit;
        self.report("changed").map_err(Refused::because)?;
        self.config = Config::read(&self.path).map_err(Refused::because)?;
        self.has_reference = false;
        Ok(())
    }
}

impl Drop for LiveBench {
    fn drop(&mut self) {
        self.terminal.release_key();
        // Ends the drive, if the daemon has not ended it yet.
        self.drive = None;
        if self.has_reference {
            // The reference of the file is in force again, as soon as the car stands.
            let begun = Instant::now();
            while ask(&Request::Reload {}, &self.socket).is_err() && begun.elapsed() < ANSWER {
                thread::sleep(AGAIN);
            }
        }
    }
}

/// The picture as SVG.
fn svg(plot: &Plot) -> String {
    let [x, y] = plot.axes;
    let axis = |(quantity, unit)| Axis::new(quantity, None, unit);
    let mut panel = Panel::new(axis(x), axis(y));
    panel.equal = x.1 == y.1;
    panel.curves = plot
        .lines
        .iter()
        .map(|line| {
            let column =
                |index: usize| -> Column { line.points.iter().map(|point| point[index]).collect() };
            let look = match line.kind {
                PlotKind::Measured => Look::Nominal,
                PlotKind::Other => Look::Actual,
                PlotKind::Fitted => Look::Boundary,
            };
            Curve::new(line.name, look, &column(0), column(1))
        })
        .collect();
    Figure::column(plot.title, plot.title, vec![panel]).to_svg()
}

#[cfg(test)]
mod tests {
    use singletrack_commissioning::PlotLine;

    use super::*;

    #[test]
    fn a_plot_becomes_a_picture_with_its_axes_and_lines() {
        let svg = svg(&Plot {
            name: "latency",
            title: "A twist",
            axes: [("time", "s"), ("yaw rate", "rad/s")],
            lines: vec![PlotLine {
                name: "gyro",
                kind: PlotKind::Measured,
                points: vec![[0.0, 1.0], [1.0, 2.0], [f64::NAN, 0.0], [2.0, 1.0]],
            }],
        });
        for part in ["<svg", "A twist", "yaw rate", "gyro"] {
            assert!(svg.contains(part), "{part} is missing in {svg}");
        }
    }
}
