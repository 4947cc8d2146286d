//! What the daemon is connected to.

mod canary;
mod physical;
mod proxy;
mod simulated;

use std::{net::SocketAddrV4, path::Path, time::Duration};

use singletrack_protocol::{ResetCause, StopCause};
use singletrack_sim::{BusFault, Hang, LossKind, Truth};

pub use physical::PhysicalRig;
pub(crate) use physical::lacks as physical_lacks;
pub use simulated::SimulatedRig;
pub(crate) use simulated::lacks as simulated_lacks;

use crate::{Failure, Outcome, Trace};

/// A board, a car and cameras, with switches for what can go wrong.
pub trait Rig: Send {
    /// The daemon's serial port.
    fn port(&self) -> &Path;

    /// Where the cameras take commands.
    fn cameras(&self) -> SocketAddrV4;

    /// Pulls the serial line out.
    ///
    /// # Errors
    ///
    /// When the rig has stopped.
    fn unplug(&self) -> Outcome;

    /// Plugs it in again.
    ///
    /// # Errors
    ///
    /// When there is no pseudo-terminal to be had.
    fn plug(&self) -> Outcome;

    /// Damages the line from now on, both ways.
    ///
    /// # Errors
    ///
    /// When the rig has stopped.
    fn set_line(&self, line: LineFaults) -> Outcome;

    /// Hides the markers from the cameras, or shows them again.
    ///
    /// # Errors
    ///
    /// When the rig has stopped.
    fn set_markers(&self, loss: Option<LossKind>) -> Outcome;

    /// What the simulated car really does.
    ///
    /// # Errors
    ///
    /// When the rig has stopped.
    fn truth(&self) -> Outcome<Truth>;

    /// The pulses since the start.
    ///
    /// # Errors
    ///
    /// When the rig has stopped.
    fn trace(&self) -> Outcome<Trace>;

    /// The board's clock; none while it does not run.
    ///
    /// # Errors
    ///
    /// When the rig has stopped.
    fn board_time_us(&self) -> Outcome<Option<u32>>;

    /// Why the board last went to neutral; none while it does not run.
    ///
    /// # Errors
    ///
    /// When the rig has stopped.
    fn stop_cause(&self) -> Outcome<Option<StopCause>>;

    /// Waits until no command is in force any more, and returns a board time
    /// that is not later than the last command's arrival.
    ///
    /// # Errors
    ///
    /// [`Failure::Void`] when the rig has missed it.
    fn last_command_us(&self) -> Outcome<u32>;

    /// How late the rig itself has been, the pseudo-terminal included: what
    /// takes longer than it should because the machine is busy.
    ///
    /// # Errors
    ///
    /// When the rig has stopped.
    fn lateness(&self) -> Outcome<Duration>;

    /// What this rig does not have, and why.
    fn lacks(&self, need: Need) -> Option<&'static str>;

    /// Resets the board.
    ///
    /// # Errors
    ///
    /// When the rig lacks [`Need::Reset`].
    fn reset(&self, _cause: ResetCause) -> Outcome {
        Err(self.without(Need::Reset))
    }

    /// Cuts the motor's pulse sensor.
    ///
    /// # Errors
    ///
    /// When the rig lacks [`Need::MotorSensor`].
    fn cut_motor_sensor(&self) -> Outcome {
        Err(self.without(Need::MotorSensor))
    }

    /// Opens the stop switch.
    ///
    /// # Errors
    ///
    /// When the rig lacks [`Need::StopSwitch`].
    fn open_stop_switch(&self) -> Outcome {
        Err(self.without(Need::StopSwitch))
    }

    /// Stops the board's main program.
    ///
    /// # Errors
    ///
    /// When the rig lacks [`Need::Image`].
    fn hang(&self, _hang: Hang) -> Outcome {
        Err(self.without(Need::Image))
    }

    /// Breaks the board's bus to the IMU, or mends it.
    ///
    /// # Errors
    ///
    /// When the rig lacks [`Need::Image`].
    fn break_imu_bus(&self, _fault: BusFault) -> Outcome {
        Err(self.without(Need::Image))
    }

    /// The failure of a test that did not say what it needs.
    fn without(&self, need: Need) -> Failure {
        Failure::new(self.lacks(need).unwrap_or("the rig can't do this"))
    }
}

/// What only some rigs have.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Need {
    /// A line to reset the board by, for different causes.
    Reset,
    /// A motor sensor that can be cut.
    MotorSensor,
    /// A stop switch that can be opened.
    StopSwitch,
    /// A board that has just been started.
    FreshBoard,
    /// The real image, on a processor that can be made to fail.
    Image,
}

/// What is wrong with the line, both ways.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LineFaults {
    /// Probability that one bit of a byte is flipped.
    pub corrupt: f64,
    /// Nothing passes; what is sent waits, and goes on when this ends.
    pub stuck: bool,
}
