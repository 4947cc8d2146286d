//! The rig that the daemon is connected to.

mod physical;
mod simulated;

use std::{
    fs::{self, File, OpenOptions},
    io::Read,
    net::SocketAddrV4,
    path::Path,
    sync::{
        Arc,
        atomic::{AtomicBool, AtomicU64, Ordering},
    },
    thread::{self, JoinHandle},
    time::{Duration, Instant},
};

use rustix::thread::{CpuSet, sched_getaffinity, sched_setaffinity};
use singletrack_protocol::{ResetCause, StopCause};
use singletrack_sim::{BusFault, Hang, LossKind, Pty, Truth};

use crate::{Failure, Outcome, Trace};

pub use physical::PhysicalRig;
pub(crate) use physical::lacks as physical_lacks;
pub use simulated::SimulatedRig;
pub(crate) use simulated::lacks as simulated_lacks;

/// A board, a car and cameras, with switches for faults.
pub trait Rig: Send {
    /// The daemon's serial port.
    fn port(&self) -> &Path;

    /// Command address of the cameras.
    fn cameras(&self) -> SocketAddrV4;

    /// Interrupts the serial line; the board keeps its power.
    ///
    /// # Errors
    ///
    /// Fails if the rig has stopped.
    fn interrupt(&self) -> Outcome;

    /// Pulls the USB cable, which takes the board's power along.
    ///
    /// # Errors
    ///
    /// Fails if the rig lacks [`Need::Power`].
    fn unplug(&self) -> Outcome {
        Err(self.without(Need::Power))
    }

    /// Ends either.
    ///
    /// # Errors
    ///
    /// Fails if no pseudo-terminal can be opened.
    fn plug(&self) -> Outcome;

    /// Sets the faults of the line, in both directions.
    ///
    /// # Errors
    ///
    /// Fails if the rig has stopped.
    fn set_line(&self, line: LineFaults) -> Outcome;

    /// Hides the markers from the cameras, or restores them.
    ///
    /// # Errors
    ///
    /// Fails if the rig has stopped.
    fn set_markers(&self, loss: Option<LossKind>) -> Outcome;

    /// Ground truth of the simulated car.
    ///
    /// # Errors
    ///
    /// Fails if the rig has stopped.
    fn truth(&self) -> Outcome<Truth>;

    /// The pulses since the start.
    ///
    /// # Errors
    ///
    /// Fails if the rig has stopped.
    fn trace(&self) -> Outcome<Trace>;

    /// Board time; `None` while the board does not run.
    ///
    /// # Errors
    ///
    /// Fails if the rig has stopped.
    fn board_time_us(&self) -> Outcome<Option<u32>>;

    /// Cause of the board's last stop; `None` while the board does not run.
    ///
    /// # Errors
    ///
    /// Fails if the rig has stopped.
    fn stop_cause(&self) -> Outcome<Option<StopCause>>;

    /// Waits until no command is in force, and returns a board time that is not
    /// later than the arrival of the last command.
    ///
    /// # Errors
    ///
    /// [`Failure::Void`] if the rig has missed it.
    fn last_command_us(&self) -> Outcome<u32>;

    /// Largest lateness of the rig itself, including the pseudo-terminal, caused by
    /// a busy machine.
    ///
    /// # Errors
    ///
    /// Fails if the rig has stopped.
    fn lateness(&self) -> Outcome<Duration>;

    /// Reason why this rig lacks something, if it does.
    fn lacks(&self, need: Need) -> Option<&'static str>;

    /// Resets the board.
    ///
    /// # Errors
    ///
    /// Fails if the rig lacks [`Need::Reset`].
    fn reset(&self, _cause: ResetCause) -> Outcome {
        Err(self.without(Need::Reset))
    }

    /// Cuts the motor's pulse sensor.
    ///
    /// # Errors
    ///
    /// Fails if the rig lacks [`Need::MotorSensor`].
    fn cut_motor_sensor(&self) -> Outcome {
        Err(self.without(Need::MotorSensor))
    }

    /// Opens the stop switch.
    ///
    /// # Errors
    ///
    /// Fails if the rig lacks [`Need::StopSwitch`].
    fn open_stop_switch(&self) -> Outcome {
        Err(self.without(Need::StopSwitch))
    }

    /// Hangs the board's main program.
    ///
    /// # Errors
    ///
    /// Fails if the rig lacks [`Need::Image`].
    fn hang(&self, _hang: Hang) -> Outcome {
        Err(self.without(Need::Image))
    }

    /// Sets the fault of the board's IMU bus.
    ///
    /// # Errors
    ///
    /// Fails if the rig lacks [`Need::Image`].
    fn break_imu_bus(&self, _fault: BusFault) -> Outcome {
        Err(self.without(Need::Image))
    }

    /// The failure of a test that does not declare its needs.
    fn without(&self, need: Need) -> Failure {
        Failure::new(self.lacks(need).unwrap_or("the rig does not support this"))
    }
}

/// Features of only some rigs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Need {
    /// A reset line, for different causes.
    Reset,
    /// A USB cable that takes the board's power along.
    Power,
    /// A motor sensor that can be cut.
    MotorSensor,
    /// A stop switch that can be opened.
    StopSwitch,
    /// A board that has just been started.
    FreshBoard,
    /// A board with another car's number.
    AnotherCar,
    /// Cameras with another kind of server.
    OtherCameras,
    /// The real image, on a processor with faults.
    Image,
    /// A car that may be faster than the circle.
    Fast,
    /// A computer on which input devices can be made.
    Uinput,
    /// A simulator of its own, in real time, with the board's code.
    Newcomer,
    /// The time for every step of the three procedures.
    Whole,
    /// Octave, with its package instrument-control.
    Octave,
    /// Chromium.
    Browser,
}

/// The device by which input devices are made.
const UINPUT: &str = "/dev/uinput";

/// Reason why this computer can make no input devices, if it can't.
pub(crate) fn uinput_lacks() -> Option<&'static str> {
    let opened = std::fs::OpenOptions::new().write(true).open(UINPUT);
    opened
        .is_err()
        .then_some("this computer has no /dev/uinput that the test may write to")
}

/// Runs something with raised priority, and what it starts.
pub(crate) fn as_hardware<T: Send + 'static>(
    start: impl FnOnce() -> T + Send + 'static,
) -> Outcome<T> {
    std::thread::spawn(move || {
        raise_priority();
        start()
    })
    .join()
    .map_err(|_| Failure::new("the start panicked"))
}

/// Faults of the line, in both directions.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LineFaults {
    /// Probability that one bit of a byte is flipped.
    pub corrupt: f64,
    /// Nothing passes; sent bytes wait until this ends.
    pub stuck: bool,
}

/// Raises the priority of this thread and of those that it starts: they stand for
/// hardware, which shares no processor.
pub(super) fn raise_priority() {
    // Below the threads of the daemon. By nice values alone, another session's programs would still
    // get an equal share of the processors.
    let in_real_time = singletrackd::realtime::make_punctual(1).is_ok();
    if !in_real_time {
        // Without permission, the rig is late more often, which it reports.
        let _ = rustix::process::setpriority_process(None, -20);
    }
}

/// The group of this session, among which and the kernel's threads the kernel shares processors.
const GROUP: &str = "/proc/self/autogroup";

/// Share of a group by its nice value: about a tenth of a kernel thread's.
const MODEST: i32 = 10;

/// Lets the kernel's threads go before this session until it is dropped.
///
/// They move the bytes of the pseudo-terminals. Beside a busy session they waited for up to 8 s
/// (Linux 6.18), which no program in it can prevent by its own priority.
#[derive(Debug)]
pub struct ModestSession(Option<i32>);

impl ModestSession {
    /// Without permission, or without groups, rigs are late more often, which they report.
    pub fn begin() -> Self {
        let nice = fs::read_to_string(GROUP)
            .ok()
            .and_then(|text| text.rsplit(' ').next()?.trim().parse().ok())
            .filter(|&nice: &i32| nice < MODEST);
        Self(nice.filter(|_| fs::write(GROUP, MODEST.to_string()).is_ok()))
    }
}

impl Drop for ModestSession {
    fn drop(&mut self) {
        if let Some(nice) = self.0 {
            // There is nobody to tell.
            let _ = fs::write(GROUP, nice.to_string());
        }
    }
}

/// Time between two bytes.
const PERIOD: Duration = Duration::from_millis(10);

/// A separate pseudo-terminal per processor, through which a byte is sent every 10 ms.
///
/// The kernel's worker threads move bytes between the ends of a pseudo-terminal and
/// share the processors with all programs: on a machine that compiles, telemetry
/// was delayed there by 200 ms while simulator and daemon were in time, and on one
/// processor only. The delay measured here applies to the board's line too.
#[derive(Debug)]
pub(super) struct Canary {
    late_us: Arc<AtomicU64>,
    stop: Arc<AtomicBool>,
    threads: Vec<JoinHandle<()>>,
}

impl Canary {
    pub(super) fn start() -> Outcome<Self> {
        let mut canary = Self {
            late_us: Arc::new(AtomicU64::new(0)),
            stop: Arc::new(AtomicBool::new(false)),
            threads: Vec::new(),
        };
        let processors = sched_getaffinity(None)
            .map_err(|error| Failure::new(format!("can't ask for the processors: {error}")))?;
        for processor in (0..CpuSet::MAX_CPU).filter(|&number| processors.is_set(number)) {
            canary.watch(processor)?;
        }
        Ok(canary)
    }

    fn watch(&mut self, processor: usize) -> Outcome {
        let pty = Pty::open(None).map_err(|error| Failure::new(error.to_string()))?;
        let far_end = OpenOptions::new()
            .read(true)
            .open(pty.path())
            .map_err(Failure::system("can't open a pseudo-terminal"))?;
        let (worst_us, stopped) = (Arc::clone(&self.late_us), Arc::clone(&self.stop));
        let thread = thread::Builder::new()
            .name("canary".to_owned())
            .spawn(move || {
                raise_priority();
                let mut only = CpuSet::new();
                only.set(processor);
                // A processor that was taken away meanwhile can't be late.
                let _ = sched_setaffinity(None, &only);
                measure(&pty, far_end, &worst_us, &stopped);
            })
            .map_err(Failure::system("can't start a thread"))?;
        self.threads.push(thread);
        Ok(())
    }

    /// Longest delay of a byte.
    pub(super) fn lateness(&self) -> Duration {
        Duration::from_micros(self.late_us.load(Ordering::Relaxed))
    }
}

impl Drop for Canary {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        for thread in self.threads.drain(..) {
            // Its result is no longer needed.
            let _ = thread.join();
        }
    }
}

fn measure(pty: &Pty, mut far_end: File, worst_us: &AtomicU64, stop: &AtomicBool) {
    let mut byte = [0];
    while !stop.load(Ordering::Relaxed) {
        thread::sleep(PERIOD);
        let written = Instant::now();
        if !pty.write(&[1]).is_ok_and(|count| count == 1) || far_end.read_exact(&mut byte).is_err()
        {
            return;
        }
        let took_us = u64::try_from(written.elapsed().as_micros()).unwrap_or(u64::MAX);
        worst_us.fetch_max(took_us, Ordering::Relaxed);
    }
}
