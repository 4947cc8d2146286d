//! The terminal: raw keys, a screen that is drawn over, and the wait for input.

use std::{
    env,
    io::{self, IsTerminal as _, Write as _},
    os::fd::{AsFd as _, BorrowedFd},
    time::Duration,
};

use rustix::{
    event::{PollFd, PollFlags, Timespec, poll},
    io::Errno,
    termios::{
        LocalModes, OptionalActions, QueueSelector, Termios, tcflush, tcgetattr, tcgetwinsize,
        tcsetattr,
    },
};

/// Waits until one of the inputs has something to read, or its end, for `patience` at most, which is
/// less than a second. Whether one has.
pub(crate) fn wait_to_read<const N: usize>(
    inputs: [BorrowedFd<'_>; N],
    patience: Duration,
) -> io::Result<bool> {
    let mut polled = inputs.map(|input| PollFd::from_borrowed_fd(input, PollFlags::IN));
    let patience = Timespec {
        tv_sec: 0,
        tv_nsec: patience.subsec_nanos().into(),
    };
    match poll(&mut polled, Some(&patience)) {
        Ok(ready) => Ok(ready > 0),
        Err(Errno::INTR) => Ok(false),
        Err(error) => Err(error.into()),
    }
}

/// Adds what has been typed, or has come through a pipe, to `bytes`; does not wait.
///
/// # Errors
///
/// It can't be read, or has ended: [`io::ErrorKind::UnexpectedEof`].
pub(crate) fn read_now(bytes: &mut Vec<u8>) -> io::Result<()> {
    let input = io::stdin();
    if !wait_to_read([input.as_fd()], Duration::ZERO)? {
        return Ok(());
    }
    let mut buffer = [0; 1_024];
    match rustix::io::read(&input, &mut buffer) {
        Ok(0) => {
            let gone = "the terminal is gone";
            Err(io::Error::new(io::ErrorKind::UnexpectedEof, gone))
        }
        Ok(count) => {
            bytes.extend(buffer.iter().take(count));
            Ok(())
        }
        Err(Errno::INTR | Errno::AGAIN) => Ok(()),
        Err(error) => Err(error.into()),
    }
}

/// A terminal that gives every key at once. Dropping it restores its settings. What was typed before
/// either is dropped.
pub(crate) struct RawTerminal {
    input: io::Stdin,
    before: Termios,
}

impl RawTerminal {
    /// Takes over standard input; none if it is not a terminal.
    pub(crate) fn open() -> io::Result<Option<Self>> {
        let input = io::stdin();
        if !input.is_terminal() {
            return Ok(None);
        }
        let before = tcgetattr(&input)?;
        let mut raw = before.clone();
        // Ctrl-C still interrupts.
        raw.local_modes -= LocalModes::ICANON | LocalModes::ECHO;
        set(&input, &raw)?;
        Ok(Some(Self { input, before }))
    }
}

impl Drop for RawTerminal {
    fn drop(&mut self) {
        let _ = set(&self.input, &self.before);
    }
}

/// Sets it at once and not after its output: one that is stopped must not hold up the end of a drive.
fn set(input: &io::Stdin, settings: &Termios) -> io::Result<()> {
    tcsetattr(input, OptionalActions::Now, settings)?;
    Ok(tcflush(input, QueueSelector::IFlush)?)
}

/// The whole window of the terminal on standard output, for a view that is drawn again and
/// again. Dropping it brings back what was there before.
pub(crate) struct Screen {
    keys: Option<RawTerminal>,
}

/// Another screen than that of the shell, without a cursor; and back.
const ENTER: &str = "\x1b[?1049h\x1b[?25l";
const LEAVE: &str = "\x1b[?25h\x1b[?1049l";

impl Screen {
    /// Takes over standard output; none if it is not a terminal that can move its cursor.
    pub(crate) fn open() -> io::Result<Option<Self>> {
        let is_dumb = env::var_os("TERM").is_none_or(|term| term.is_empty() || term == "dumb");
        if is_dumb || !io::stdout().is_terminal() {
            return Ok(None);
        }
        let screen = Self {
            keys: RawTerminal::open()?,
        };
        put(ENTER)?;
        Ok(Some(screen))
    }

    /// Columns and rows.
    pub(crate) fn size() -> (usize, usize) {
        let size = tcgetwinsize(io::stdout()).ok();
        let size = size.map(|size| (usize::from(size.ws_col), usize::from(size.ws_row)));
        let known = size.filter(|(columns, rows)| *columns > 0 && *rows > 0);
        known.unwrap_or((80, 24))
    }

    /// Draws these lines over those of before. What finds no room is left out.
    pub(crate) fn draw(&self, lines: &[String]) -> io::Result<()> {
        let (columns, rows) = Self::size();
        let mut text = String::from("\x1b[H");
        for (index, line) in lines.iter().take(rows).enumerate() {
            if index > 0 {
                text.push_str("\r\n");
            }
            text.extend(line.chars().take(columns));
            text.push_str("\x1b[K");
        }
        text.push_str("\x1b[J");
        put(&text)
    }

    /// Whether this key has been pressed since the last call.
    pub(crate) fn has_key(&self, key: u8) -> io::Result<bool> {
        if self.keys.is_none() {
            return Ok(false);
        }
        let mut typed = Vec::new();
        read_now(&mut typed)?;
        Ok(typed.contains(&key))
    }
}

impl Drop for Screen {
    fn drop(&mut self) {
        // A terminal that has gone takes no output.
        let _ = put(LEAVE);
    }
}

fn put(text: &str) -> io::Result<()> {
    let mut output = io::stdout().lock();
    output.write_all(text.as_bytes())?;
    output.flush()
}
