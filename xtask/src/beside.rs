//! Steps in a process of their own, while others run.

use std::{
    io::{self, Read as _},
    process::{Child, Command, Stdio},
    thread::{self, JoinHandle},
    time::{Duration, Instant},
};

use crate::process::Failure;

/// A process that runs steps.
pub(crate) struct Beside {
    names: Vec<&'static str>,
    process: Child,
    begin: Instant,
    /// Collects what it prints, which would mix with what the others print.
    output: JoinHandle<Vec<u8>>,
}

impl Beside {
    /// Starts a command that runs the steps with these names.
    pub(crate) fn start(names: &[&'static str], command: Command) -> Result<Self, Failure> {
        let (process, output) = spawn(command).map_err(|error| {
            let names = names.join(", ");
            Failure::new(format!("{names} can't run beside others: {error}"))
        })?;
        println!("\n== {}: beside what follows", names.join(", "));
        Ok(Self {
            names: names.to_vec(),
            process,
            begin: Instant::now(),
            output,
        })
    }

    /// Waits until they are through, and shows what they printed. Adds the time that was waited
    /// to `took`, at the first name: the others' time is that of what ran beside them.
    pub(crate) fn finish(
        mut self,
        took: &mut Vec<(&'static str, Duration)>,
    ) -> Result<(), Failure> {
        let names = self.names.join(", ");
        println!("\n== {names}: waiting for their end");
        let waited = Instant::now();
        let status = self
            .process
            .wait()
            .map_err(|error| Failure::new(format!("{names} were lost: {error}")))?;
        let text = self.output.join().unwrap_or_default();
        println!("{}", String::from_utf8_lossy(&text));
        println!(
            "-- {names}: {:.1} s, waited for {:.1} s",
            self.begin.elapsed().as_secs_f64(),
            waited.elapsed().as_secs_f64()
        );
        let times = std::iter::once(waited.elapsed()).chain(std::iter::repeat(Duration::ZERO));
        took.extend(self.names.iter().copied().zip(times));
        if status.success() {
            Ok(())
        } else {
            Err(Failure::new(format!("{names} failed: {status}; see above")))
        }
    }
}

/// Takes the command, whose ends of the pipe would keep it open.
fn spawn(mut command: Command) -> io::Result<(Child, JoinHandle<Vec<u8>>)> {
    let (mut reader, writer) = io::pipe()?;
    let process = command
        .stdin(Stdio::null())
        .stdout(writer.try_clone()?)
        .stderr(writer)
        .spawn()?;
    drop(command);
    let output = thread::spawn(move || {
        let mut text = Vec::new();
        // What was read until an error is all that there is to show.
        let _ = reader.read_to_end(&mut text);
        text
    });
    Ok((process, output))
}
