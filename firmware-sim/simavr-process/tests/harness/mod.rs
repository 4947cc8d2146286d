//! Builds a program with avr-gcc and runs it in `singletrack-simavr`.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use std::{
    io::BufReader,
    path::Path,
    process::{Child, ChildStdin, ChildStdout, Command, ExitStatus, Stdio},
};

use singletrack_simavr::{Reply, Report, Request, ResetFlags, Run, receive, send};

/// A millisecond in cycles.
pub(crate) const MS: u64 = 16_000;

pub(crate) fn command() -> Command {
    Command::new(env!("CARGO_BIN_EXE_singletrack-simavr"))
}

/// The process running a program.
pub(crate) struct Uno {
    process: Child,
    input: ChildStdin,
    output: BufReader<ChildStdout>,
    cycle: u64,
}

impl Uno {
    /// A process with the program started after power-on.
    pub(crate) fn started(source: &str) -> Self {
        let mut process = command()
            .arg(built(source))
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let mut uno = Self {
            input: process.stdin.take().unwrap(),
            output: BufReader::new(process.stdout.take().unwrap()),
            process,
            cycle: 0,
        };
        assert_eq!(uno.ask(&Request::Start(ResetFlags::POWER_ON)), Reply::Done);
        uno
    }

    pub(crate) fn ask(&mut self, request: &Request) -> Reply {
        send(&mut self.input, request).unwrap();
        receive(&mut self.output).unwrap().unwrap()
    }

    pub(crate) fn run(&mut self, run: Run) -> Report {
        let until = run.until;
        match self.ask(&Request::Run(run)) {
            Reply::Ran(report) => {
                assert!((until..until + 12).contains(&report.cycle), "{report:?}");
                self.cycle = report.cycle;
                report
            }
            other => panic!("{other:?}"),
        }
    }

    /// Runs for a number of cycles without inputs.
    pub(crate) fn pass(&mut self, cycles: u64) -> Report {
        self.run(self.until(cycles))
    }

    /// A run of a number of cycles without inputs.
    pub(crate) fn until(&self, cycles: u64) -> Run {
        Run {
            until: self.cycle + cycles,
            battery_mv: 7_400,
            ..Run::default()
        }
    }

    pub(crate) const fn cycle(&self) -> u64 {
        self.cycle
    }

    pub(crate) fn close(self) -> ExitStatus {
        let Self {
            mut process, input, ..
        } = self;
        drop(input);
        process.wait().unwrap()
    }
}

/// Bytes at regular intervals.
pub(crate) fn spaced(start: u64, interval: u64, bytes: &[u8]) -> Vec<(u64, u8)> {
    (start..)
        .step_by(interval as usize)
        .zip(bytes.iter().copied())
        .collect()
}

pub(crate) fn bytes(dated: &[(u64, u8)]) -> Vec<u8> {
    dated.iter().map(|(_, byte)| *byte).collect()
}

fn built(source: &str) -> std::path::PathBuf {
    let sources = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/programs");
    // Tests run in parallel: each has its own file.
    let name = std::thread::current().name().unwrap_or("test").to_owned();
    let image = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("{name}-{source}.elf"));
    let status = Command::new("avr-gcc")
        .args([
            "-mmcu=atmega328p",
            "-Os",
            "-Wall",
            "-Werror",
            "-DF_CPU=16000000UL",
        ])
        .arg(sources.join(source))
        .arg("-o")
        .arg(&image)
        .status()
        .expect("avr-gcc, from Debian's gcc-avr and avr-libc");
    assert!(status.success());
    image
}
