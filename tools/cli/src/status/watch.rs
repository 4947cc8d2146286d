//! The status again and again, from the state stream.

use std::{
    io::{self, Write as _},
    path::Path,
    time::{Duration, Instant},
};

use serde_json::{Value, json};
use singletrack_client::Connection;
use singletrackd::SOCKET_VERSION;

use super::{Summary, question};
use crate::{
    control::{ControlError, agreed},
    interrupt::Interrupt,
    terminal::Screen,
};

/// Interval of the pictures on a terminal, and of the lines elsewhere.
const PICTURE: Duration = Duration::from_millis(100);
const LINE: Duration = Duration::from_secs(1);
/// Interval of the questions for what a state does not have, such as the battery.
const QUESTION: Duration = Duration::from_millis(500);
/// The longest wait for a state, so that a key and Ctrl-C are not late.
const WAIT: Duration = Duration::from_millis(20);
/// The longest wait for a daemon that does not read or answer.
const PATIENCE: Duration = Duration::from_secs(5);
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
    fn open(socket: &Path) -> Result<Self, ControlError> {
        let mut questions = Connection::open(socket, PATIENCE)?;
        questions.send(&question())?;
        let answer = questions
            .receive_within(PATIENCE)?
            .ok_or_else(|| io::Error::from(io::ErrorKind::TimedOut))?;
        let answer = agreed(answer)?;
        let mut states = Connection::open(socket, PATIENCE)?;
        states.send(&json!({
            "version": SOCKET_VERSION,
            "command": "watch",
            "topics": ["state"],
        }))?;
        Ok(Self {
            states,
            questions,
            summary: Summary::of(answer.get("status").unwrap_or(&Value::Null)),
            asked: Instant::now(),
            is_answered: true,
            heard: Instant::now(),
        })
    }

    /// Takes what has come, and waits a little if nothing has.
    fn renew(&mut self) -> Result<(), ControlError> {
        if let Some(answer) = self.questions.receive()? {
            let answer = agreed(answer)?;
            self.summary
                .take_status(answer.get("status").unwrap_or(&Value::Null));
            self.is_answered = true;
        }
        if self.is_answered && self.asked.elapsed() >= QUESTION {
            self.questions.send(&question())?;
            self.asked = Instant::now();
            self.is_answered = false;
        }
        let Some(line) = self.states.receive_within(WAIT)? else {
            return Ok(());
        };
        if line.get("ok").is_some() {
            // The stream begins.
            agreed(line)?;
        } else if line.get("topic").and_then(Value::as_str) == Some("state") {
            self.heard = Instant::now();
            self.summary.take_state(&line);
        }
        Ok(())
    }

    /// How long no tick has come, if that is long.
    fn silence_s(&self) -> Option<f64> {
        let silence = self.heard.elapsed();
        (silence >= SILENCE).then_some(silence.as_secs_f64())
    }
}

/// Shows the status until q or Ctrl-C is pressed.
///
/// # Errors
///
/// When the daemon can't be reached, or ends.
pub(super) fn run(socket: &Path) -> Result<(), ControlError> {
    let interrupt = Interrupt::listen()?;
    let mut feed = Feed::open(socket)?;
    match Screen::open()? {
        Some(screen) => {
            draw(&interrupt, &mut feed, screen, socket)?;
            // The picture is gone with its screen.
            super::print(&feed.summary.line())
        }
        None => print_lines(&interrupt, &mut feed),
    }
}

fn draw(
    interrupt: &Interrupt,
    feed: &mut Feed,
    mut screen: Screen,
    socket: &Path,
) -> Result<(), ControlError> {
    let mut drawn: Option<Instant> = None;
    while !interrupt.is_raised() && !screen.has_key(b'q')? {
        feed.renew()?;
        if drawn.is_some_and(|drawn| drawn.elapsed() < PICTURE) {
            continue;
        }
        drawn = Some(Instant::now());
        let (columns, _) = Screen::size();
        let mut lines = vec![
            format!("singletrackd at {}  (q ends)", socket.display()),
            String::new(),
        ];
        lines.extend(feed.summary.lines(columns));
        if let Some(silence_s) = feed.silence_s() {
            lines.push(String::new());
            lines.push(format!("no tick of the daemon for {silence_s:.1} s"));
        }
        screen.draw(&lines)?;
    }
    Ok(())
}

fn print_lines(interrupt: &Interrupt, feed: &mut Feed) -> Result<(), ControlError> {
    let mut printed: Option<Instant> = None;
    while !interrupt.is_raised() {
        feed.renew()?;
        if printed.is_some_and(|printed| printed.elapsed() < LINE) {
            continue;
        }
        printed = Some(Instant::now());
        let mut line = feed.summary.line();
        if let Some(silence_s) = feed.silence_s() {
            line += &format!(" (no tick of the daemon for {silence_s:.1} s)");
        }
        let mut output = io::stdout().lock();
        match writeln!(output, "{line}").and_then(|()| output.flush()) {
            Ok(()) => {}
            Err(error) if error.kind() == io::ErrorKind::BrokenPipe => return Ok(()),
            Err(error) => return Err(ControlError::Output(error)),
        }
    }
    Ok(())
}
