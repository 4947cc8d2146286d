//! The UNO image on a simulated processor, in step with the car.

use std::{
    io::{BufReader, BufWriter},
    path::{Path, PathBuf},
    process::{Child, ChildStdin, ChildStdout, Command, Stdio},
};

use singletrack_protocol::ResetCause;
use singletrack_simavr::{
    CYCLES_PER_US, Figures, Motion, Pin, PipeError, Reply, Report, Request, ResetFlags, Run,
    receive, send,
};

use super::{Environment, battery_mv, local_time, supply_mv};
use crate::{
    car::{Car, MotorPulses},
    clock::SkewedClock,
    pulses::{Frame, Frames, PulseLog, PulseRecord, width_us},
};

/// Paths of the image and of the program that runs it.
///
/// `cargo uno` builds both into a folder `uno` of the target folder. Programs in
/// the target folder find it there.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Installation {
    /// The program that runs the image.
    pub program: PathBuf,
    /// The image.
    pub image: PathBuf,
}

/// Why there is no simulated UNO, or why it has stopped.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("{0}")]
pub struct UnoError(pub(super) String);

const VARIABLE: &str = "SINGLETRACK_UNO";
const FOLDER: &str = "uno";
const PROGRAM: &str = "singletrack-simavr";
const IMAGE: &str = "singletrack-uno.elf";

impl Installation {
    /// Searches the folder in `SINGLETRACK_UNO`, or else a folder `uno` beside this
    /// program or above it.
    ///
    /// # Errors
    ///
    /// Fails if a file is missing.
    pub fn find() -> Result<Self, UnoError> {
        if let Some(folder) = std::env::var_os(VARIABLE).map(PathBuf::from) {
            let installation = Self::in_folder(&folder);
            let Self { program, image } = &installation;
            let files = [(program, PROGRAM), (image, IMAGE)];
            if let Some((_, file)) = files.iter().find(|(path, _)| !path.is_file()) {
                let folder = folder.display();
                let why = format!("{VARIABLE} names {folder}, where there is no {file}");
                return Err(UnoError(why));
            }
            return Ok(installation);
        }
        let executable = std::env::current_exe().unwrap_or_default();
        executable
            .ancestors()
            .skip(1)
            .map(|folder| Self::in_folder(&folder.join(FOLDER)))
            .find(|found| found.program.is_file() && found.image.is_file())
            .ok_or_else(|| {
                UnoError(format!(
                    "no simulated UNO: no folder {FOLDER:?} with {PROGRAM} and {IMAGE} beside {} \
                     or above it; `cargo uno` builds both, or name the folder in {VARIABLE}",
                    executable.display()
                ))
            })
    }

    /// Runs another image of the same folder alone, for a time in µs, and returns
    /// its cost.
    ///
    /// # Errors
    ///
    /// Fails if the image does not run for that time.
    pub fn measure(&self, file: &str, time_us: u64) -> Result<Figures, UnoError> {
        let image = self.image.with_file_name(file);
        let mut process = Process::start(&self.program, &image)?;
        let crashed = |reason: String| UnoError(format!("{}: {reason}", image.display()));
        let mut ask = |request| process.ask(&request).map_err(crashed);
        ask(Request::Start(ResetFlags::POWER_ON))?;
        ask(Request::Run(Run {
            until: time_us * CYCLES_PER_US,
            ..Run::default()
        }))?;
        match ask(Request::Measure)? {
            Reply::Figures(figures) => Ok(figures),
            reply => Err(crashed(format!("expected figures, got {reply:?}"))),
        }
    }

    fn in_folder(folder: &Path) -> Self {
        Self {
            program: folder.join(PROGRAM),
            image: folder.join(IMAGE),
        }
    }
}

/// Step of the processor, in µs. Events within a step are dated to the cycle and
/// reach the car and the line at its end.
const STEP_US: u64 = 1_000;

/// The processor with the image.
#[derive(Debug)]
pub(super) struct Image {
    process: Process,
    /// Its oscillator.
    clock: SkewedClock,
    pub(super) failure: Option<String>,
    pub(super) next_event_us: u64,
    /// Cycle in which the processor last left its reset.
    started: u64,
    edges: MotorPulses,
    motion: Vec<(u64, Motion)>,
    frames: Frames,
    pub(super) bytes_overrun: u64,
}

impl Image {
    pub(super) fn start(clock: SkewedClock) -> Result<Self, UnoError> {
        let installation = Installation::find()?;
        Ok(Self {
            process: Process::start(&installation.program, &installation.image)?,
            clock,
            failure: None,
            next_event_us: 0,
            started: 0,
            edges: MotorPulses::default(),
            motion: Vec::new(),
            frames: Frames::default(),
            bytes_overrun: 0,
        })
    }

    /// Holds the processor in reset. The pulses until now reach car and log; a
    /// pulse in progress is cut.
    pub(super) fn hold(&mut self, car: &mut Car, log: &mut PulseLog) {
        self.ask(&Request::Hold);
        // This run takes no time; it only fetches the report.
        if let Some(Reply::Ran(report)) = self.ask(&Request::Run(Run::default())) {
            self.apply(&report, Some(report.cycle), car, log);
        }
        if let Some(frame) = self.frames.cut_off() {
            self.log(&frame, log);
        }
    }

    pub(super) fn figures(&mut self) -> Option<Figures> {
        match self.ask(&Request::Measure) {
            Some(Reply::Figures(figures)) => Some(figures),
            _ => None,
        }
    }

    /// Largest deviation of a pulse from 20 ms after the previous one, in µs.
    pub(super) fn jitter_us(&self) -> f64 {
        self.frames.jitter as f64 / CYCLES_PER_US as f64
    }

    pub(super) fn take_imu(&mut self, now_us: u64, reading: Motion) {
        // While the processor does not run, only the last sample matters.
        if self.motion.len() > 100 {
            self.motion.clear();
        }
        self.motion.push((self.clock.cycle_at(now_us), reading));
    }

    pub(super) fn restart(&mut self, now_us: u64, cause: ResetCause) {
        let until = self.clock.cycle_at(now_us);
        let motion = std::mem::take(&mut self.motion);
        self.ask(&Request::Run(Run {
            until,
            motion,
            ..Run::default()
        }));
        self.ask(&Request::Start(match cause {
            ResetCause::PowerOn => ResetFlags::POWER_ON,
            ResetCause::External => ResetFlags::EXTERNAL,
            ResetCause::BrownOut => ResetFlags::BROWN_OUT,
            ResetCause::Watchdog => ResetFlags::WATCHDOG,
            ResetCause::Unknown => ResetFlags(0),
        }));
        self.started = until;
        self.next_event_us = now_us;
    }

    /// Runs the processor up to now; returns whether the watchdog has reset it.
    pub(super) fn run(&mut self, environment: &mut Environment<'_>) -> bool {
        let now_us = environment.now_us;
        if now_us < self.next_event_us {
            return false;
        }
        self.next_event_us = (now_us / STEP_US + 1) * STEP_US;
        let (clock, started_us) = (self.clock, environment.started_us);
        let (mut received, wire) = (Vec::new(), &mut *environment.wire);
        wire.board_read_timed(now_us, |arrival_us, byte| {
            received.push((clock.cycle_at(arrival_us), byte));
            let board_time_us = local_time(&clock, started_us, arrival_us);
            let monitor = &mut *environment.monitor;
            monitor.host_byte(byte, arrival_us, board_time_us);
        });
        let run = Run {
            until: clock.cycle_at(now_us),
            received,
            motor_edges: self.motor_edges(environment.car),
            motion: std::mem::take(&mut self.motion),
            battery_mv: battery_mv(environment.car, environment.battery_noise),
            supply_mv: supply_mv(environment.car),
            divider_open: environment.car.parameters.battery.divider_open,
            imu_health: Some(environment.car.parameters.imu.registers()),
            stop_input_open: environment.stop_input_open,
        };
        match self.ask(&Request::Run(run)) {
            Some(Reply::Ran(report)) => self.take(&report, environment),
            _ => false,
        }
    }

    /// The edges since the last call. The car knows only their number and the time
    /// of the last one; its speed is taken as constant for a millisecond.
    fn motor_edges(&mut self, car: &Car) -> Vec<u64> {
        let edges = car.motor_pulses();
        let new = u64::from(edges.count.wrapping_sub(self.edges.count));
        self.edges = edges;
        let Some(last_us) = edges.last_us else {
            return Vec::new();
        };
        let last = self.clock.cycle_at(last_us);
        let between = STEP_US * CYCLES_PER_US / (new + 1);
        let edge = |before| last.saturating_sub(before * between);
        (0..new).rev().map(edge).collect()
    }

    /// Passes the board's outputs to car, line and log.
    fn take(&mut self, report: &Report, environment: &mut Environment<'_>) -> bool {
        let Environment { car, pulses, .. } = environment;
        self.bytes_overrun = report.bytes_overrun;
        for &(cycle, byte) in &report.transmitted {
            environment.monitor.board_byte(byte);
            let sent_us = self.clock.when_cycle(cycle);
            environment.wire.board_sent(sent_us, byte);
        }
        self.apply(report, report.watchdog_reset, car, pulses);
        // Its changes reach the car at the end of the step.
        if let Some(&(_, held)) = report.kill_output.last() {
            car.set_kill_output(held);
        }
        if let Some(frame) = self.frames.over(report.cycle) {
            self.log(&frame, pulses);
        }
        report.watchdog_reset.is_some()
    }

    /// A pulse that ends in the cycle of a reset was cut by it.
    fn apply(&mut self, report: &Report, reset: Option<u64>, car: &mut Car, log: &mut PulseLog) {
        for pulse in &report.pulses {
            match pulse.pin {
                Pin::Servo => car.apply_pulses(width_us(pulse), 0),
                Pin::Esc => car.apply_pulses(0, width_us(pulse)),
            }
            let cut = reset == Some(pulse.start + pulse.width);
            if let Some(frame) = self.frames.take(pulse, cut) {
                self.log(&frame, log);
            }
        }
    }

    fn log(&self, frame: &Frame, log: &mut PulseLog) {
        log.push(PulseRecord {
            time_us: self.clock.when_cycle(frame.start),
            board_time_us: (frame.start.saturating_sub(self.started) / CYCLES_PER_US) as u32,
            servo_us: frame.servo_us,
            esc_us: frame.esc_us,
            cut: frame.cut,
        });
    }

    /// Sends a request to the process, unless it has failed.
    pub(super) fn ask(&mut self, request: &Request) -> Option<Reply> {
        if self.failure.is_some() {
            return None;
        }
        let reply = self.process.ask(request);
        reply.map_err(|reason| self.failure = Some(reason)).ok()
    }
}

/// The process with its pipes. Dropping it ends the process.
#[derive(Debug)]
pub(super) struct Process {
    child: Child,
    requests: BufWriter<ChildStdin>,
    replies: BufReader<ChildStdout>,
}

impl Process {
    pub(super) fn start(program: &Path, image: &Path) -> Result<Self, UnoError> {
        let error =
            |reason: String| UnoError(format!("can't start {}: {reason}", program.display()));
        let mut command = Command::new(program);
        // Not interrupted by Ctrl-C: it must end after the simulator.
        #[cfg(unix)]
        std::os::unix::process::CommandExt::process_group(&mut command, 0);
        let mut child = command
            .arg(image)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
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
