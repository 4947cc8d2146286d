//! Running programs.

use std::{
    fmt, io,
    path::Path,
    process::{Child, Command, Stdio},
};

/// Failure of a command of the project.
#[derive(Debug)]
pub(crate) enum Failure {
    /// A check failed, or could not be made.
    Failed(String),
    /// Checks in real time were no checks, because the machine was busy.
    NotValid(String),
}

/// The exit status of [`Failure::NotValid`], by which programs that check in real time report it, too:
/// `EX_TEMPFAIL` of `sysexits.h`.
pub(crate) const NOT_VALID: u8 = 75;

pub(crate) type Result<T = (), E = Failure> = std::result::Result<T, E>;

impl fmt::Display for Failure {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (Self::Failed(text) | Self::NotValid(text)) = self;
        formatter.write_str(text)
    }
}

/// A [`Failure`] with a message, as of `format!`.
macro_rules! failure {
    ($($message:tt)*) => {
        $crate::process::Failure::Failed(format!($($message)*))
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
pub(crate) trait At<T> {
    fn at(self, path: &Path) -> Result<T>;
}

impl<T> At<T> for io::Result<T> {
    fn at(self, path: &Path) -> Result<T> {
        self.map_err(|error| failure!("{}: {error}", path.display()))
    }
}

/// A command without blanks in its words; further arguments may follow.
pub(crate) fn command(line: &str) -> Command {
    let mut words = line.split(' ');
    let mut command = Command::new(words.next().unwrap_or_default());
    command.args(words);
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
    Err(match output.status.code() {
        Some(code) if code == i32::from(NOT_VALID) => Failure::NotValid(text),
        _ => Failure::Failed(text),
    })
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
        assert!(matches!(end(NOT_VALID), Err(Failure::NotValid(_))));
        assert!(matches!(end(1), Err(Failure::Failed(_))));
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
