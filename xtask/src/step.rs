//! Steps of a verification: named, announced, timed.

use std::{
    fmt, io,
    path::{Path, PathBuf},
    process::{Command, Stdio},
    time::{Duration, Instant},
};

/// Why a step failed.
#[derive(Debug)]
pub(crate) struct Failure(String);

impl Failure {
    pub(crate) fn new(message: String) -> Self {
        Self(message)
    }
}

impl fmt::Display for Failure {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(&self.0)
    }
}

/// One check.
pub(crate) struct Step {
    pub(crate) name: &'static str,
    pub(crate) what: &'static str,
    run: Run,
    environment: Vec<(&'static str, &'static str)>,
}

enum Run {
    Cargo(&'static [&'static str]),
    Function(fn() -> Result<(), Failure>),
}

impl Step {
    pub(crate) fn new(
        name: &'static str,
        what: &'static str,
        run: fn() -> Result<(), Failure>,
    ) -> Self {
        Self {
            name,
            what,
            run: Run::Function(run),
            environment: Vec::new(),
        }
    }

    pub(crate) fn cargo(
        name: &'static str,
        what: &'static str,
        arguments: &'static [&'static str],
    ) -> Self {
        Self {
            name,
            what,
            run: Run::Cargo(arguments),
            environment: Vec::new(),
        }
    }

    pub(crate) fn env(mut self, key: &'static str, value: &'static str) -> Self {
        self.environment.push((key, value));
        self
    }

    /// Of a step that is cargo alone, what it is called with.
    #[cfg(test)]
    pub(crate) const fn arguments(&self) -> &'static [&'static str] {
        match self.run {
            Run::Cargo(arguments) => arguments,
            Run::Function(_) => &[],
        }
    }

    fn run(&self) -> Result<(), Failure> {
        match self.run {
            Run::Cargo(arguments) => {
                let mut command = cargo();
                command
                    .args(arguments)
                    .envs(self.environment.iter().copied());
                check(&mut command)
            }
            Run::Function(function) => function(),
        }
    }
}

/// Runs the steps chosen, or all; stops at the first that fails.
pub(crate) fn run_all(steps: &[Step], chosen: &[String]) -> Result<(), Failure> {
    for name in chosen {
        if !steps.iter().any(|step| step.name == name) {
            return Err(Failure::new(format!(
                "there is no step {name:?}; `cargo verify --help` lists them"
            )));
        }
    }
    let mut took = Vec::new();
    let mut result = Ok(());
    for step in steps {
        if !chosen.is_empty() && !chosen.iter().any(|name| name == step.name) {
            continue;
        }
        println!("\n== {}: {}", step.name, step.what);
        let start = Instant::now();
        result = step
            .run()
            .map_err(|failure| Failure::new(format!("{} failed: {failure}", step.name)));
        took.push((step.name, start.elapsed()));
        if result.is_err() {
            break;
        }
    }
    println!();
    for (name, duration) in &took {
        println!("{name:>22}  {:>6.1} s", duration.as_secs_f64());
    }
    let total: Duration = took.iter().map(|(_, duration)| *duration).sum();
    println!("{:>22}  {:>6.1} s", "total", total.as_secs_f64());
    result
}

/// The cargo that runs this, in the workspace's root.
pub(crate) fn cargo() -> Command {
    let mut command = cargo_here();
    command.current_dir(root());
    // Cargo takes a relative one from where it is called, which was not the root.
    if let Some(Ok(target)) = std::env::var_os("CARGO_TARGET_DIR").map(std::path::absolute) {
        command.env("CARGO_TARGET_DIR", target);
    }
    command
}

/// The cargo that runs this, where it was called.
pub(crate) fn cargo_here() -> Command {
    Command::new(std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into()))
}

/// The workspace's root.
pub(crate) fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .parent()
        .map_or_else(|| PathBuf::from("."), Path::to_path_buf)
}

/// Runs a command, its output passed on.
pub(crate) fn check(command: &mut Command) -> Result<(), Failure> {
    let status = command
        .stdin(Stdio::null())
        .status()
        .map_err(|error| not_started(command, &error))?;
    if status.success() {
        Ok(())
    } else {
        Err(Failure::new(format!("{}: {status}", spoken(command))))
    }
}

/// Runs a command for its success alone.
pub(crate) fn quiet(command: &mut Command) -> Result<(), Failure> {
    check(command.stdout(Stdio::null()).stderr(Stdio::null()))
}

/// Runs a command for its output.
pub(crate) fn output(command: &mut Command) -> Result<Vec<u8>, Failure> {
    let output = command
        .stdin(Stdio::null())
        .stderr(Stdio::inherit())
        .output()
        .map_err(|error| not_started(command, &error))?;
    if output.status.success() {
        Ok(output.stdout)
    } else {
        Err(Failure::new(format!(
            "{}: {}",
            spoken(command),
            output.status
        )))
    }
}

fn not_started(command: &Command, error: &io::Error) -> Failure {
    Failure::new(format!("{} does not start: {error}", spoken(command)))
}

/// A command as somebody would type it, without its environment.
fn spoken(command: &Command) -> String {
    let program = Path::new(command.get_program());
    let mut text = program
        .file_name()
        .unwrap_or(program.as_os_str())
        .to_string_lossy()
        .into_owned();
    for argument in command.get_args() {
        text.push(' ');
        text.push_str(&argument.to_string_lossy());
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_command_that_fails_is_named_as_it_is_typed() {
        let mut command = Command::new("/bin/sh");
        command.env("A", "B").args(["-c", "exit 3"]);
        assert_eq!(
            check(&mut command).unwrap_err().to_string(),
            "sh -c exit 3: exit status: 3"
        );
    }

    #[test]
    fn a_program_that_is_not_there_is_named() {
        let error = output(&mut Command::new("no-such-program"))
            .unwrap_err()
            .to_string();
        assert!(
            error.starts_with("no-such-program does not start"),
            "{error}"
        );
    }
}
