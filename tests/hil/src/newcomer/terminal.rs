//! A program in a pseudo-terminal, and a person who reads and types there.

use std::{
    fs::OpenOptions,
    io::{self, Write as _},
    os::fd::OwnedFd,
    path::Path,
    process::{Child, Command, ExitStatus, Stdio},
    time::{Duration, Instant},
};

use rustix::{
    fs::{OFlags, fcntl_setfl},
    io::Errno,
    process::{Pid, Signal, kill_process},
    pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt},
};

use crate::{Failure, Outcome};

/// The end of a question.
const PROMPT: &str = ", or s to skip] ";

/// Interval of the presses of a key that is held.
const REPEAT: Duration = Duration::from_millis(40);

/// What Ctrl-C is.
const INTERRUPT: &[u8] = b"\x03";

/// A program that runs in a terminal of its own. Dropping it kills the program.
#[derive(Debug)]
pub struct Terminal {
    /// The person's side.
    screen: OwnedFd,
    program: Child,
    /// What was printed, without control sequences and lines that were printed over.
    text: String,
    /// The next character is printed at the begin of the line.
    has_returned: bool,
    /// How many bytes were printed.
    printed: usize,
    /// How much of it was acted on.
    read: usize,
    /// The end of a control sequence is still to come.
    escape: Escape,
    /// When the space bar was last pressed, while it is held.
    held: Option<Instant>,
}

/// A control sequence that is being read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Escape {
    None,
    Begun,
    Parameters,
}

impl Terminal {
    /// Starts a program.
    ///
    /// # Errors
    ///
    /// The system's errors.
    pub fn start(program: &Path, arguments: &[String]) -> Outcome<Self> {
        let terminal = |error: Errno| Failure::system("can't open a pseudo-terminal")(error.into());
        let screen = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY | OpenptFlags::CLOEXEC)
            .map_err(terminal)?;
        grantpt(&screen).map_err(terminal)?;
        unlockpt(&screen).map_err(terminal)?;
        fcntl_setfl(&screen, OFlags::NONBLOCK).map_err(terminal)?;
        let name = ptsname(&screen, Vec::new()).map_err(terminal)?;
        let name = name.to_string_lossy().into_owned();
        let input = OpenOptions::new()
            .read(true)
            .write(true)
            .open(&name)
            .map_err(Failure::system("can't open a pseudo-terminal"))?;
        let share = || {
            input
                .try_clone()
                .map(Stdio::from)
                .map_err(Failure::system("can't share a pseudo-terminal"))
        };
        let (output, errors) = (share()?, share()?);
        // It becomes the program, in a session whose terminal this is: Ctrl-C is a signal.
        let program = Command::new("setsid")
            .arg("--ctty")
            .arg(program)
            .args(arguments)
            .stdin(Stdio::from(input))
            .stdout(output)
            .stderr(errors)
            .spawn()
            .map_err(Failure::system("can't run setsid"))?;
        Ok(Self {
            screen,
            program,
            text: String::new(),
            has_returned: false,
            printed: 0,
            read: 0,
            escape: Escape::None,
            held: None,
        })
    }

    /// What has been printed so far.
    pub fn text(&self) -> &str {
        &self.text
    }

    /// What of such a text will not be printed over: whole lines, and a question.
    pub fn finished(text: &str) -> &str {
        if text.ends_with(PROMPT) {
            return text;
        }
        text.get(..text.rfind('\n').map_or(0, |end| end + 1))
            .unwrap_or_default()
    }

    /// How many bytes have been printed so far.
    pub const fn printed(&self) -> usize {
        self.printed
    }

    /// The end of what was printed, for the report of a failure.
    pub fn last(&self) -> String {
        let count = self.text.chars().count();
        self.text
            .chars()
            .skip(count.saturating_sub(2_000))
            .collect()
    }

    /// Reads what was printed meanwhile, and presses the space bar if it is held.
    ///
    /// # Errors
    ///
    /// The system's errors.
    pub fn look(&mut self) -> Outcome {
        let mut buffer = [0; 4_096];
        loop {
            match rustix::io::read(&self.screen, &mut buffer) {
                Ok(0) | Err(Errno::AGAIN | Errno::INTR) => break,
                // The program has ended.
                Err(Errno::IO) => break,
                Ok(count) => self.take(buffer.get(..count).unwrap_or_default()),
                Err(error) => return Err(Failure::system("can't read the terminal")(error.into())),
            }
        }
        let new = self.text.get(self.read..).unwrap_or_default();
        let (hold, release) = (
            new.rfind("Hold the space bar"),
            new.rfind("Let go of the space bar"),
        );
        if let Some(last) = hold.max(release) {
            // A question may come right behind it.
            self.read += last + 1;
            self.held = (hold > release).then(|| self.held.unwrap_or_else(Instant::now));
        }
        if self.held.is_some_and(|last| last.elapsed() >= REPEAT) {
            self.held = Some(Instant::now());
            self.type_bytes(b" ")?;
        }
        Ok(())
    }

    fn take(&mut self, bytes: &[u8]) {
        self.printed += bytes.len();
        for character in String::from_utf8_lossy(bytes).chars() {
            self.escape = match (self.escape, character) {
                (Escape::None, '\x1b') => Escape::Begun,
                (Escape::None, '\r') => {
                    self.has_returned = true;
                    Escape::None
                }
                (Escape::None, character) => {
                    self.put(character);
                    Escape::None
                }
                (Escape::Begun, '[') => Escape::Parameters,
                (Escape::Parameters, character) if !character.is_ascii_alphabetic() => {
                    Escape::Parameters
                }
                // The line is erased, from its begin.
                (Escape::Parameters, 'K') if self.has_returned => {
                    self.erase_line();
                    Escape::None
                }
                _ => Escape::None,
            };
        }
    }

    fn put(&mut self, character: char) {
        if self.has_returned && character != '\n' {
            self.erase_line();
        }
        self.has_returned = false;
        self.text.push(character);
    }

    fn erase_line(&mut self) {
        let line = self.text.rfind('\n').map_or(0, |end| end + 1);
        self.text.truncate(line);
        self.read = self.read.min(line);
    }

    /// The text of the question that waits for an answer.
    pub fn question(&self) -> Option<&str> {
        let new = self.text.get(self.read..)?;
        let (text, _) = new.strip_suffix(PROMPT)?.rsplit_once('\n')?;
        text.lines().last()
    }

    /// Types an answer.
    ///
    /// # Errors
    ///
    /// The system's errors.
    pub fn answer(&mut self, line: &str) -> Outcome {
        self.read = self.text.len();
        self.type_bytes(format!("{line}\n").as_bytes())
    }

    /// Types Ctrl-C.
    ///
    /// # Errors
    ///
    /// The system's errors.
    pub fn interrupt(&mut self) -> Outcome {
        self.held = None;
        self.type_bytes(INTERRUPT)
    }

    /// Lets the space bar go.
    pub const fn let_go(&mut self) {
        self.held = None;
    }

    /// Kills the program (SIGKILL), and does not wait for its end.
    ///
    /// # Errors
    ///
    /// The system's errors.
    pub fn kill(&mut self) -> Outcome {
        self.held = None;
        kill_process(Pid::from_child(&self.program), Signal::KILL)
            .map_err(|error| Failure::system("can't kill the program")(error.into()))
    }

    /// The program's exit status, if it has ended.
    ///
    /// # Errors
    ///
    /// The system's errors.
    pub fn status(&mut self) -> Outcome<Option<ExitStatus>> {
        self.program
            .try_wait()
            .map_err(Failure::system("no state of the program"))
    }

    fn type_bytes(&mut self, bytes: &[u8]) -> Outcome {
        let mut screen = io::BufWriter::with_capacity(0, Screen(&self.screen));
        screen
            .write_all(bytes)
            .map_err(Failure::system("can't type"))
    }
}

impl Drop for Terminal {
    fn drop(&mut self) {
        let _ = self.program.kill();
        let _ = self.program.wait();
    }
}

/// The person's side, to type on.
struct Screen<'a>(&'a OwnedFd);

impl io::Write for Screen<'_> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        Ok(rustix::io::write(self.0, bytes)?)
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test may fail")]
mod tests {
    use super::*;

    #[test]
    fn a_live_line_that_is_erased_is_neither_read_nor_shown() {
        let script = r"printf 'one\n10 %% of it\r\033[2K11 %% of it all\r\033[2K\nBegin?\n[y, or s to skip] '";
        let arguments = ["-c", script].map(str::to_owned);
        let mut terminal = Terminal::start(Path::new("sh"), &arguments).unwrap();
        while terminal.status().unwrap().is_none() {
            std::thread::sleep(REPEAT);
        }
        terminal.look().unwrap();
        assert_eq!(terminal.text(), "one\n\nBegin?\n[y, or s to skip] ");
        assert_eq!(terminal.question(), Some("Begin?"));
        let shown = |text| Terminal::finished(text);
        assert_eq!(shown(terminal.text()), terminal.text());
        assert_eq!(shown("one\n10 % of it"), "one\n");
        assert_eq!(shown("10 % of it"), "");
    }
}
