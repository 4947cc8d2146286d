//! The inputs of a tick: everything that reached the pilot since the last one.

use singletrack_control::{
    InertialSample, NeighbourSample, PoseSample, Setpoint, Time, TrajectoryPiece, words,
};

use crate::{learned::Learned, tuning::Tuning};

/// An input of the pilot since the last tick.
///
/// Events are the only inputs of a [`crate::Pilot`] besides its configuration: the
/// same events at the same ticks give the same outputs, bit for bit. A record holds
/// them, so that a drive can be replayed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Event {
    /// The cameras measured a pose of the car.
    Pose(PoseSample),
    /// A frame of the cameras brought no usable pose.
    PoseMissing(PoseMissing),
    /// Where the cameras see another rigid body.
    Neighbour(NeighbourSample),
    /// Telemetry from the board.
    Board(BoardSample),
    /// The state of the link to the board changed.
    Link(LinkState),
    /// A person or a program asks the pilot for something.
    Request(PilotRequest),
    /// The board refused to arm.
    ArmRefused,
    /// The board's status: battery and stop switch, every 0.2 s.
    Health(BoardHealth),
    /// The share of damaged frames on the serial line.
    Line(LineHealth),
    /// Attitude, height and clock of the car's sensors, every 0.1 s.
    Attitude(AttitudeSample),
    /// Whether this configuration has been proved on this car. Without the event it has
    /// not: the first metre of a drive is then driven slowly, while the sensors are compared.
    Proved(bool),
    /// What the system granted the control thread. It comes once, with the first tick.
    RealTime(RealTimeState),
    /// A set-point from outside.
    Setpoint(Setpoint),
    /// A point of a trajectory from outside, which is in force with its last one.
    TrajectoryPiece(TrajectoryPiece),
    /// Pulses for servo and ESC, from the operator who jogs. They count in
    /// [`crate::Mode::Jogging`] alone, and renew it.
    Jog(Jog),
    /// Other values of what can be tuned, from the operator. Without effect outside the bounds of
    /// [`crate::PilotConfig::tuning`].
    Tuning(Tuning),
    /// A car that was armed by [`Arming::Waiting`] follows its reference, which began at this
    /// time. One that is not armed yet is not armed any more.
    Begin(Time),
    /// What a learner has learned of the car by now. Without effect unless
    /// [`crate::PilotConfig::learns`].
    Learned(Learned),
    /// The configuration with this number is in force from here on. The caller has
    /// passed it to [`crate::Pilot::reconfigure`]; the event marks the place for a
    /// replay.
    Reconfigured(u32),
}

/// Pulses for servo and ESC. The board clamps them to its limits.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Jog {
    /// Servo pulse, µs.
    pub servo_us: u16,
    /// ESC pulse, µs.
    pub esc_us: u16,
}

/// The board's own condition, from its status message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BoardHealth {
    /// Voltage of the battery, in mV.
    pub battery_mv: u16,
    /// Whether the stop switch is open; false if none is configured.
    pub stop_input_open: bool,
    /// Whether nothing is connected to the input that measures the battery.
    pub battery_open: bool,
    /// Whether the IMU reports an error, or failed its self-test.
    pub imu_fault: bool,
}

/// Roll and pitch, in rad: the left side up and the nose down are positive.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Tilt {
    /// Rotation about the forward axis.
    pub roll: f64,
    /// Rotation about the left axis.
    pub pitch: f64,
}

/// What the sensors say of the car's attitude; a value is `None` if there was none since
/// the last such event.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct AttitudeSample {
    /// Tilt of the IMU, in the car's axes.
    pub imu: Option<Tilt>,
    /// Tilt of the rigid body that the cameras see, in its own axes.
    pub body: Option<Tilt>,
    /// Height of the rigid body's origin, m.
    pub height: Option<f64>,
    /// Bound on the error of the poses' mid-exposure, s.
    pub capture_uncertainty: Option<f64>,
}

/// Damaged frames as a fraction of all frames over about one second, 0 to 1; `None`
/// while there were too few frames to measure it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LineHealth {
    /// Damaged share of the frames that the host received.
    pub to_host: Option<f64>,
    /// Damaged share of the frames that the board received.
    pub to_board: Option<f64>,
}

impl LineHealth {
    /// The larger fraction of the two directions; 0 while neither is measured.
    pub fn worst(&self) -> f64 {
        self.to_host
            .unwrap_or(0.0)
            .max(self.to_board.unwrap_or(0.0))
    }
}

/// What the system granted the control thread.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RealTimeState {
    /// Whether the thread has real-time scheduling (`SCHED_FIFO`).
    pub fifo: bool,
    /// Whether the process's memory is locked.
    pub memory_locked: bool,
}

words! {
    /// Why a frame brought no pose.
    pub enum PoseMissing {
        /// The frame has the rigid body, marked as not tracked.
        Untracked = 1 "untracked",
        /// The frame does not have the rigid body.
        Absent = 2 "absent",
        /// No frames arrive any more.
        Stale = 3 "stale",
        /// The pose was not plausible.
        Rejected = 4 "rejected",
        /// Too many poses in a row were not plausible: the rigid body is locked out until
        /// an accepted pose comes.
        Untrustworthy = 5 "untrustworthy",
    }
}

/// One record of telemetry, in the car's axes (forward, left, up).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BoardSample {
    /// When the board made the record, on the host's clock.
    pub time: Time,
    /// The IMU's sample; `None` if there was no new one.
    pub inertial: Option<InertialSample>,
    /// Speed of the rear axle from the motor pulses, in m/s.
    pub motor_speed: f64,
    /// The state of the board's own safety machine.
    pub state: BoardState,
}

words! {
    /// The states of the board's safety machine that the pilot distinguishes.
    pub enum BoardState {
        /// The board is starting up.
        Booting = 1 "booting",
        /// The ESC is at neutral; the board can be armed.
        Neutral = 2 "neutral",
        /// Armed; no drive command has come yet.
        Armed = 3 "armed",
        /// The board follows drive commands.
        Driving = 4 "driving",
        /// The board stopped the car by itself; it can be armed again.
        Failsafe = 5 "failsafe",
        /// Stopped until the board is reset.
        EmergencyStopped = 6 "emergency-stopped",
        /// Armed; the supply of the ESC has just been switched on, and the board does not
        /// follow drive commands yet.
        PoweringUp = 7 "powering-up",
        /// Stopped until the board is reset: the motor ran while the board did not drive it.
        RunsAtNeutral = 8 "runs-at-neutral",
        /// The board follows bare pulses.
        Jogging = 9 "jogging",
    }
}

words! {
    /// The link to the board.
    pub enum LinkState {
        /// No board answers, or the board has no configuration yet.
        Down = 1 "down",
        /// The board speaks another version of the protocol.
        VersionDiffers = 3 "version-differs",
        /// The board refuses its configuration.
        ConfigurationRefused = 4 "configuration-refused",
        /// The board refuses its configuration because an emergency stop is latched until
        /// it is reset.
        EmergencyStopped = 5 "emergency-stopped",
        /// The board answers, has its configuration and sends telemetry.
        Ready = 2 "ready",
    }
}

impl BoardState {
    /// Whether the board is armed: it follows commands, or will.
    pub const fn is_armed(self) -> bool {
        matches!(
            self,
            Self::Armed | Self::Driving | Self::PoweringUp | Self::Jogging
        )
    }
}

words! {
    /// Who attends an armed car, and what it does.
    pub enum Arming {
        /// It follows the reference; the drive goes on by itself.
        Unattended = 1 "arm",
        /// It follows the reference, with a dead-man switch: the drive ends unless
        /// [`PilotRequest::Hold`] renews it at least every 0.5 s.
        Held = 4 "arm-held",
        /// It takes bare pulses to servo and ESC, for as long as [`Event::Jog`] renews them at
        /// least every 0.25 s. It needs neither poses nor the IMU.
        Jog = 8 "arm-jog",
        /// It is held, and stands until [`Event::Begin`].
        Waiting = 11 "arm-waiting",
    }
}

/// What a person or a program asks of the pilot.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PilotRequest {
    /// Arm. It is refused unless every arming check passes.
    Arm(Arming),
    /// Slow down, stop and disarm; also leaves [`crate::Mode::Fault`].
    Disarm,
    /// Put the motor to neutral now, until the board is reset.
    EmergencyStop,
    /// Renews a drive that is held; without effect on any other.
    Hold,
    /// The operator who holds the drive has let go of it: slow down, stop and disarm.
    OperatorGone,
    /// The time of the drive is over: slow down, stop and disarm.
    TimeUp,
    /// The operator's dead-man switch is lost: disarm at once, without the ramp of
    /// [`OperatorGone`](Self::OperatorGone).
    Halt,
    /// [`Disarm`](Self::Disarm), and the operator's word that the body which the cameras show is
    /// the car: it was carried out of their sight. Without effect on an estimate that has not
    /// lost the car, and while the board is commanded. No program says it by itself.
    Carried,
}

impl PilotRequest {
    /// All requests.
    pub const ALL: [Self; 11] = [
        Self::Arm(Arming::Unattended),
        Self::Disarm,
        Self::EmergencyStop,
        Self::Arm(Arming::Held),
        Self::Hold,
        Self::OperatorGone,
        Self::TimeUp,
        Self::Arm(Arming::Jog),
        Self::Halt,
        Self::Carried,
        Self::Arm(Arming::Waiting),
    ];

    /// Its number in a record, which never changes.
    pub const fn number(self) -> u8 {
        match self {
            Self::Arm(arming) => arming as u8,
            Self::Disarm => 2,
            Self::EmergencyStop => 3,
            Self::Hold => 5,
            Self::OperatorGone => 6,
            Self::TimeUp => 7,
            Self::Halt => 9,
            Self::Carried => 10,
        }
    }

    /// Its word in log and record.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Arm(arming) => arming.name(),
            Self::Disarm => "disarm",
            Self::EmergencyStop => "emergency-stop",
            Self::Hold => "hold",
            Self::OperatorGone => "operator-gone",
            Self::TimeUp => "time-up",
            Self::Halt => "halt",
            Self::Carried => "carried",
        }
    }

    /// Whether it ends a drive.
    pub const fn is_stop(self) -> bool {
        !matches!(self, Self::Arm(_) | Self::Hold)
    }
}

impl core::fmt::Display for PilotRequest {
    fn fmt(&self, formatter: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        formatter.write_str(self.name())
    }
}
