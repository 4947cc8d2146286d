//! The daemon as the process that it is.

use std::{
    fs::File,
    path::{Path, PathBuf},
    process::{Child, Command, ExitStatus, Stdio},
    time::{Duration, Instant},
};

use rustix::process::{Pid, Signal, kill_process};

use crate::{Failure, Outcome, wait};

/// A running `singletrackd`. Dropped, it is killed.
#[derive(Debug)]
pub struct Daemon {
    child: Child,
    log: PathBuf,
}

impl Daemon {
    /// Starts the program with a configuration file. What it logs goes to `log`.
    ///
    /// # Errors
    ///
    /// The program can't be run.
    pub fn start(program: &Path, config: &Path, log: &Path) -> Outcome<Self> {
        let output = File::create(log)
            .map_err(Failure::system(format!("cannot write {}", log.display())))?;
        let errors = output
            .try_clone()
            .map_err(Failure::system("cannot share the log"))?;
        let child = Command::new(program)
            .arg("--config")
            .arg(config)
            .stdin(Stdio::null())
            .stdout(output)
            .stderr(errors)
            .spawn()
            .map_err(Failure::system(format!("cannot run {}", program.display())))?;
        Ok(Self {
            child,
            log: log.to_owned(),
        })
    }

    /// Its process.
    #[must_use]
    pub fn id(&self) -> u32 {
        self.child.id()
    }

    /// What it has logged so far.
    #[must_use]
    pub fn log(&self) -> String {
        std::fs::read_to_string(&self.log).unwrap_or_default()
    }

    /// Whether it has ended, and how.
    ///
    /// # Errors
    ///
    /// What the system says.
    pub fn status(&mut self) -> Outcome<Option<ExitStatus>> {
        self.child
            .try_wait()
            .map_err(Failure::system("cannot ask for the daemon's end"))
    }

    /// Kills it: it has no chance to say anything.
    ///
    /// # Errors
    ///
    /// What the system says.
    pub fn kill(&mut self) -> Outcome {
        self.child
            .kill()
            .and_then(|()| self.child.wait())
            .map_err(Failure::system("cannot kill the daemon"))?;
        Ok(())
    }

    /// Asks it to end, as the system does, and returns how it ended and how
    /// long that took.
    ///
    /// # Errors
    ///
    /// It did not end within the limit.
    pub fn terminate(&mut self, limit: Duration) -> Outcome<(ExitStatus, Duration)> {
        let start = Instant::now();
        self.signal(Signal::TERM)?;
        let status = wait::until("the daemon's end", limit, || self.status())?;
        Ok((status, start.elapsed()))
    }

    /// Stops all of its threads where they are.
    ///
    /// # Errors
    ///
    /// What the system says.
    pub fn pause(&self) -> Outcome {
        self.signal(Signal::STOP)
    }

    /// Lets them go on.
    ///
    /// # Errors
    ///
    /// What the system says.
    pub fn go_on(&self) -> Outcome {
        self.signal(Signal::CONT)
    }

    fn signal(&self, signal: Signal) -> Outcome {
        kill_process(Pid::from_child(&self.child), signal)
            .map_err(|error| Failure::system("cannot signal the daemon")(error.into()))
    }
}

impl Drop for Daemon {
    fn drop(&mut self) {
        // It may have ended already.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
