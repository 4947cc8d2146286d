//! What the pilot is told between two ticks.

use singletrack_control::{InertialSample, PoseSample, Setpoint, Time};

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

/// Why a frame brought no pose.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PoseMissing {
    /// The body was in the frame, marked as not tracked.
    Untracked,
    /// The body was not in the frame.
    Absent,
    /// The stream has gone silent.
    Stale,
    /// The pose was not plausible.
    Rejected,
    /// So many poses in a row were not plausible that none can be trusted.
    Untrustworthy,
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

/// The board's safety machine, as far as the pilot cares.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BoardState {
    /// Starting up.
    Booting,
    /// At neutral; can be armed.
    Neutral,
    /// Armed, waiting for the first command.
    Armed,
    /// Obeying commands.
    Driving,
    /// Stopped by itself; can be armed again.
    Failsafe,
    /// Stopped until it is reset.
    EmergencyStopped,
}

/// The link to the board.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LinkState {
    /// No board, or none that has its configuration yet.
    Down,
    /// The board speaks another version of the protocol.
    VersionDiffers,
    /// The board does not take its configuration.
    ConfigurationRefused,
    /// The board does not take its configuration because an emergency stop is
    /// latched until it is reset.
    EmergencyStopped,
    /// The board answers, has the configuration and reports.
    Ready,
}

/// What a person or program asks of the pilot.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Request {
    /// Start driving along the reference.
    Arm,
    /// Slow down, stop and disarm; also leaves [`crate::Mode::Fault`].
    Disarm,
    /// Neutral now, until the board is reset.
    EmergencyStop,
}
