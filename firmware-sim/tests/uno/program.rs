//! The program `singletrack-sim` with the image.

use std::{
    io::Read,
    process::{Child, Command, Stdio},
    time::{Duration, Instant},
};

const TIMEOUT: Duration = Duration::from_secs(10);

/// Polls until `look` returns a value.
fn wait_for<T>(what: &str, mut look: impl FnMut() -> Option<T>) -> T {
    let start = Instant::now();
    loop {
        if let Some(found) = look() {
            return found;
        }
        assert!(start.elapsed() < TIMEOUT, "no {what} in {TIMEOUT:?}");
        std::thread::sleep(Duration::from_millis(5));
    }
}

/// The one child of a process.
fn child_of(parent: u32) -> Option<u32> {
    std::fs::read_dir("/proc")
        .unwrap()
        .flatten()
        .find_map(|entry| {
            let pid = entry.file_name().to_str()?.parse().ok()?;
            let stat = std::fs::read_to_string(entry.path().join("stat")).ok()?;
            // After the name in parentheses: state, parent.
            let (_, rest) = stat.rsplit_once(") ")?;
            (rest.split(' ').nth(1)? == parent.to_string()).then_some(pid)
        })
}

/// Ends the simulator even if the test fails.
struct Simulator(Child);

impl Drop for Simulator {
    fn drop(&mut self) {
        // It may have ended already.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

#[test]
fn the_program_reports_a_dead_image_process_and_ends() {
    let folder = tempfile::tempdir().unwrap();
    let link = folder.path().join("board");
    let program = Command::new(env!("CARGO_BIN_EXE_singletrack-sim"))
        .args(["--board", "uno", "--quiet", "--command-port", "0"])
        .args(["--data-port", "0", "--port"])
        .arg(&link)
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut simulator = Simulator(program);
    wait_for("serial port", || link.exists().then_some(()));
    let image = child_of(simulator.0.id()).unwrap();

    let killed = Command::new("kill")
        .args(["-KILL", &image.to_string()])
        .status()
        .unwrap();
    assert!(killed.success());
    let since = Instant::now();
    let status = wait_for("end", || simulator.0.try_wait().unwrap());
    assert!(since.elapsed() < Duration::from_secs(2), "{since:?}");
    assert_eq!(status.code(), Some(1));
    let mut message = String::new();
    let mut errors = simulator.0.stderr.take().unwrap();
    errors.read_to_string(&mut message).unwrap();
    assert!(message.contains("the board failed"), "{message}");
    assert!(
        message.contains("the process that runs the image"),
        "{message}"
    );
    assert!(!link.exists());
}
