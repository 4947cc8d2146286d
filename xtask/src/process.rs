//! Running programs.

use std::{
    ffi::OsStr,
    fmt, io,
    path::Path,
    process::{Child, Command, Stdio},
};

/// Failure of a command of the project: a check failed or could not be made, or it was [`NOT_VALID`].
#[derive(Debug)]
pub(crate) struct Failure {
    pub(crate) text: String,
    /// The exit status.
    pub(crate) status: u8,
}

/// The exit status of checks in real time that were no checks, because the machine was busy, by which
/// programs that check in real time report it, too: `EX_TEMPFAIL` of `sysexits.h`.
pub(crate) const NOT_VALID: u8 = 75;

pub(crate) type Result<T = (), E = Failure> = std::result::Result<T, E>;

impl fmt::Display for Failure {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(&self.text)
    }
}

/// A [`Failure`] with a message, as of `format!`.
macro_rules! failure {
    ($($message:tt)*) => {
        $crate::process::Failure { text: format!($($message)*), status: 1 }
    };
}
pub(crate) use failure;

/// Returns a [`failure!`] if a condition does not hold.
macro_rules! require {
    ($condition:expr, $($message:tt)*) => {
        if !$condition {
            return Err($crate::process::failure!($($message)*));
        }
    };
}
pub(crate) use require;

/// Names the file of an error of the operating system.
pub(crate) fn at(path: &Path) -> impl Fn(io::Error) -> Failure {
    move |error| failure!("{}: {error}", path.display())
}

/// A command without blanks in its words; further arguments may follow.
pub(crate) fn command(line: &str) -> Command {
    let (name, arguments) = line.split_once(' ').unwrap_or((line, ""));
    program(name, arguments)
}

/// A program with arguments without blanks; further ones may follow.
pub(crate) fn program(path: impl AsRef<OsStr>, arguments: &str) -> Command {
    let mut command = Command::new(path);
    command.args(arguments.split_whitespace());
    command
}

/// Runs a command with inherited output.
pub(crate) fn check(command: &mut Command) -> Result {
    run(command, false).map(drop)
}

/// Runs a command and returns its output.
pub(crate) fn output(command: &mut Command) -> Result<Vec<u8>> {
    run(command.stdout(Stdio::piped()), false)
}

/// Runs a command and returns its output, which is text.
pub(crate) fn text(command: &mut Command) -> Result<String> {
    Ok(String::from_utf8_lossy(&output(command)?).into_owned())
}

/// Runs a command, and shows its output only if it fails.
pub(crate) fn silent(command: &mut Command) -> Result {
    run(command.stdout(Stdio::piped()).stderr(Stdio::piped()), true).map(drop)
}

/// Runs a command and returns what it writes to a pipe. If it is to be shown, the failure ends with what
/// the command has written.
fn run(command: &mut Command, is_shown: bool) -> Result<Vec<u8>> {
    let child = command.stdin(Stdio::null()).spawn();
    let output = child
        .and_then(Child::wait_with_output)
        .map_err(|error| failure!("{} does not start: {error}", text_of(command)))?;
    if output.status.success() {
        return Ok(output.stdout);
    }
    let mut text = format!("{}: {}", text_of(command), output.status);
    if is_shown {
        let written = [b"\n", &output.stdout[..], &output.stderr].concat();
        text += &String::from_utf8_lossy(&written);
    }
    let is_valid = output.status.code() != Some(NOT_VALID.into());
    let status = if is_valid { 1 } else { NOT_VALID };
    Err(Failure { text, status })
}

/// A command as text, without its environment.
fn text_of(command: &Command) -> String {
    let program = Path::new(command.get_program());
    let name = program.file_name().unwrap_or(program.as_os_str());
    let words = [name].into_iter().chain(command.get_args());
    let words: Vec<_> = words.map(|word| word.to_string_lossy()).collect();
    words.join(" ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_failed_command_is_reported_as_typed() {
        let mut command = Command::new("/bin/sh");
        command.env("A", "B").args(["-c", "exit 3"]);
        assert_eq!(
            check(&mut command).unwrap_err().to_string(),
            "sh -c exit 3: exit status: 3"
        );
    }

    #[test]
    fn a_check_on_a_busy_machine_is_not_valid() {
        let end =
            |status: u8| check(Command::new("/bin/sh").args(["-c", &format!("exit {status}")]));
        assert_eq!(end(NOT_VALID).unwrap_err().status, NOT_VALID);
        assert_eq!(end(2).unwrap_err().status, 1);
    }

    #[test]
    fn a_missing_program_is_reported() {
        let error = output(&mut Command::new("no-such-program"))
            .unwrap_err()
            .to_string();
        assert!(
            error.starts_with("no-such-program does not start"),
            "{error}"
        );
    }

    #[test]
    fn the_output_of_a_silent_command_is_shown_on_failure() {
        let run = |script: &str| silent(Command::new("/bin/sh").args(["-c", script]));
        assert!(run("echo much").is_ok());
        let failure = run("echo this is why; exit 3").unwrap_err().to_string();
        assert!(failure.contains("exit status: 3"), "{failure}");
        assert!(failure.ends_with("this is why\n"), "{failure}");
    }
}
