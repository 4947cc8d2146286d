//! `singletrack status`: what the daemon does now, for a person or for programs.

#[cfg(test)]
mod tests;

use std::{
    io::{self, Write as _},
    iter,
    path::Path,
    time::{Duration, Instant},
};

use clap::Args;
use serde_json::Value;
use singletrack_api::{
    Answer, Calibration, ClientError, Connection, Reply, Request, State, Status, ask, ask_as,
};
use singletrack_core::reasons::Why;

use crate::{
    Result,
    help::wrap,
    interrupt::Interrupt,
    operator::{
        control::{ControlArgs, in_words, print},
        terminal::Screen,
    },
};

/// Options of `singletrack status`.
#[derive(Clone, Debug, Args)]
pub struct StatusArgs {
    #[command(flatten)]
    control: ControlArgs,
    /// Print the whole status as JSON, for programs
    #[arg(long, conflicts_with = "watch")]
    json: bool,
    /// Show the status until q or Ctrl-C is pressed, renewed ten times a second; without a
    /// terminal, print a line a second
    #[arg(long)]
    watch: bool,
}

/// The longest wait for the answer.
const PATIENCE: Duration = Duration::from_secs(5);

/// Prints the status. A closed pipe is no error.
///
/// # Errors
///
/// When the daemon can't be asked, or refuses.
pub fn run(args: &StatusArgs) -> Result<()> {
    let socket = &args.control.socket;
    if args.watch {
        return watch(socket);
    }
    if args.json {
        // As the daemon wrote it, which may be newer than this program.
        let mut answer: Value = ask_as(&Request::Status {}, socket, PATIENCE)?;
        let status = answer.get_mut("status").map(Value::take);
        return print(&serde_json::to_string_pretty(&status.unwrap_or(answer))?);
    }
    let status = ask(&Request::Status {}, socket)?.status;
    print(&status.map_or_else(|| UNKNOWN.to_owned(), |status| Summary(status).line()))
}

/// The line for an answer that has no status.
const UNKNOWN: &str = "; pose none, battery unknown, link unknown, speed unknown";

/// Interval of the pictures on a terminal, and of the lines elsewhere.
const PICTURE: Duration = Duration::from_millis(100);
const LINE: Duration = Duration::from_secs(1);
/// Interval of the questions for what a state does not have, such as the battery.
const QUESTION: Duration = Duration::from_millis(500);
/// The longest wait for a state, so that a key and Ctrl-C are not late.
const WAIT: Duration = Duration::from_millis(20);
/// Silence of the stream from which on it is shown: 50 ticks.
const SILENCE: Duration = Duration::from_millis(500);

/// The daemon's status, kept up to date over two connections.
struct Feed {
    states: Connection,
    questions: Connection,
    summary: Summary,
    asked: Instant,
    is_answered: bool,
    heard: Instant,
}

impl Feed {
    fn open(socket: &Path) -> Result<Self> {
        let status = ask(&Request::Status {}, socket)?.status;
        let missing = || ClientError::NoAnswer("an answer without a status".to_owned());
        Ok(Self {
            states: Connection::watch_states(socket, PATIENCE)?,
            questions: Connection::open(socket, PATIENCE)?,
            summary: status.map(Summary).ok_or_else(missing)?,
            asked: Instant::now(),
            is_answered: true,
            heard: Instant::now(),
        })
    }

    /// Takes what has come, and waits a little if nothing has.
    fn renew(&mut self) -> Result<()> {
        if let Some(answer) = self.questions.receive::<Answer>()? {
            if let Some(status) = answer.agreed()?.status {
                self.summary.take_status(status);
            }
            self.is_answered = true;
        }
        if self.is_answered && self.asked.elapsed() >= QUESTION {
            self.questions.send(&Request::Status {})?;
            self.asked = Instant::now();
            self.is_answered = false;
        }
        match self.states.receive_within(WAIT)? {
            Some(Reply::State(state)) => {
                self.heard = Instant::now();
                self.summary.0.state = Some(*state);
            }
            // The stream begins.
            Some(Reply::Answer(answer)) => drop(answer.agreed()?),
            _ => {}
        }
        Ok(())
    }

    fn line(&self) -> String {
        let silence = self.silence();
        let silence = silence.map(|silence| format!(" ({silence})"));
        self.summary.line() + &silence.unwrap_or_default()
    }

    fn picture(&self, socket: &Path) -> Vec<String> {
        let (columns, _) = Screen::size();
        let title = format!("singletrackd at {}  (q ends)", socket.display());
        let mut lines = vec![title, String::new()];
        lines.extend(self.summary.lines(columns));
        if let Some(silence) = self.silence() {
            lines.extend([String::new(), silence]);
        }
        lines
    }

    /// How long the daemon has been silent, if it is.
    fn silence(&self) -> Option<String> {
        let silence = self.heard.elapsed();
        let seconds = silence.as_secs_f64();
        (silence >= SILENCE).then(|| format!("no tick of the daemon for {seconds:.1} s"))
    }
}

/// Shows the status until Ctrl-C: as a picture on a terminal, which `q` ends as well, and in lines
/// elsewhere.
fn watch(socket: &Path) -> Result<()> {
    let interrupt = Interrupt::listen()?;
    let mut feed = Feed::open(socket)?;
    let screen = Screen::open()?;
    let interval = if screen.is_some() { PICTURE } else { LINE };
    let mut shown: Option<Instant> = None;
    while !interrupt.is_raised() {
        if let Some(screen) = &screen
            && screen.has_key(b'q')?
        {
            break;
        }
        feed.renew()?;
        if shown.is_some_and(|shown| shown.elapsed() < interval) {
            continue;
        }
        shown = Some(Instant::now());
        match &screen {
            Some(screen) => screen.draw(&feed.picture(socket))?,
            None => match writeln!(io::stdout(), "{}", feed.line()) {
                Err(error) if error.kind() == io::ErrorKind::BrokenPipe => return Ok(()),
                written => written?,
            },
        }
    }
    match screen {
        Some(screen) => {
            drop(screen);
            print(&feed.summary.line())
        }
        None => Ok(()),
    }
}

/// Columns of the names in the view.
const NAMES: usize = 10;
/// Columns of the first value beside a name.
const VALUES: usize = 18;

/// The last answer to `status`, with the newest state, in words.
struct Summary(Status);

impl Summary {
    /// Takes an answer to `status`, except its state: that of the stream is newer.
    fn take_status(&mut self, status: Status) {
        self.0 = Status {
            state: self.0.state.take().or(status.state),
            ..status
        };
    }

    /// The status as one line.
    fn line(&self) -> String {
        let why = Why::of(&self.0);
        let mut line = self.0.mode().to_owned();
        if let Some(time_s) = self.value(|state| state.drive_time_s) {
            line += &format!(" {time_s:.1} s");
        }
        if let Some(why) = &why {
            line += &format!(": {}", why.text);
        }
        if let Some(trouble) = self.0.record_trouble() {
            line += &format!("; {trouble}");
        }
        line += &format!(
            "; pose {}, battery {}, link {}, speed {}",
            age(self.value(|state| state.pose_age_s)),
            self.battery(),
            self.link(),
            self.speed(),
        );
        for (name, text) in self.more("calibration") {
            if let Some(text) = text {
                line += &format!("; {name}: {text}");
            }
        }
        if let Some(advice) = why.and_then(|why| why.advice) {
            line += &format!(". To do: {advice}");
        }
        line
    }

    /// The status as lines no wider than `columns`.
    fn lines(&self, columns: usize) -> Vec<String> {
        let why = Why::of(&self.0);
        let status = &self.0;
        let mut lines = Vec::new();
        let time = self.value(|state| state.drive_time_s);
        let time = time.map(|time_s| format!("{time_s:.1} s"));
        lines.push(field("mode", status.mode(), &time.unwrap_or_default()));
        // Above all else: what is below the window is not seen.
        if let Some(why) = why {
            lines.extend(paragraph(columns, "why", &why.text));
            let advice = why.advice.as_deref().unwrap_or("-");
            lines.extend(paragraph(columns, "to do", advice));
        }
        if let Some(trouble) = status.record_trouble() {
            lines.extend(paragraph(columns, "record", &trouble));
        }
        let pose = age(self.value(|state| state.pose_age_s));
        lines.push(field("pose", &pose, &self.place()));
        let commanded = metres_per_second(self.value(|state| Some(state.commanded_speed_m_s)));
        let commanded = format!("commanded {commanded}");
        lines.push(field("speed", &self.speed(), &commanded));
        let steering = self.value(|state| Some(state.steering_rad.to_degrees()));
        lines.push(field("steering", &with_unit(steering, 1, "degrees"), ""));
        lines.push(field("P", &self.error(), ""));
        let telemetry = format!("telemetry {}", age(self.value(|state| state.board_age_s)));
        lines.push(field("link", self.link(), &telemetry));
        lines.push(field("battery", &self.battery(), ""));
        for (name, text) in self.more("advice") {
            if let Some(text) = text {
                lines.extend(paragraph(columns, name, &text));
            }
        }
        lines
    }

    /// Tuned values, what the drives say of the calibration, and what live calibration corrects, each with
    /// its name; `drives` is that of the second.
    fn more(&self, drives: &'static str) -> [(&'static str, Option<String>); 3] {
        let calibration = self.0.calibration.as_ref();
        let advice = calibration.and_then(Calibration::line);
        [
            ("tuned", self.tuned()),
            (drives, advice),
            ("learned", self.learned()),
        ]
    }

    /// Tuned values that differ from the configuration, and those of the configuration.
    fn tuned(&self) -> Option<String> {
        let tunable = self.0.tuning.as_ref().filter(|it| it.differs)?;
        let tuning = self.0.state.as_ref()?.tuning()?;
        let [tuned, was] = [&tuning, &tunable.configured].map(in_words);
        Some(format!("{tuned} (configured: {was})"))
    }

    /// What live calibration corrects, such as "steering gain -12.5 %"; only what is not nothing.
    fn learned(&self) -> Option<String> {
        let learned = self.0.learned?;
        let [forward, left] = learned.pivot_m;
        let corrections = [
            ("steering gain", 1e2 * learned.steering_gain, "%"),
            ("trim", 1e3 * learned.steering_trim_rad, "mrad"),
            ("stamps", 1e3 * learned.stamp_offset_s, "ms"),
            ("body yaw", 1e3 * learned.body_yaw_rad, "mrad"),
            ("pivot forward", 1e3 * forward, "mm"),
            ("pivot left", 1e3 * left, "mm"),
        ];
        let shown = corrections
            .into_iter()
            .filter(|(_, value, _)| *value != 0.0);
        let shown = shown.map(|(name, value, unit)| format!("{name} {value:+.1} {unit}"));
        Some(match shown.collect::<Vec<_>>().as_slice() {
            [] => "nothing yet".to_owned(),
            shown => shown.join(", "),
        })
    }

    /// A value of the newest state.
    fn value<T>(&self, of: impl FnOnce(&State) -> Option<T>) -> Option<T> {
        self.0.state.as_ref().and_then(of)
    }

    fn speed(&self) -> String {
        metres_per_second(self.value(|state| state.speed_m_s))
    }

    fn link(&self) -> &str {
        let state = self.0.state.as_ref();
        state.map_or("unknown", |state| &state.link)
    }

    fn battery(&self) -> String {
        let board = self.0.board.as_ref();
        let battery_mv = board.and_then(|board| board.battery_mv);
        with_unit(battery_mv.map(|mv| f64::from(mv) / 1_000.0), 2, "V")
    }

    fn place(&self) -> String {
        let place = |state: &State| Some((state.x_m?, state.y_m?, state.yaw_rad?));
        let Some((x_m, y_m, yaw_rad)) = self.value(place) else {
            return String::new();
        };
        let yaw = with_unit(Some(yaw_rad.to_degrees()), 0, "degrees");
        format!("at ({x_m:.2}, {y_m:.2}) m, yaw {yaw}")
    }

    /// How far P is from its reference.
    fn error(&self) -> String {
        let both = |state: &State| state.point_m.zip(state.reference_m);
        let Some(([x_m, y_m], [reference_x_m, reference_y_m])) = self.value(both) else {
            return "-".to_owned();
        };
        let error_m = libm::hypot(x_m - reference_x_m, y_m - reference_y_m);
        format!("{:.0} mm from its reference", error_m * 1_000.0)
    }
}

/// A line that begins with a name.
fn field(name: &str, first: &str, second: &str) -> String {
    let text = format!("{name:<NAMES$}{first:<VALUES$}{second}");
    text.trim_end().to_owned()
}

/// Lines of which the first begins with a name.
fn paragraph(columns: usize, name: &str, text: &str) -> Vec<String> {
    let names = iter::once(name).chain(iter::repeat(""));
    let parts = names.zip(wrap(text, columns.saturating_sub(NAMES)));
    let lines = parts.map(|(name, part)| format!("{name:<NAMES$}{part}"));
    lines.collect()
}

fn with_unit(value: Option<f64>, digits: usize, unit: &str) -> String {
    value.map_or_else(
        || "unknown".to_owned(),
        |value| {
            let text = format!("{value:.digits$}");
            // Noise around zero is not reverse.
            let is_zero = !text.contains(|digit| matches!(digit, '1'..='9'));
            let text = text.strip_prefix('-').filter(|_| is_zero).unwrap_or(&text);
            format!("{text} {unit}")
        },
    )
}

fn metres_per_second(speed_m_s: Option<f64>) -> String {
    with_unit(speed_m_s, 2, "m/s")
}

/// An age; none of what has never come.
fn age(age_s: Option<f64>) -> String {
    match age_s {
        None => "none".to_owned(),
        Some(age_s) if age_s < 1.0 => format!("{:.0} ms old", age_s * 1_000.0),
        Some(age_s) => format!("{age_s:.1} s old"),
    }
}
