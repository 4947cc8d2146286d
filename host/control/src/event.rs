//! What the pilot is told between two ticks.

use crate::{Position, Time};

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
}

/// A valid pose from the motion capture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PoseSample {
    /// Mid-exposure, on the host's clock.
    pub capture: Time,
    /// When the packet arrived.
    pub receive: Time,
    /// Frame number of the motion capture.
    pub frame: i32,
    /// Position of the rigid body's origin on the floor, world frame, in m.
    pub position: Position,
    /// Yaw of the rigid body, in rad, on the circle.
    pub yaw: f64,
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

/// A sample of the inertial measurement unit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct InertialSample {
    /// When it was measured, on the host's clock.
    pub time: Time,
    /// Angular velocity about the vertical, in rad/s.
    pub yaw_rate: f64,
    /// Acceleration forward, without gravity, in m/s².
    pub forward_acceleration: f64,
    /// Acceleration to the left, without gravity, in m/s².
    pub left_acceleration: f64,
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
    /// No board, or none that can be talked to.
    Down,
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
