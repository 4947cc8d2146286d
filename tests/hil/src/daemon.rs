//! The daemon: its program, built once as it is shipped, and the process.

use std::{
    ffi::OsString,
    fs::File,
    path::{Path, PathBuf},
    process::{Child, Command, ExitStatus, Stdio},
    time::{Duration, Instant},
};

use rustix::process::{Pid, Signal, kill_process};
use serde_json::Value;

use crate::{Failure, Outcome, wait};

/// Builds `singletrackd` in the release profile, independent of the tests' own
/// profile, and returns its path.
///
/// # Errors
///
/// Fails if it does not build; the compiler prints the errors.
pub fn build() -> Outcome<PathBuf> {
    let cargo = std::env::var_os("CARGO").unwrap_or_else(|| OsString::from("cargo"));
    let mut command = Command::new(&cargo);
    // Set by cargo for a test: the present path of the checkout, not the compiled one.
    if let Some(package) = std::env::var_os("CARGO_MANIFEST_DIR") {
        command.current_dir(Path::new(&package).join("../.."));
    }
    let output = command
        // With the suite's own features, so that the libraries are not built again.
        .args(["build", "--release", "--bins"])
        .args(["--package", "singletrackd", "--package", "singletrack"])
        .args(["--package", "singletrack-sim"])
        .arg("--message-format=json-render-diagnostics")
        .stderr(Stdio::inherit())
        .output()
        .map_err(Failure::system(format!("can't run {}", cargo.display())))?;
    if !output.status.success() {
        return Err(Failure::new(format!(
            "singletrackd does not build ({}); see above, or try `cargo build --release -p singletrackd`",
            output.status
        )));
    }
    String::from_utf8_lossy(&output.stdout)
        .lines()
        .filter_map(|line| serde_json::from_str::<Value>(line).ok())
        .filter(|message| {
            message["reason"] == "compiler-artifact" && message["target"]["name"] == "singletrackd"
        })
        .find_map(|message| message["executable"].as_str().map(PathBuf::from))
        .ok_or_else(|| Failure::new("cargo has built no program named singletrackd"))
}

/// A running `singletrackd`. Dropping it kills the process.
#[derive(Debug)]
pub struct Daemon {
    child: Child,
    log: PathBuf,
}

impl Daemon {
    /// Starts the program with a configuration file. Its log goes to the file `log`.
    ///
    /// # Errors
    ///
    /// Fails if the program can't be run.
    pub fn start(program: &Path, config: &Path, log: &Path) -> Outcome<Self> {
        let output =
            File::create(log).map_err(Failure::system(format!("can't write {}", log.display())))?;
        let errors = output
            .try_clone()
            .map_err(Failure::system("can't share the log"))?;
        let child = Command::new(program)
            .arg("--config")
            .arg(config)
            .stdin(Stdio::null())
            .stdout(output)
            .stderr(errors)
            .spawn()
            .map_err(Failure::system(format!("can't run {}", program.display())))?;
        Ok(Self {
            child,
            log: log.to_owned(),
        })
    }

    /// Its process id.
    pub fn id(&self) -> u32 {
        self.child.id()
    }

    /// Its log so far.
    pub fn log(&self) -> String {
        std::fs::read_to_string(&self.log).unwrap_or_default()
    }

    /// Its exit status, if it has ended.
    ///
    /// # Errors
    ///
    /// Fails with an error of the system.
    pub fn status(&mut self) -> Outcome<Option<ExitStatus>> {
        self.child
            .try_wait()
            .map_err(Failure::system("can't query the daemon's exit status"))
    }

    /// Kills it (SIGKILL).
    ///
    /// # Errors
    ///
    /// Fails with an error of the system.
    pub fn kill(&mut self) -> Outcome {
        self.child
            .kill()
            .and_then(|()| self.child.wait())
            .map_err(Failure::system("can't kill the daemon"))?;
        Ok(())
    }

    /// Terminates it (SIGTERM), and returns its exit status and the time until its
    /// end.
    ///
    /// # Errors
    ///
    /// Fails if it does not end within the limit.
    pub fn terminate(&mut self, limit: Duration) -> Outcome<(ExitStatus, Duration)> {
        let start = Instant::now();
        self.signal(Signal::TERM)?;
        let status = wait::until("the daemon's end", limit, || self.status())?;
        Ok((status, start.elapsed()))
    }

    /// Suspends it (SIGSTOP).
    ///
    /// # Errors
    ///
    /// Fails with an error of the system.
    pub fn pause(&self) -> Outcome {
        self.signal(Signal::STOP)
    }

    /// Continues it (SIGCONT).
    ///
    /// # Errors
    ///
    /// Fails with an error of the system.
    pub fn go_on(&self) -> Outcome {
        self.signal(Signal::CONT)
    }

    fn signal(&self, signal: Signal) -> Outcome {
        kill_process(Pid::from_child(&self.child), signal)
            .map_err(|error| Failure::system("can't signal the daemon")(error.into()))
    }
}

impl Drop for Daemon {
    fn drop(&mut self) {
        // It may have ended already.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
