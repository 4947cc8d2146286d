//! What the pilot is told between two ticks.

use singletrack_control::{InertialSample, PoseSample, Setpoint, Time};

use crate::words::words;

/// Something that happened since the last tick.
///
/// The list of events is all that a [`crate::Pilot`] knows of the world: the
/// same list gives the same outputs, bit for bit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Event {
    /// The cameras saw the car.
    Pose(PoseSample),
    /// The cameras looked and did not see the car, or what they saw can't be.
    PoseMissing(PoseMissing),
    /// The board reported.
    Board(BoardSample),
    /// The link to the board came up or went down.
    Link(LinkState),
    /// Someone asks for something.
    Request(Request),
    /// The board refused to arm.
    ArmRefused,
    /// The board said how it is.
    Health(BoardHealth),
    /// How well frames cross the line to the board.
    Line(LineHealth),
    /// What the system granted the controller; told once, before anything drives.
    RealTime(RealTimeState),
    /// Where P should be and how fast it should move, from outside.
    Setpoint(Setpoint),
    /// From here on the pilot has another configuration
    /// ([`crate::Pilot::reconfigure`]), which has this number.
    Reconfigured(u32),
}

/// What the board says of itself, a few times a second.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BoardHealth {
    /// Voltage of the battery, in mV.
    pub battery_mv: u16,
    /// Whether the stop switch is open; false if none is configured.
    pub stop_input_open: bool,
}

/// Damaged frames as a part of all over about a second, 0 to 1; none while too
/// few came to tell.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LineHealth {
    /// Of those that the host received.
    pub to_host: Option<f64>,
    /// Of those that the board received.
    pub to_board: Option<f64>,
}

impl LineHealth {
    /// The worse of the two directions; 0 while neither can be told.
    #[must_use]
    pub fn worst(&self) -> f64 {
        self.to_host
            .unwrap_or(0.0)
            .max(self.to_board.unwrap_or(0.0))
    }
}

/// What the system granted the controller.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RealTimeState {
    /// Whether it is scheduled in real time.
    pub fifo: bool,
    /// Whether its memory stays in place.
    pub memory_locked: bool,
}

words! {
    /// Why a frame brought no pose.
    pub enum PoseMissing {
        /// The body was in the frame, marked as not tracked.
        Untracked = "untracked",
        /// The body was not in the frame.
        Absent = "absent",
        /// The stream has gone silent.
        Stale = "stale",
        /// The pose was not plausible.
        Rejected = "rejected",
        /// So many poses in a row were not plausible that none can be trusted.
        Untrustworthy = "untrustworthy",
    }
}

/// What the board measured, in the car's axes (forward, left, up).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BoardSample {
    /// When the board made the record, on the host's clock.
    pub time: Time,
    /// The IMU's sample; none if it is silent or was reported before.
    pub inertial: Option<InertialSample>,
    /// Speed of the rear axle by the motor pulses, in m/s.
    pub motor_speed: f64,
    /// The board's safety machine.
    pub state: BoardState,
}

words! {
    /// The board's safety machine, as far as the pilot cares.
    pub enum BoardState {
        /// Starting up.
        Booting = "booting",
        /// At neutral; can be armed.
        Neutral = "neutral",
        /// Armed, waiting for the first command.
        Armed = "armed",
        /// Obeying commands.
        Driving = "driving",
        /// Stopped by itself; can be armed again.
        Failsafe = "failsafe",
        /// Stopped until it is reset.
        EmergencyStopped = "emergency-stopped",
    }
}

words! {
    /// The link to the board.
    pub enum LinkState {
        /// No board, or none that has its configuration yet.
        Down = "down",
        /// The board speaks another version of the protocol.
        VersionDiffers = "version-differs",
        /// The board does not take its configuration.
        ConfigurationRefused = "configuration-refused",
        /// The board does not take its configuration because an emergency stop is
        /// latched until it is reset.
        EmergencyStopped = "emergency-stopped",
        /// The board answers, has the configuration and reports.
        Ready = "ready",
    }
}

words! {
    /// What a person or program asks of the pilot.
    pub enum Request {
        /// Start driving along the reference.
        Arm = "arm",
        /// Slow down, stop and disarm; also leaves [`crate::Mode::Fault`].
        Disarm = "disarm",
        /// Neutral now, until the board is reset.
        EmergencyStop = "emergency-stop",
    }
}
