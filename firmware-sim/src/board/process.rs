//! The process that runs the image.

use std::{
    io::{BufReader, BufWriter},
    os::unix::process::CommandExt,
    path::Path,
    process::{Child, ChildStdin, ChildStdout, Command, Stdio},
};

use singletrack_simavr::{PipeError, Reply, Request, receive, send};

use super::UnoError;

/// The process with its pipes. Dropping it ends the process.
#[derive(Debug)]
pub(super) struct Process {
    child: Child,
    requests: BufWriter<ChildStdin>,
    replies: BufReader<ChildStdout>,
}

impl Process {
    pub(super) fn start(program: &Path, image: &Path) -> Result<Self, UnoError> {
        let error = |reason: String| UnoError::Start {
            program: program.to_owned(),
            reason,
        };
        let mut child = Command::new(program)
            .arg(image)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            // Not interrupted by Ctrl-C: it must end after the simulator.
            .process_group(0)
            .spawn()
            .map_err(|source| error(source.to_string()))?;
        match (child.stdin.take(), child.stdout.take()) {
            (Some(requests), Some(replies)) => Ok(Self {
                child,
                requests: BufWriter::new(requests),
                replies: BufReader::new(replies),
            }),
            _ => Err(error("no pipes".to_owned())),
        }
    }

    /// Sends a request and waits for the reply.
    pub(super) fn ask(&mut self, request: &Request) -> Result<Reply, String> {
        let reply = send(&mut self.requests, request).and_then(|()| receive(&mut self.replies));
        match reply {
            Ok(Some(Reply::Failed(reason))) => Err(reason),
            Ok(Some(reply)) => Ok(reply),
            Ok(None) => Err("the process that runs the image has ended".to_owned()),
            Err(PipeError::Io(error)) => Err(format!(
                "the process that runs the image has ended: {error}"
            )),
            Err(error) => Err(format!("the process that runs the image: {error}")),
        }
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        // The process has no state to save.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ctrl_c_does_not_reach_the_process() {
        let process = Process::start(Path::new("/bin/cat"), Path::new("-")).unwrap();
        let pid = process.child.id();
        let stat = std::fs::read_to_string(format!("/proc/{pid}/stat")).unwrap();
        // After the name in parentheses: state, parent, process group.
        let (_, rest) = stat.rsplit_once(") ").unwrap();
        let group = rest.split(' ').nth(2).unwrap();
        assert_eq!(group, pid.to_string());
    }
}
