//! `singletrack status`: what the daemon does now, for a person or for programs.

mod summary;

use std::{
    io::{self, Write as _},
    path::Path,
    time::{Duration, Instant},
};

use clap::Args;
use serde_json::Value;
use singletrack_api::{Answer, ClientError, Connection, Reply, Request, ask, ask_as};
use summary::Summary;

use crate::{
    Result,
    interrupt::Interrupt,
    operator::{
        control::{ControlArgs, print},
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
    print(&status.map_or_else(|| UNKNOWN.to_owned(), |status| Summary::of(status).line()))
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
            summary: status.map(Summary::of).ok_or_else(missing)?,
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
                self.summary.take_state(*state);
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
    let mut screen = Screen::open()?;
    let interval = if screen.is_some() { PICTURE } else { LINE };
    let mut shown: Option<Instant> = None;
    while !interrupt.is_raised() {
        if let Some(screen) = &mut screen
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
