//! The rig that the daemon is connected to.

mod canary;
mod physical;
mod priority;
mod proxy;
mod simulated;

use std::{net::SocketAddrV4, path::Path, time::Duration};

use singletrack_protocol::{ResetCause, StopCause};
use singletrack_sim::{BusFault, Hang, LossKind, Truth};

pub use physical::PhysicalRig;
pub(crate) use physical::lacks as physical_lacks;
pub use priority::ModestSession;
pub use simulated::SimulatedRig;
pub(crate) use simulated::lacks as simulated_lacks;

use crate::{Failure, Outcome, Trace};

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
        priority::raise_priority();
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
