//! What shows a drive, as a process beside the daemon.

use std::{
    io::{BufRead as _, BufReader},
    net::SocketAddr,
    process::{Child, Command, Stdio},
};

use rustix::process::{Pid, Signal, kill_process};

use crate::{Failure, Outcome, bench::Bench, settings};

/// A running `singletrack page` or `singletrack live`. Dropping it kills the process.
#[derive(Debug)]
pub struct Viewer {
    child: Child,
    address: SocketAddr,
}

impl Viewer {
    /// Starts the command, `page` or `live`, for the daemon of a bench, and waits until it listens.
    ///
    /// # Errors
    ///
    /// Fails if it does not listen.
    pub fn start(command: &str, bench: &Bench) -> Outcome<Self> {
        // As its unit does: the rig shares the processors with it.
        let mut child = Command::new("nice")
            .args(["-n", "10"])
            .arg(bench.program().with_file_name("singletrack"))
            .args([command, "--port", "0", "--socket"])
            .arg(settings::socket(bench.folder()))
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()
            .map_err(Failure::system(format!("can't run singletrack {command}")))?;
        let mut line = String::new();
        if let Some(output) = child.stdout.take() {
            BufReader::new(output)
                .read_line(&mut line)
                .map_err(Failure::system("no line of the viewer"))?;
        }
        let address = line.trim_end().split_once("://");
        let address = address.and_then(|(_, address)| address.parse().ok());
        // From here on it is killed in any case.
        let mut viewer = Self {
            child,
            address: SocketAddr::from(([0, 0, 0, 0], 0)),
        };
        viewer.address = address.ok_or_else(|| {
            Failure::new(format!("singletrack {command} says no address: {line:?}"))
        })?;
        Ok(viewer)
    }

    /// The address that it listens on.
    pub const fn address(&self) -> SocketAddr {
        self.address
    }

    /// Suspends it (SIGSTOP).
    ///
    /// # Errors
    ///
    /// Fails with an error of the system.
    pub fn pause(&self) -> Outcome {
        kill_process(Pid::from_child(&self.child), Signal::STOP)
            .map_err(|error| Failure::system("can't signal the viewer")(error.into()))
    }
}

impl Drop for Viewer {
    fn drop(&mut self) {
        // It may have ended already.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
