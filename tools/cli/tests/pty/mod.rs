//! A program on a terminal.

use std::{
    fs::File,
    io::{Read, Write},
    os::fd::OwnedFd,
    process::{Child, Command, ExitStatus},
    sync::mpsc::{Receiver, channel},
    thread,
    time::{Duration, Instant},
};

use rustix::{
    fs::{Mode, OFlags, open},
    pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt},
    termios::{LocalModes, tcgetattr},
};

/// How long a program may take for what is expected of it.
const PATIENCE: Duration = Duration::from_secs(30);

/// A program whose standard input and output are a terminal.
pub(crate) struct OnTerminal {
    child: Child,
    master: File,
    slave: OwnedFd,
    output: Receiver<Vec<u8>>,
    seen: String,
}

impl OnTerminal {
    pub(crate) fn start(mut command: Command) -> Self {
        let master = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY).unwrap();
        grantpt(&master).unwrap();
        unlockpt(&master).unwrap();
        let name = ptsname(&master, Vec::new()).unwrap();
        let slave = open(name, OFlags::RDWR | OFlags::NOCTTY, Mode::empty()).unwrap();
        command
            .env("TERM", "xterm")
            .stdin(slave.try_clone().unwrap())
            .stdout(slave.try_clone().unwrap());
        let child = command.spawn().unwrap();
        let master = File::from(master);
        let mut reading = master.try_clone().unwrap();
        let (sender, output) = channel();
        thread::spawn(move || {
            let mut buffer = [0; 4_096];
            while let Ok(count @ 1..) = reading.read(&mut buffer) {
                if sender.send(buffer[..count].to_vec()).is_err() {
                    break;
                }
            }
        });
        Self {
            child,
            master,
            slave,
            output,
            seen: String::new(),
        }
    }

    /// Whether the terminal gives every key at once, and shows none.
    pub(crate) fn is_raw(&self) -> bool {
        let modes = tcgetattr(&self.slave).unwrap().local_modes;
        !modes.intersects(LocalModes::ICANON | LocalModes::ECHO)
    }

    /// Waits until the program has written this.
    pub(crate) fn wait_for(&mut self, text: &str) {
        let begun = Instant::now();
        while !self.seen.contains(text) {
            assert!(begun.elapsed() < PATIENCE, "no {text:?} in {:?}", self.seen);
            self.receive(Duration::from_millis(50));
        }
    }

    pub(crate) fn press(&mut self, key: &[u8]) {
        self.master.write_all(key).unwrap();
    }

    pub(crate) const fn child(&self) -> &Child {
        &self.child
    }

    /// Waits for the end of the program, and returns all that it wrote.
    pub(crate) fn end(mut self) -> (ExitStatus, String, bool) {
        let begun = Instant::now();
        let status = loop {
            if let Some(status) = self.child.try_wait().unwrap() {
                break status;
            }
            assert!(begun.elapsed() < PATIENCE, "it does not end");
            self.receive(Duration::from_millis(20));
        };
        while self.receive(Duration::from_millis(200)) {}
        let is_raw = self.is_raw();
        (status, self.seen, is_raw)
    }

    fn receive(&mut self, wait: Duration) -> bool {
        let Ok(bytes) = self.output.recv_timeout(wait) else {
            return false;
        };
        self.seen.push_str(&String::from_utf8_lossy(&bytes));
        true
    }
}
